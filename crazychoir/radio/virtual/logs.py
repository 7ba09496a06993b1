"""Port 5: log blocks of a virtual drone, which send their variables by the drone's own clock."""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from operator import itemgetter

from crazychoir.firmware.requests import LOG_CHANNELS, BlockCommand
from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.radio.protocol.receive_buffer import ReceivedPacket
from crazychoir.radio.virtual.toc import (
    LOG_TYPES,
    STRUCT_LETTERS,
    Toc,
    TocCommand,
    TocEntry,
)
from crazychoir.simulation.onboard.logs import truncate_to_range

CHANGE_COMMANDS = (
    BlockCommand.DELETE,
    BlockCommand.START,
    BlockCommand.STOP,
    BlockCommand.START_V2,
)
"""Commands for a block that is there already, without variables."""


BY_ADDRESS_INDEX = 0xFFFF
"""Index of a variable that is named by an address in the drone's memory, which follows."""


@dataclass(frozen=True, slots=True)
class LogLimits:
    """Limits of log blocks and of their values."""

    blocks: int = 16
    """Most blocks."""
    variables: int = 128
    """Most variables in all blocks."""
    block_size: int = 26
    """Most bytes of the values of one block."""
    largest_half_float: float = 65504.0
    """Largest number in a float of 16 bits."""
    largest_float: float = 3.4028234e38
    """A little less than the largest number in a float of 32 bits."""


LOG_LIMITS = LogLimits()


LETTER_OF_TYPE = {
    LOG_TYPES[kind]: letter for kind, letter in STRUCT_LETTERS.items()
} | {0: "", 8: "e"}
"""struct letter of each type; 0 has no bytes, and 8 is a float of 16 bits, which a client may ask for."""
ReadVariable = Callable[[str], float]
"""Callback that returns a log variable by name."""


@dataclass
class LogBlock:
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


def make_log_toc(entries: tuple[TocEntry, ...]) -> Toc:
    """Return the table of these log variables."""
    limits = bytes([LOG_LIMITS.blocks, LOG_LIMITS.variables])
    return Toc(CrtpPort.LOG, entries, LOG_TYPES, limits)


class LogService:
    """The log blocks that clients have asked for.

    toc: table of the log variables
    read: returns the current value of a log variable by name
    """

    def __init__(self, toc: Toc, read: ReadVariable) -> None:
        self.toc = toc
        self.read = read
        self.blocks: dict[int, LogBlock] = {}

    @property
    def running(self) -> bool:
        """Whether any block is sent periodically."""
        return any(block.period for block in self.blocks.values())

    def take(self, packet: ReceivedPacket, now: int) -> Iterator[Packet]:
        """Return the answers to a packet; now: ms of uptime."""
        if packet.channel == LOG_CHANNELS.table:
            is_item = packet.buffer[0] == TocCommand.ITEM
            yield from self.toc.take(packet.buffer[: 3 if is_item else 1])
        elif packet.channel == LOG_CHANNELS.settings:
            command, number = packet.buffer[:2]
            lists_variables = command in (BlockCommand.CREATE, BlockCommand.APPEND)
            rest = packet.data[2:] if lists_variables else packet.buffer[2:]
            error = self._do(command, number, rest, now)
            yield Packet(
                CrtpPort.LOG, LOG_CHANNELS.settings, bytes([command, number, error])
            )

    def due(self, now: int) -> Iterator[Packet]:
        """Return the packets that are due up to this ms of uptime, in the order of their times.

        A period may be shorter than a step of the world. Then several packets of a block come at
        once, each with its own time, and all with the values of the last step.
        """
        sent: list[tuple[int, int, LogBlock]] = []
        for number, block in self.blocks.items():
            if block.once:
                block.once = False
                sent.append((now, number, block))
            while block.period and block.due <= now:
                sent.append((block.due, number, block))
                block.due += block.period
        for time, number, block in sorted(sent, key=itemgetter(0)):
            yield self._data(number, block, time)

    def _data(self, number: int, block: LogBlock, time: int) -> Packet:
        values = b"".join(
            pack_log_value(letter, self.read(name) if name else 0.0)
            for name, letter in block.variables
        )
        return Packet(
            CrtpPort.LOG,
            LOG_CHANNELS.values,
            bytes([number]) + (time & 0xFFFFFF).to_bytes(3, "little") + values,
        )

    def _do(self, command: int, number: int, rest: bytes, now: int) -> int:
        if command == BlockCommand.RESET:
            self.blocks.clear()
            return FIRMWARE_RESULTS.done
        if command == BlockCommand.CREATE:
            return self._create(number) or self._append(number, rest)
        if command == BlockCommand.APPEND:
            return self._append(number, rest)
        if command not in CHANGE_COMMANDS:
            return FIRMWARE_RESULTS.unknown_command
        block = self.blocks.get(number)
        if block is None:
            return FIRMWARE_RESULTS.not_found
        if command == BlockCommand.DELETE:
            del self.blocks[number]
        elif command == BlockCommand.STOP:
            block.period = 0
        else:
            period = (
                10 * int.from_bytes(rest[:1], "little")
                if command == BlockCommand.START
                else int.from_bytes(rest[:2], "little")
            )
            block.once = not period
            block.period = period or block.period
            block.due = now + period
        return FIRMWARE_RESULTS.done

    def _create(self, number: int) -> int:
        if number in self.blocks:
            return FIRMWARE_RESULTS.exists
        if len(self.blocks) == LOG_LIMITS.blocks:
            return FIRMWARE_RESULTS.no_room
        self.blocks[number] = LogBlock()
        return FIRMWARE_RESULTS.done

    def _append(self, number: int, rest: bytes) -> int:
        """Add variables up to the first that does not fit.

        A new block stays in any case, as in the firmware.
        """
        block = self.blocks.get(number)
        if block is None:
            return FIRMWARE_RESULTS.not_found
        for kind, index in _parse_variables(rest):
            letter = LETTER_OF_TYPE.get(kind)
            if (
                letter is None
                or block.size + struct.calcsize(letter) > LOG_LIMITS.block_size
            ):
                return FIRMWARE_RESULTS.too_large
            if (
                sum(len(other.variables) for other in self.blocks.values())
                == LOG_LIMITS.variables
            ):
                return FIRMWARE_RESULTS.no_room
            if index != BY_ADDRESS_INDEX and index >= len(self.toc.entries):
                return FIRMWARE_RESULTS.not_found
            block.variables.append(
                (
                    "" if index == BY_ADDRESS_INDEX else self.toc.entries[index].full,
                    letter,
                )
            )
        return FIRMWARE_RESULTS.done


def _parse_variables(rest: bytes) -> Iterator[tuple[int, int]]:
    """Return types and indices of variables.

    A variable by address has four more bytes, and its value is 0.
    """
    at = 0
    while at + 3 <= len(rest):
        index = int.from_bytes(rest[at + 1 : at + 3], "little")
        yield rest[at] & 0x0F, index
        at += 7 if index == BY_ADDRESS_INDEX else 3


def pack_log_value(letter: str, value: float) -> bytes:
    """Return a value in the format of its letter.

    Whole numbers are limited to their range. A float that does not fit becomes 0.
    """
    if not letter:
        return b""
    if letter == "e":
        return struct.pack(
            "<e",
            min(
                max(value, -LOG_LIMITS.largest_half_float),
                LOG_LIMITS.largest_half_float,
            ),
        )
    if letter == "f":
        return struct.pack(
            "<f",
            value
            if abs(value) <= LOG_LIMITS.largest_float or not math.isfinite(value)
            else 0.0,
        )
    bits = 8 * struct.calcsize(letter)
    low, high = (
        (-(1 << bits - 1), (1 << bits - 1) - 1)
        if letter.islower()
        else (0, (1 << bits) - 1)
    )
    return truncate_to_range(value, low, high).to_bytes(
        bits // 8, "little", signed=letter.islower()
    )
