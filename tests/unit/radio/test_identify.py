"""Parameters light a drone's LEDs and are put back afterwards; a stand-in firmware keeps what it is told."""

import asyncio

import pytest
from virtual_time import virtual

from crazychoir.errors import LinkFailed, Refused
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio import identify
from crazychoir.radio.protocol.crtp import CrtpPort, Packet


class Link:
    """A connection to a drone that says its supervisor's bits, None: it does not answer."""

    uri, supervisor, closed = "udp://127.0.0.1:1", 0, False

    async def open(self, seconds):
        """At once."""

    async def close(self):
        self.closed = True

    async def ask(self, packet, answers, seconds):
        if self.supervisor is None:
            raise TimeoutError
        answer = Packet(
            CrtpPort.SUPERVISOR, 0, b"\x8c" + self.supervisor.to_bytes(2, "little")
        )
        assert packet == Packet(CrtpPort.SUPERVISOR, 0, b"\x0c")
        assert answers(answer)
        assert not answers(Packet(CrtpPort.SUPERVISOR, 1, answer.data))
        return answer


class Kept:
    """A firmware that keeps what it is told, in order."""

    def __init__(self, values):
        self.values, self.told = values, []

    async def has(self, name):
        return bool(self.values.get(name))

    async def get(self, name):
        return self.values[name]

    async def set_all(self, values):
        self.values |= values
        self.told += values


@pytest.fixture
def drone(monkeypatch):
    """Its link and its firmware."""
    link = Link()
    firmware = Kept(
        dict.fromkeys(identify.RING_LEDS, 20)
        | {"led.bitmask": 3, "ring.effect": 6, "deck.bcLedRing": 0}
    )
    monkeypatch.setattr(identify, "Connection", lambda clock, uri, contents: link)
    monkeypatch.setattr(identify, "ConnectedFirmware", lambda connection: firmware)
    return link, firmware


def run(drone, does):
    """A coroutine function of the clock, in virtual time."""
    virtual(does)()
    assert drone[0].closed


def test_the_leds_of_the_board_are_lit_for_so_long_and_put_back(drone):
    firmware, seen = drone[1], []

    async def does(clock):
        clock.call_at(900_000_000, lambda: seen.append(firmware.values["led.bitmask"]))
        assert await identify.identify(clock, "udp://127.0.0.1:1", None, 1.0, 2.0) == {
            "led.bitmask": 255
        }
        assert clock.now() >= 1.0

    run(drone, does)
    assert seen == [255]
    assert (firmware.values["led.bitmask"], firmware.values["ring.effect"]) == (3, 6)


def test_a_ring_is_lit_too_and_gets_its_effect_back_before_its_colours(drone):
    firmware = drone[1]
    firmware.values["deck.bcLedRing"] = 1
    before = dict(firmware.values)

    async def does(clock):
        assert set(await identify.identify(clock, "", None, 1.0, 2.0)) == {
            "led.bitmask",
            *identify.RING_LEDS,
        }

    run(drone, does)
    assert firmware.values == before
    assert firmware.told[4:6] == ["ring.effect", "ring.effect"], (
        "its colours are there when it shows them"
    )


def test_the_leds_are_restored_when_identify_is_cancelled(drone):
    async def does(clock):
        work = asyncio.get_running_loop().create_task(
            identify.identify(clock, "", None, 60.0, 2.0)
        )
        await clock.sleep(1.0)
        assert drone[1].values["led.bitmask"] == 255
        work.cancel()
        with pytest.raises(asyncio.CancelledError):
            await work

    run(drone, does)
    assert drone[1].values["led.bitmask"] == 3


@pytest.mark.parametrize(
    "supervisor", [None, SUPERVISOR_BITS.can_fly | SUPERVISOR_BITS.armed]
)
def test_a_drone_that_stands_or_reports_nothing_is_lit(drone, supervisor):
    drone[0].supervisor = supervisor

    async def does(clock):
        await identify.identify(clock, "", None, 1.0, 2.0)

    run(drone, does)
    assert drone[1].told == ["led.bitmask", "led.bitmask"]


def test_a_flying_drone_is_left_alone(drone):
    drone[0].supervisor = SUPERVISOR_BITS.flying | SUPERVISOR_BITS.can_fly

    async def does(clock):
        with pytest.raises(Refused, match="it flies"):
            await identify.identify(clock, "", None, 1.0, 2.0)

    run(drone, does)
    assert drone[1].told == []


def test_an_unreachable_drone_is_reported(drone):
    async def fails(seconds):
        raise LinkFailed("udp://127.0.0.1:1", f"no answer within {seconds:g} s")

    drone[0].open = fails

    async def does(clock):
        with pytest.raises(LinkFailed, match="no answer within 2 s"):
            await identify.identify(clock, "", None, 1.0, 2.0)

    run(drone, does)
