"""Port 5: log blocks of a virtual drone, which send what they hold by the drone's own clock."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from crazychoir.radio.crtp import LOG, Packet
from crazychoir.radio.virtual.toc import LETTERS, LOG_TYPES, Entry, Toc

TOC, SETTINGS, DATA = range(3)
"""Channels."""
CREATE_V1, APPEND_V1, DELETE, START, STOP, RESET, CREATE, APPEND, START_V2 = range(9)
OK, ENOENT, E2BIG, ENOEXEC, ENOMEM, EEXIST = 0, 2, 7, 8, 12, 17
BLOCKS, VARIABLES, SIZE = 16, 128, 26
"""At most: blocks, variables in all of them, bytes of the values of one."""
LETTER = {LOG_TYPES[kind]: letter for kind, letter in LETTERS.items()} | {8: "e"}
"""By type; the last is a float of 16 bits, as which a client may ask for a variable."""
Read = Callable[[str], float]


@dataclass
class Block:
    """Variables that travel together. period: ms, 0: it is stopped;  due: ms of uptime, when it is sent next."""

    variables: list[tuple[str, str]] = field(default_factory=list)
    period: int = 0
    due: int = 0

    @property
    def size(self) -> int:
        """Bytes of its values."""
        return sum(struct.calcsize(letter) for _, letter in self.variables)


class Logs:
    """The blocks that clients have asked for. read: the value of a log variable by name, now."""

    def __init__(self, entries: tuple[Entry, ...], read: Read) -> None:
        self.toc = Toc(LOG, entries, LOG_TYPES, bytes([BLOCKS, VARIABLES]))
        self.read = read
        self.blocks: dict[int, Block] = {}

    def take(self, packet: Packet, now: int) -> Iterator[Packet]:
        """The answers to a packet; now: ms of uptime."""
        if packet.channel == TOC:
            yield from self.toc.take(packet.data)
        elif packet.channel == SETTINGS and packet.data:
            command, rest = packet.data[0], packet.data[1:]
            number = rest[0] if rest else 0
            error = self._do(command, number, rest[1:], now)
            yield Packet(LOG, SETTINGS, bytes([command, number, error]))

    def due(self, now: int) -> Iterator[Packet]:
        """What is to be sent at this ms of uptime; a block that is late skips what it has missed."""
        for number, block in self.blocks.items():
            if block.period and now >= block.due:
                block.due += ((now - block.due) // block.period + 1) * block.period
                yield self._data(number, block, now)

    def _data(self, number: int, block: Block, now: int) -> Packet:
        values = b"".join(value_of(letter, self.read(name)) for name, letter in block.variables)
        return Packet(LOG, DATA, bytes([number]) + (now & 0xFFFFFF).to_bytes(3, "little") + values)

    def _do(self, command: int, number: int, rest: bytes, now: int) -> int:
        if command == RESET:
            self.blocks.clear()
            return OK
        if command in (CREATE, APPEND):
            return self._fill(command == CREATE, number, rest)
        block = self.blocks.get(number)
        if block is None:
            return ENOENT
        if command == DELETE:
            del self.blocks[number]
        elif command == STOP:
            block.period = 0
        elif command in (START, START_V2) and rest:
            block.period = 10 * rest[0] if command == START else int.from_bytes(rest[:2], "little")
            block.due = now + block.period
        else:
            return ENOEXEC
        return OK

    def _fill(self, create: bool, number: int, rest: bytes) -> int:
        """Make a block of these variables, or add them to one."""
        if create and number in self.blocks:
            return EEXIST
        if not create and number not in self.blocks:
            return ENOENT
        if create and len(self.blocks) == BLOCKS:
            return ENOMEM
        found: list[tuple[str, str]] = []
        for k in range(0, len(rest), 3):
            index = int.from_bytes(rest[k + 1 : k + 3], "little")
            letter = LETTER.get(rest[k] & 0x0F)
            if len(rest) - k < 3 or letter is None or index >= len(self.toc.entries):
                return ENOENT
            found.append((self.toc.entries[index].full, letter))
        block = Block([*(() if create else self.blocks[number].variables), *found])
        if block.size > SIZE:
            return E2BIG
        if sum(len(other.variables) for other in self.blocks.values()) + len(found) > VARIABLES:
            return ENOMEM
        self.blocks[number] = block
        return OK


def value_of(letter: str, value: float) -> bytes:
    """A value as it travels: whole numbers at the ends of their range stay there."""
    if letter in "ef":
        return struct.pack("<" + letter, value)
    bits = 8 * struct.calcsize(letter)
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if letter.islower() else (0, (1 << bits) - 1)
    return int(min(max(int(value), low), high)).to_bytes(bits // 8, "little", signed=letter.islower())
