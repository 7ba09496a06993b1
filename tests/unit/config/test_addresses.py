"""The processes of a swarm and their endpoints."""

import pytest
from squares import square

from crazychoir.config.addresses import PROCESS_NUMBERS, Addresses
from crazychoir.config.swarm_config import (
    SwarmConfig,
)


def test_endpoints() -> None:
    assert Addresses(square()).endpoints() == {
        i: f"tcp/127.0.0.1:{7460 + i}" for i in range(4)
    }
    shared = square("base_port = 9000\nprocesses = [[3, 1], [0, 2]]")
    assert Addresses(shared).groups() == ((0, 2), (1, 3))
    assert Addresses(shared).process(3) == 1
    assert Addresses(shared).endpoint(3) == "tcp/127.0.0.1:9001"
    assert Addresses(shared).endpoints() == {
        0: "tcp/127.0.0.1:9000",
        1: "tcp/127.0.0.1:9001",
    }


@pytest.mark.parametrize(
    ("address", "endpoint"),
    [
        ("10.0.0.7", "tls/10.0.0.7:7460"),
        ("fe80::1", "tls/[fe80::1]:7460"),
        ("lab.local", "tls/lab.local:7460"),
    ],
)
def test_endpoint_of_a_host(address: str, endpoint: str) -> None:
    drones = [{"id": 0, "home": [0, 0, 0], "host": "lab"}]
    raw = {
        "name": "a",
        "hosts": {"lab": address},
        "security": {"operators": ["lab"]},
        "drones": drones,
    }
    assert Addresses(SwarmConfig.of(raw)).endpoint(0) == endpoint


def test_processes_of_other_hosts_are_counted() -> None:
    assert Addresses(square()).count_remote(None) == 0
    raw = {
        "name": "a",
        "hosts": {"lab": "10.0.0.7", "desk": "10.0.0.8"},
        "security": {"operators": ["lab"]},
        "world": {"host": "desk", "owned": True},
        "drones": [
            {"id": 0, "home": [0, 0, 0], "host": "lab"},
            {"id": 1, "home": [1, 0, 0], "host": "lab"},
            {"id": 2, "home": [2, 0, 0], "host": "desk"},
        ],
    }
    addresses = Addresses(SwarmConfig.of(raw))
    assert addresses.count_remote("lab") == 2
    assert addresses.count_remote("desk") == 2
    assert addresses.count_remote("laptop") == 4


def test_the_owner_of_the_world_is_reached_before_all_agents() -> None:
    assert list(
        Addresses(square("world.owned = true\nbase_port = 9000")).endpoints().items()
    )[:2] == [
        (PROCESS_NUMBERS.world, "tcp/127.0.0.1:8999"),
        (0, "tcp/127.0.0.1:9000"),
    ]
    raw = {
        "name": "a",
        "hosts": {"lab": "10.0.0.7", "desk": "10.0.0.8"},
        "security": {"operators": ["lab"]},
        "world": {"host": "desk"},
        "drones": [{"id": 0, "home": [0, 0, 0], "host": "lab"}],
    }
    named = SwarmConfig.of(raw)
    assert (
        named.topology.owned,
        Addresses(named).endpoints()[PROCESS_NUMBERS.world],
    ) == (
        (0,),
        "tls/10.0.0.8:7459",
    )
