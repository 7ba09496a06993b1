"""Effects as a swarm file and `crazychoir impair` name them, and as the simulated network does."""

import pytest

from crazychoir.bus.impairment.model import Impairment
from crazychoir.config.network import impairment_changes, impairment_of
from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import ConfigError


def test_a_running_network_takes_what_a_file_would_say():
    link = {"loss": 0.25, "burst": 5.0, "delay": 0.1}
    running = Impairment(0)
    running.update(impairment_changes({**link, "jitter": None}))
    assert running.rules == impairment_of(default_swarm(2).replace(network=link)).rules
    running.update(impairment_changes({"loss": 0.5}))
    assert [rule.describe() for rule in running.rules] == [
        {"delay": 0.1, "loss": 0.5}
    ], "no bursts any more"


@pytest.mark.parametrize(
    "options",
    [{"burst": 5.0}, {"burst": 0.5, "loss": 0.1}, {"burst": 2.0, "loss": 0.0}],
)
def test_a_burst_is_of_a_loss(options):
    with pytest.raises(ConfigError, match="1 or more, with a loss between 0 and 1"):
        impairment_changes(options)
