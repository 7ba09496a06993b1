"""Drones are looked after only while they stand; stand-ins keep what they are told."""

import pytest
from virtual_time import virtual

from crazychoir.errors import LinkFailed, Refused
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio import maintenance
from crazychoir.radio.maintenance import PowerAction, read_condition, switch_power

READY = SUPERVISOR_BITS.can_fly | SUPERVISOR_BITS.auto_arm
URI = "udp://127.0.0.1:1"


class Link:
    """A connection to a drone with these supervisor bits; None: it tells nothing."""

    supervisor, closed = READY, False

    def __init__(self, clock, uri, contents):
        self.uri = uri

    async def open(self, seconds):
        """At once."""

    async def close(self):
        type(self).closed = True

    async def log(self, name, variables, period, data, seconds):
        if self.supervisor is not None:
            data({"pm.vbat": 4.1, "supervisor.info": float(self.supervisor)}, 1)


class Firmware:
    def __init__(self, connection):
        """Of any connection."""

    async def release(self):
        return "2025.12"


class Switch:
    """Notes what is switched."""

    def __init__(self, uri):
        self.told.append(uri)

    def platform_power_down(self):
        self.told.append("all off")

    def stm_power_down(self):
        self.told.append("off")

    def stm_power_up(self):
        self.told.append("on")

    def close(self):
        """Nothing is open."""


@pytest.fixture(autouse=True)
def stand_ins(monkeypatch):
    Switch.told = []  # as no other test has left it
    monkeypatch.setattr(Link, "supervisor", READY)
    monkeypatch.setattr(maintenance, "Connection", Link)
    monkeypatch.setattr(maintenance, "ConnectedFirmware", Firmware)
    monkeypatch.setattr(maintenance, "PowerSwitch", Switch)
    monkeypatch.setattr(maintenance.drivers, "register_drivers", lambda: None)


def test_the_condition_is_told_and_the_link_closed():
    @virtual
    async def ask(clock):
        found = await read_condition(clock, URI, None, 1.0)
        assert (found.volts, found.release, found.problems) == (4.1, "2025.12", [])

    ask()
    assert Link.closed


def test_a_drone_that_tells_nothing_is_a_failed_link(monkeypatch):
    monkeypatch.setattr(Link, "supervisor", None)

    @virtual
    async def ask(clock):
        with pytest.raises(LinkFailed, match="does not tell its condition"):
            await read_condition(clock, URI, None, 1.0)

    ask()


@pytest.mark.parametrize(
    ("action", "told"),
    [
        (PowerAction.RESTART, [URI, "off", URI, "on"]),
        (PowerAction.OFF, [URI, "all off"]),
    ],
)
def test_a_standing_drone_is_switched(monkeypatch, action, told):
    async def at_once(function, *arguments):
        return function(*arguments)

    monkeypatch.setattr(maintenance.asyncio, "to_thread", at_once)

    @virtual
    async def switch(clock):
        await switch_power(clock, URI, None, 1.0, action)

    switch()
    assert Switch.told == told


def test_a_flying_drone_is_not_switched(monkeypatch):
    monkeypatch.setattr(Link, "supervisor", READY | SUPERVISOR_BITS.flying)

    @virtual
    async def switch(clock):
        with pytest.raises(Refused, match="it flies: land it first"):
            await switch_power(clock, URI, None, 1.0, PowerAction.OFF)

    switch()
    assert Switch.told == []
