"""Values of a swarm file that all drones of a process share."""

import pytest

from crazychoir.config.shared_values import share
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import ConfigError

computed: list[int] = []


def _count_drones(config: SwarmConfig, extra: int) -> list[int]:
    computed.append(extra)
    return [len(config.drones) + extra]


def _fail(config: SwarmConfig) -> int:
    computed.append(0)
    raise ConfigError(config.name, "nothing", "a value")


@pytest.fixture(autouse=True)
def _forget() -> None:
    computed.clear()


def test_value_is_computed_once_for_each_swarm_file_and_each_argument():
    config = default_swarm(3)

    first = share(config, _count_drones, 1)

    assert share(config, _count_drones, 1) is first
    assert share(config, _count_drones, 2) == [5]
    assert computed == [1, 2]


def test_changed_swarm_file_has_values_of_its_own():
    config = default_swarm(3)
    share(config, _count_drones, 1)

    changed = config.replace(seed=7)

    assert share(changed, _count_drones, 1) == [4]
    assert computed == [1, 1]


def test_error_is_not_kept():
    config = default_swarm(3)

    for _ in range(2):
        with pytest.raises(ConfigError):
            share(config, _fail)

    assert len(computed) == 2


def test_drones_of_a_swarm_share_its_graph_and_its_controls():
    config = default_swarm(4)

    assert config.graph() is config.graph()
    assert config.control_of(0) is config.control_of(3)


def test_shared_values_do_not_change_the_text_of_a_swarm_file():
    config = default_swarm(3)
    before = config.dumps()

    config.graph()
    config.control_of(1)

    assert config.dumps() == before
    assert config == SwarmConfig.loads(before)
