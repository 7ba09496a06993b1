"""Addresses of hosts: what a file allows, the agent takes; what it does not, both refuse with what to do."""

import pytest

from crazychoir.bus.network.endpoints import (
    address_fault,
    are_local,
    check_endpoint,
    zenoh_settings,
)
from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError

GOOD = [
    "10.0.0.7",
    "127.0.0.1",
    "localhost",
    "fd00::2",
    "::1",
    "fe80::1",
    "::ffff:10.0.0.1",
    "lab",
    "lab.local",
]
BAD = {
    "fe80::1%eth0": "Leave out %eth0",
    "fe80::1%2": "Leave out %2",
    "[fe80::1%eth0]": "Leave out %eth0",
    "[::1]": "Leave out the brackets",
    "[fd00::2]:7460": "Leave out the port: ports come from base_port",
    "10.0.0.7:7460": "Leave out the port: ports come from base_port",
    "lab:7460": "Leave out the port: ports come from base_port",
    "tcp/10.0.0.7": "a DNS name",
    "10.0.0.999": "a DNS name",
    "010.0.0.1": "a DNS name",
    "127.1": "a DNS name",
    "0.0.0.0": "by which the others reach",  # noqa: S104 - nothing listens by it
    "::": "by which the others reach",
    "ff02::1": "by which the others reach",
    "a_b": "a DNS name",
    "a b": "a DNS name",
    "": "a DNS name",
    "-a": "a DNS name",
}


def on(address):
    drones = [{"id": 0, "home": [0, 0, 0], "host": "lab"}]
    raw = {
        "name": "a",
        "hosts": {"lab": address},
        "security": {"operators": ["lab"]},
        "drones": drones,
    }
    return SwarmConfig.of(raw, "x.toml")


@pytest.mark.parametrize("address", GOOD)
def test_an_address_that_the_file_allows_is_an_endpoint_of_the_agent(address):
    assert address_fault(address) == ""
    endpoints = list(Addresses(on(address)).endpoints().values())
    check_endpoint(endpoints, endpoints)
    assert zenoh_settings(endpoints, [], 1.0)["listen/endpoints"] == endpoints


@pytest.mark.parametrize(("address", "do"), BAD.items())
def test_any_other_address_is_refused_by_the_file_with_what_to_do(address, do):
    with pytest.raises(ConfigError) as refused:
        on(address)
    assert "x.toml: hosts.lab" in str(refused.value)
    assert do in str(refused.value)


@pytest.mark.parametrize(
    ("endpoint", "do"),
    [
        ("tcp/[fe80::1%eth0]:7460", "Write the number of the network card eth0"),
        ("tcp/[fe80::1%]:7460", "Only an IPv6 address|number of the network card"),
        ("tcp/[10.0.0.1]:7460", "Only an IPv6 address is in brackets"),
        ("tcp/[lab]:7460", "Only an IPv6 address is in brackets"),
        ("tcp/fe80::1:7460", "base_port"),
        ("tcp/10.0.0.1:70000", "port 0 to 65535"),
        ("tcp/10.0.0.1", "base_port"),
    ],
)
def test_an_endpoint_that_cannot_be_opened_is_refused_with_what_to_do(endpoint, do):
    for listen, connect in (([endpoint], []), ([], [endpoint])):
        with pytest.raises(ConfigError, match=do):
            check_endpoint(listen, connect)


def test_a_network_card_by_its_number_is_an_endpoint_of_one_host():
    check_endpoint(["tcp/[fe80::1%2]:7460"], [])


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp/127.0.0.1:1", True),
        ("tcp/127.1.2.3:1", True),
        ("tcp/localhost:1", True),
        ("tcp/LOCALHOST:1", True),
        ("tcp/[::1]:1", True),
        ("tcp/[0:0:0:0:0:0:0:1]:1", True),
        ("unixsock-stream/a", True),
        ("tcp/10.0.0.1:1", False),
        ("tcp/[fd00::1]:1", False),
        ("tcp/localhost.lab:1", False),
        ("tcp/127.0.0.1.lab:1", False),
        ("", False),
    ],
)
def test_an_endpoint_is_local_however_its_address_is_written(endpoint, local):
    assert are_local([endpoint]) == local
