"""--source of the commands of motion capture."""

import pytest

from crazychoir.cli.fly.mocap import with_source
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError


def swarm():
    return SwarmConfig.of(
        {
            "name": "lab",
            "drones": [
                {"id": 0, "home": [0.0, 0.0, 0.0], "uri": "udp://127.0.0.1:19850"}
            ],
        }
    )


@pytest.mark.parametrize(
    ("source", "place"),
    [
        ("virtual", ("127.0.0.1", 19849)),
        ("virtual@10.0.0.5", ("10.0.0.5", 19849)),
        ("virtual@10.0.0.5:2000", ("10.0.0.5", 2000)),
        ("virtual@[::1]:2000", ("::1", 2000)),
        ("virtual@[fe80::1%eth0]:2000", ("fe80::1%eth0", 2000)),
        ("virtual@[::1]", ("::1", 19849)),
        ("virtual@fe80::1%eth0", ("fe80::1%eth0", 19849)),
        ("vicon@lab-pc", ("lab-pc", 19849)),
    ],
)
def test_the_place_of_a_source_is_read_with_and_without_a_port(source, place):
    mocap = with_source(swarm(), source).mocap
    assert (mocap.hostname, mocap.port) == place


@pytest.mark.parametrize("port", ["0", "65536", "1e3", "-1", "x", "9" * 5000])
def test_a_port_that_is_none_is_refused(port):
    with pytest.raises(ConfigError, match="--source"):
        with_source(swarm(), f"virtual@10.0.0.5:{port}")
