"""One virtual Crazyflie without any I/O: packets in, packets out, and what it says by itself as time goes by."""

from collections.abc import Callable, Iterator

from crazychoir.radio.crtp import (
    COMMANDER,
    CONSOLE,
    HIGH_LEVEL,
    LINK,
    LOCALIZATION,
    LOG,
    MEMORY,
    PARAM,
    PLATFORM,
    SETPOINT,
    SUPERVISOR,
    Packet,
)
from crazychoir.radio.virtual.flight import Flight
from crazychoir.radio.virtual.logs import Logs
from crazychoir.radio.virtual.memories import Memories
from crazychoir.radio.virtual.parameters import Parameters
from crazychoir.radio.virtual.toc import names
from crazychoir.simulation.onboard.logs import TABLE
from crazychoir.simulation.onboard.onboard import Onboard

ECHO, SOURCE, SINK = range(3)
"""Channels of the link's port."""
NAME = b"Bitcraze Crazyflie".ljust(30, b"\0")
"""What asks for the source of a link gets."""
FLIES = (COMMANDER, SETPOINT, HIGH_LEVEL, LOCALIZATION, SUPERVISOR, PLATFORM)
TEXT = 30
"""Bytes of the console in one packet."""


class VirtualCrazyflie:
    """What the firmware answers to; its model flies the body in a world that somebody steps.

    number: the last byte of its address;  log: more log variables by name, those that no firmware model has;
    stored: persistent parameters, changed in place.
    """

    def __init__(
        self, onboard: Onboard, number: int = 0xE7, log: dict[str, Callable[[], float]] | None = None,
        stored: dict[str, float] | None = None,
    ) -> None:  # fmt: skip
        logs, parameters = names()
        more = log or {}
        self.onboard, self.uptime = onboard, 0
        """ms since it was switched on."""
        served = tuple(entry for entry in logs if entry.full in TABLE or entry.full in more)
        self.logs = Logs(served, lambda name: more[name]() if name in more else onboard.log(name))
        self.parameters = Parameters(onboard, parameters, stored)
        self.memories, self.flight = Memories(onboard), Flight(onboard, number)
        self._said: list[Packet] = []

    def take(self, packet: Packet) -> Iterator[Packet]:
        """The answers to a packet."""
        port = packet.port
        if port in FLIES:
            yield from self.flight.take(packet)
        elif port == LOG:
            yield from self.logs.take(packet, self.uptime)
        elif port == PARAM:
            yield from self.parameters.take(packet)
        elif port == MEMORY:
            yield from self.memories.take(packet)
        elif port == LINK and packet.channel == ECHO:
            yield packet
        elif port == LINK and packet.channel == SOURCE:
            yield Packet(LINK, SOURCE, NAME)

    def pass_time(self, uptime: int) -> Iterator[Packet]:
        """What it says by itself up to this ms of uptime."""
        self.uptime = uptime
        said, self._said = self._said, []
        yield from said
        yield from self.logs.due(uptime)

    def say(self, text: str) -> None:
        """On its console; no character is split."""
        line = b""
        for character in text:
            more = character.encode()
            if len(line) + len(more) > TEXT:
                self._said.append(Packet(CONSOLE, 0, line))
                line = b""
            line += more
        self._said.append(Packet(CONSOLE, 0, line))
