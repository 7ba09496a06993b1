"""Port 5: log blocks of a virtual drone, which send their variables by the drone's own clock."""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from crazychoir.radio.protocol.crtp import LOG, Packet
from crazychoir.radio.virtual.toc import LETTERS, LOG_TYPES, Entry, Toc
from crazychoir.simulation.onboard.logs import whole

# Channels.
TOC, SETTINGS, DATA = range(3)
# Commands of SETTINGS.
_V1_CREATE, _V1_APPEND, DELETE, START, STOP, RESET, CREATE, APPEND, START_V2 = range(9)
# Results, with the numbers of errno.
OK = 0
ENOENT = 2
E2BIG = 7
ENOEXEC = 8
ENOMEM = 12
EEXIST = 17
BY_ADDRESS = 0xFFFF
"""Index of a variable that is named by an address in the drone's memory, which follows."""
BLOCKS = 16
"""Most blocks."""
VARIABLES = 128
"""Most variables in all blocks."""
SIZE = 26
"""Most bytes of the values of one block."""
LETTER = {LOG_TYPES[kind]: letter for kind, letter in LETTERS.items()} | {8: "e"}
"""struct letter of each type; the last is a float of 16 bits, which a client may ask for."""
HALF_FLOAT = 65504.0
"""Largest number in a float of 16 bits."""
FLOAT = 3.4028234e38
"""A little less than the largest number in a float of 32 bits."""
Read = Callable[[str], float]
"""Callback that returns a log variable by name."""


@dataclass
class Block:
    """Variables that are sent together."""

    variables: list[tuple[str, str]] = field(default_factory=list)
    """Name and struct letter of each."""
    period: int = 0
    """ms; 0: the block is stopped."""
    due: int = 0
    """ms of uptime at which it is sent next."""
    once: bool = False
    """True if it is to be sent once."""

    @property
    def size(self) -> int:
        """Bytes of its values."""
        return sum(struct.calcsize(letter) for _, letter in self.variables)


class Logs:
    """The log blocks that clients have asked for.

    entries: log variables of the table of contents
    read: returns the current value of a log variable by name
    """

    def __init__(self, entries: tuple[Entry, ...], read: Read) -> None:
        self.toc = Toc(LOG, entries, LOG_TYPES, bytes([BLOCKS, VARIABLES]))
        self.read = read
        self.blocks: dict[int, Block] = {}

    @property
    def running(self) -> bool:
        """Whether any block is sent periodically."""
        return any(block.period for block in self.blocks.values())

    def take(self, packet: Packet, now: int) -> Iterator[Packet]:
        """Return the answers to a packet; now: ms of uptime."""
        if packet.channel == TOC:
            yield from self.toc.take(packet.data)
        elif packet.channel == SETTINGS and packet.data:
            command = packet.data[0]
            rest = packet.data[1:]
            number = rest[0] if rest else 0
            error = self._do(command, number, rest[1:], now)
            yield Packet(LOG, SETTINGS, bytes([command, number, error]))

    def due(self, now: int) -> Iterator[Packet]:
        """Return the packets that are due at this ms of uptime.

        A late block skips the times that it has missed.
        """
        for number, block in self.blocks.items():
            if block.once:
                block.once = False
                yield self._data(number, block, now)
            if block.period and now >= block.due:
                block.due += ((now - block.due) // block.period + 1) * block.period
                yield self._data(number, block, now)

    def _data(self, number: int, block: Block, now: int) -> Packet:
        values = b"".join(
            value_of(letter, self.read(name) if name else 0.0)
            for name, letter in block.variables
        )
        return Packet(
            LOG, DATA, bytes([number]) + (now & 0xFFFFFF).to_bytes(3, "little") + values
        )

    def _do(self, command: int, number: int, rest: bytes, now: int) -> int:
        if command == RESET:
            self.blocks.clear()
            return OK
        if command == CREATE:
            return self._create(number) or self._append(number, rest)
        if command == APPEND:
            return self._append(number, rest)
        if command not in (DELETE, START, STOP, START_V2):
            return ENOEXEC
        block = self.blocks.get(number)
        if block is None:
            return ENOENT
        if command == DELETE:
            del self.blocks[number]
        elif command == STOP:
            block.period = 0
        else:
            period = (
                10 * int.from_bytes(rest[:1], "little")
                if command == START
                else int.from_bytes(rest[:2], "little")
            )
            block.once = not period
            block.period = period or block.period
            block.due = now + period
        return OK

    def _create(self, number: int) -> int:
        if number in self.blocks:
            return EEXIST
        if len(self.blocks) == BLOCKS:
            return ENOMEM
        self.blocks[number] = Block()
        return OK

    def _append(self, number: int, rest: bytes) -> int:
        """Add variables up to the first that does not fit.

        A new block stays in any case, as in the firmware.
        """
        block = self.blocks.get(number)
        if block is None:
            return ENOENT
        for kind, index in _wanted(rest):
            letter = LETTER.get(kind)
            if letter is None or block.size + struct.calcsize(letter) > SIZE:
                return E2BIG
            if sum(len(other.variables) for other in self.blocks.values()) == VARIABLES:
                return ENOMEM
            if index != BY_ADDRESS and index >= len(self.toc.entries):
                return ENOENT
            block.variables.append(
                ("" if index == BY_ADDRESS else self.toc.entries[index].full, letter)
            )
        return OK


def _wanted(rest: bytes) -> Iterator[tuple[int, int]]:
    """Return types and indices of variables.

    A variable by address has four more bytes, and its value is 0.
    """
    at = 0
    while at + 3 <= len(rest):
        index = int.from_bytes(rest[at + 1 : at + 3], "little")
        yield rest[at] & 0x0F, index
        at += 7 if index == BY_ADDRESS else 3


def value_of(letter: str, value: float) -> bytes:
    """Return a value in the format of its letter.

    Whole numbers are limited to their range. A float that does not fit becomes 0.
    """
    if letter == "e":
        return struct.pack("<e", min(max(value, -HALF_FLOAT), HALF_FLOAT))
    if letter == "f":
        return struct.pack(
            "<f", value if abs(value) <= FLOAT or not math.isfinite(value) else 0.0
        )
    bits = 8 * struct.calcsize(letter)
    low, high = (
        (-(1 << bits - 1), (1 << bits - 1) - 1)
        if letter.islower()
        else (0, (1 << bits) - 1)
    )
    return whole(value, low, high).to_bytes(
        bits // 8, "little", signed=letter.islower()
    )
