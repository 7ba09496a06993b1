"""Uris of drones that a radio reaches: one form for each, and clear refusals."""

import itertools

import pytest
from cflib.crtp.radiodriver import RadioDriver

from crazychoir.config.digest import compute_digest
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.uris import canonical_uri, parse_uri
from crazychoir.errors import ConfigError

ONE_RADIO_DRONE = [
    "radio://0/80/2M/E7E7E7E7E7",
    "radio://0/080/2M/E7E7E7E7E7",
    "radio://00/80/2M/E7E7E7E7E7",
    "radio://0/80/2M/e7e7e7e7e7",
    "radio://0/80/2M/e7E7e7E7e7",
    "radio://0/80/2M",
    "radio://0/80",
    "radio://0/80/",
    "radio://0/80/2M/E7E7E7E7E7/",
    "radio://1/80/2M/E7E7E7E7E7",
    "radio://15/80",
    "radio://0/80/2M?rate_limit=100",
    "radio://0/80/2M/E7E7E7E7E7?rate_limit=0100",
]
ONE_VIRTUAL_DRONE = [
    "udp://127.0.0.1:19850",
    "udp://localhost:19850",
    "udp://LocalHost:19850",
    "udp://127.0.0.1:019850",
    "udp://127.1:19850",
    "udp://127.0.0.1:19850/",
    "udp://localhost.:19850",
    "udp://localhost.localdomain:19850",
    "udp://0.0.0.0:19850",
    "udp://0x7f.1:19850",
    "udp://2130706433:19850",
    "udp://127.000.000.001:19850",
]
ONE_FAR_DRONE = [
    "udp://Lab-PC.local:1025",
    "udp://lab-pc.LOCAL.:01025",
    "udp://lab-pc.local:1025/",
]
SEVERAL_DRONES = [
    "radio://0/80/2M/E7E7E7E7E7",
    "radio://0/81/2M/E7E7E7E7E7",
    "radio://0/80/1M/E7E7E7E7E7",
    "radio://0/80/2M/E7E7E7E7E8",
    "udp://127.0.0.1:19850",
    "udp://127.0.0.1:19851",
    "udp://127.0.0.2:19850",
    "udp://lab:19850",
]


def loaded(*uris):
    drones = [
        {"id": i, "home": [float(i), 0.0, 0.0], "uri": uri}
        for i, uri in enumerate(uris)
    ]
    return SwarmConfig.of({"name": "lab", "mocap": {"port": 2000}, "drones": drones})


@pytest.mark.parametrize(
    "uris",
    [ONE_RADIO_DRONE, ONE_VIRTUAL_DRONE, ONE_FAR_DRONE],
    ids=lambda uris: uris[0],
)
def test_one_drone_is_refused_under_any_two_of_its_uris(uris):
    for other in uris[1:]:
        for pair in ((uris[0], other), (other, uris[0])):
            with pytest.raises(ConfigError) as refused:
                loaded(*pair)
            assert "drones[0] has this address" in str(refused.value)
            assert pair[0] in str(refused.value), "as it is written"


def test_different_drones_are_taken():
    for one, other in itertools.combinations(SEVERAL_DRONES, 2):
        assert loaded(one, other).topology.reached == (0, 1)


@pytest.mark.parametrize(
    ("uri", "form"),
    [
        ("radio://00/080/2M/e7e7e7e703", "radio://0/80/2M/E7E7E7E703"),
        ("radio://0/80", "radio://0/80/2M/E7E7E7E7E7"),
        ("radio://3/0/250K/", "radio://3/0/250K/E7E7E7E7E7"),
        (
            "radio://0/7/1M/E7E7E7E7E7?rate_limit=50",
            "radio://0/7/1M/E7E7E7E7E7?rate_limit=50",
        ),
        ("udp://LOCALHOST:019850/", "udp://127.0.0.1:19850"),
        ("udp://127.1:19850", "udp://127.0.0.1:19850"),
        ("udp://Lab.Local:1", "udp://lab.local:1"),
        ("sim://motors", "sim://motors"),
        ("replay://A/b.csv", "replay://A/b.csv"),
    ],
)
def test_a_swarm_has_the_one_form_of_each_uri(uri, form):
    assert canonical_uri(uri) == form
    assert canonical_uri(form) == form
    if not uri.startswith("replay"):
        assert loaded(uri).drone(0).uri == form


@pytest.mark.parametrize(
    "uri", [uri for uri in ONE_RADIO_DRONE if not uri.endswith("/")]
)
def test_the_one_form_means_to_cflib_what_the_uri_meant(uri):
    *ours, address, limit = RadioDriver.parse_uri(canonical_uri(uri))
    *theirs, their_address, their_limit = RadioDriver.parse_uri(uri)
    assert (ours, list(address), limit) == (theirs, list(their_address), their_limit)


def test_two_files_that_write_a_uri_in_two_ways_are_one_swarm():
    assert (
        len(
            {
                compute_digest(loaded(uri))
                for uri in ("radio://0/80", "radio://0/080/2M/e7e7e7e7e7")
            }
        )
        == 1
    )


@pytest.mark.parametrize(
    ("uri", "hint"),
    [
        ("radio://0", "Write its channel"),
        ("radio://", "Write its channel"),
        ("radio://*/80/2M/E7E7E7E7E7", "For crazyflie-link-cpp * is any dongle"),
        ("radio://E7E7E7E7E7/80/2M", "serial number"),
        ("radio://1234567890/80", "serial number"),
        ("radio://16/80", "A dongle is a number of 0 to 15"),
        ("radio://-1/80", "A dongle is a number of 0 to 15"),
        ("radio://٣/80", "A dongle is a number of 0 to 15"),
        ("radio://0/126", "a channel of 0 to 125"),
        ("radio://0/" + "9" * 5000, "A channel is a number of 0 to 125"),
        ("radio://0/80/2m", "Write 2M."),
        ("radio://0/80/3M", "250K, 1M or 2M"),
        ("radio://0/80/2M/E7", "cflib would read it as 00000000E7"),
        ("radio://0/80/2M/0xE7E7E7E7E7", "an address of 10 hexadecimal digits"),
        ("radio://0/80/2M/E7E7E7E7E7/1", "Remove everything after the address"),
        ("radio://0/80?safelink=0", "here safelink is always on"),
        (
            "radio://0/80/2M/E7E7E7E7E7?safelink=1&autoping=0",
            "safelink is an option of crazyflie-link-cpp",
        ),
        ("radio://0/80?ackfilter=1", "ackfilter is an option of crazyflie-link-cpp"),
        ("radio://0/80?ratelimit=7", "There is no option ratelimit"),
        ("radio://0/80?rate_limit=", "whole number of packets"),
        ("radio://0/80?rate_limit=0", "whole number of packets"),
        ("radio://0/80?rate_limit=-5", "whole number of packets"),
        ("radio://0/80?rate_limit=1e3", "whole number of packets"),
        ("radio://0/80?rate_limit=5&rate_limit=6", "Write rate_limit once"),
        ("udp://127.0.0.1", "Write its port, as udp://127.0.0.1:19850"),
        ("udp://:19850", "Write an IP address or a DNS name"),
        ("udp://127.0.0.1:0", "A port is a number of 1 to 65535"),
        ("udp://127.0.0.1:65536", "A port is a number of 1 to 65535"),
        ("udp://127.0.0.1:1e4", "A port is a number of 1 to 65535"),
        ("udp://[::1]:19850", "IPv4 only"),
        ("udp://fe80::1%eth0:19850", "IPv4 only"),
        ("udp://127.0.0.1:19850?rate_limit=5", "has no options"),
        ("udp://a b:19850", "HOST:PORT"),
        ("usb://0", "write the uri of its radio"),
        ("serial://ttyACM0", "write the uri of its radio"),
        ("tcp://192.168.4.1:5000", "the WiFi of an AI deck"),
    ],
)
def test_what_is_known_elsewhere_is_refused_with_what_to_do(uri, hint):
    with pytest.raises(ConfigError) as refused:
        loaded(uri)
    assert "drones[0].uri" in str(refused.value)
    assert hint in str(refused.value)


def test_a_serial_number_is_taken_where_cflib_itself_looks_for_the_dongle():
    assert (
        str(parse_uri("radio://e7e7e7e7e7/80", "uri", serials=True))
        == "radio://E7E7E7E7E7/80/2M/E7E7E7E7E7"
    )
