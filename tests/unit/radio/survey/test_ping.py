"""Echoes through cflib's UDP link, to a drone that is nothing but its echo."""

import dataclasses
import socket
import threading
import time
from types import SimpleNamespace

import pytest

from crazychoir.errors import ConfigError
from crazychoir.radio.survey import ping as ping_module
from crazychoir.radio.survey.ping import NO_ANSWER_TEXT, PingResult, ping, require_uri

ECHO = 0xFC


class Peer:
    """A drone that answers echoes and sends unasked console text; it loses each `every`-th, or all after `last`."""

    def __init__(self, every=0, last=10**9):
        self.every, self.last, self.seen = every, last, []
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.uri = f"udp://127.0.0.1:{self.socket.getsockname()[1]}"
        self.thread = threading.Thread(target=self.run)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *error):
        self.socket.sendto(b"", self.socket.getsockname())
        self.thread.join()
        self.socket.close()

    def run(self):
        while data := (found := self.socket.recvfrom(64))[0]:
            self.seen.append(data)
            lost = self.every and len(self.seen) % self.every == 0
            self.socket.sendto(b"\x0cnobody asked", found[1])
            if not lost and len(self.seen) <= self.last:
                self.socket.sendto(data, found[1])


class Brisk(socket.socket):
    """cflib looks once a second whether it is to close its link."""

    def settimeout(self, seconds):
        super().settimeout(0.05)


@pytest.fixture
def quick(monkeypatch):
    hasty = dataclasses.replace(
        ping_module.PING_TIMING, echo_timeout=0.02, first_answer_timeout=0.2
    )
    monkeypatch.setattr(ping_module, "PING_TIMING", hasty)
    brisk = SimpleNamespace(**{**vars(socket), "socket": Brisk})
    monkeypatch.setattr("cflib.crtp.udpdriver.socket", brisk)
    before = threading.active_count()
    yield
    assert threading.active_count() == before


@pytest.mark.real_time
def test_all_echoes_come_back_and_are_timed(quick):
    with Peer() as peer:
        began = time.perf_counter()
        (found,) = ping([peer.uri], time.perf_counter, count=30)
        passed = time.perf_counter() - began
    assert (found.sent, found.lost, found.error) == (30, 0, "")
    assert 0.0 < found.percentile(50) <= found.percentile(95) <= found.percentile(99)
    assert sum(found.round_trip) < passed
    assert all(len(data) == 10 and data[0] == ECHO for data in peer.seen), (
        "cflib unpacks echoes of nine bytes alone"
    )


@pytest.mark.real_time
def test_lost_echoes_are_counted(quick):
    with Peer(every=5) as peer:
        (found,) = ping([peer.uri], time.perf_counter, count=20)
    assert (found.sent, found.lost, len(found.round_trip)) == (20, 4, 16)


@pytest.mark.real_time
def test_a_ping_of_a_peer_that_falls_silent_ends_at_the_deadline(quick):
    with Peer(last=3) as peer:
        (found,) = ping([peer.uri], time.perf_counter, count=100, deadline=0.3)
    assert len(found.round_trip) == 3
    assert found.sent < 30
    assert (
        found.error == f"{100 - found.sent} more echoes were to be sent at the deadline"
    )


@pytest.mark.real_time
def test_silent_and_absent_drones_are_named_and_the_others_are_measured(
    quick,
):
    with (
        Peer() as peer,
        Peer(last=0) as silent,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free,
    ):
        free.bind(("127.0.0.1", 0))
        absent = f"udp://127.0.0.1:{free.getsockname()[1]}"
        free.close()
        found = ping([peer.uri, silent.uri, absent], time.perf_counter, count=10)
    assert [one.lost for one in found[:1]] == [0]
    assert found[1].error == NO_ANSWER_TEXT
    assert found[1].percentile(50) is None
    assert found[2].sent <= 2
    assert "refused" in found[2].error
    assert NO_ANSWER_TEXT in found[2].error


def test_an_address_that_does_not_resolve_is_an_error_of_that_drone(quick):
    (found,) = ping(["udp://no.such.host.invalid:19850"], time.perf_counter)
    assert found.sent == 0
    assert found.error


def test_a_radio_without_a_dongle_says_what_to_do(quick, monkeypatch):
    monkeypatch.setattr(
        "cflib.drivers.crazyradio._find_devices", lambda serial=None: []
    )
    (found,) = ping(["radio://0/80/2M"], time.perf_counter)
    assert found.error.startswith("Cannot find a Crazyradio Dongle. Plug")


@pytest.mark.parametrize(
    "uri", ["usb://0", "udp://127.0.0.1", "radio://0", "127.0.0.1:19850"]
)
def test_other_addresses_are_refused(uri):
    with pytest.raises(ConfigError, match="udp://HOST:PORT"):
        require_uri(uri)


def test_percentiles_count_only_echoes_that_came_back():
    assert PingResult("udp://a:1", 4, (0.001, 0.002, 0.003)).percentile(50) == 0.002
