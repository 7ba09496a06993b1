"""Packets on the link of a driver."""

import asyncio
import math
from types import SimpleNamespace

import pytest
from virtual_time import virtual

from crazychoir.errors import LinkFailed
from crazychoir.radio.link.driver_link import DriverLink
from crazychoir.radio.link.round_trips import RoundTrips
from crazychoir.radio.protocol.crtp import CrtpPort, Packet

URI = "udp://127.0.0.1:9"
PACKET = Packet(CrtpPort.HIGH_LEVEL, 0, b"\x01")


class Link:
    """A link of a driver that keeps what it is given, or has no room."""

    def __init__(self, has_room: bool = True) -> None:
        self.sent = []
        self.is_closed = False
        self._has_room = has_room

    def send_packet(self, packet) -> bool:
        self.sent.append((packet.port, packet.channel, bytes(packet.data)))
        return self._has_room

    def close(self) -> None:
        self.is_closed = True


@virtual
async def test_a_packet_reaches_the_driver_unless_its_link_is_closed(clock) -> None:
    link = Link()
    driver = DriverLink(clock, URI, SimpleNamespace(link=link), RoundTrips())
    assert driver.put(PACKET)
    assert link.sent == [tuple(PACKET)]
    driver.close()
    assert link.is_closed
    with pytest.raises(LinkFailed, match="its link is closed"):
        driver.put(PACKET)
    driver.put_in_thread(PACKET)
    driver.close()


@virtual
async def test_an_echo_for_which_there_is_no_room_does_not_count(clock) -> None:
    for has_room in (True, False):
        trips = RoundTrips()
        driver = DriverLink(clock, URI, SimpleNamespace(link=Link(has_room)), trips)
        echo = trips.echo()
        assert driver.put(echo) is has_room
        await clock.sleep(0.1)
        trips.came(echo.data, clock.now())
        assert math.isnan(trips.latency) is not has_room


async def test_a_packet_from_a_thread_reaches_the_driver() -> None:
    link = Link()
    driver = DriverLink(
        SimpleNamespace(now=lambda: 0.0), URI, SimpleNamespace(link=link), RoundTrips()
    )
    driver.put_in_thread(PACKET)
    for _ in range(100):
        if link.sent:
            break
        await asyncio.sleep(0.01)
    assert link.sent == [tuple(PACKET)]
