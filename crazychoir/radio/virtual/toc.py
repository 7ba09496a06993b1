"""Tables of contents: the names of a drone's log variables and parameters, and their packets."""

import csv
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from importlib.resources import files

from crazychoir.radio.protocol.crtp import Packet


class TocCommand(IntEnum):
    """Commands of channel 0, in the protocol version with indices of two bytes."""

    ITEM = 2
    """Asks for the description of an entry."""
    INFO = 3
    """Asks for the description of the table."""


STRUCT_LETTERS = {
    "uint8_t": "B",
    "uint16_t": "H",
    "uint32_t": "I",
    "int8_t": "b",
    "int16_t": "h",
    "int32_t": "i",
    "float": "f",
}
"""struct letter of each type."""
LOG_TYPES = {
    "uint8_t": 1,
    "uint16_t": 2,
    "uint32_t": 3,
    "int8_t": 4,
    "int16_t": 5,
    "int32_t": 6,
    "float": 7,
}
"""Number of each type in the table of log variables."""
PARAM_TYPES = {
    "uint8_t": 0x08,
    "uint16_t": 0x09,
    "uint32_t": 0x0A,
    "int8_t": 0x00,
    "int16_t": 0x01,
    "int32_t": 0x02,
    "float": 0x06,
}
"""Number of each type in the table of parameters."""


class TypeFlag(IntEnum):
    """Bits of a parameter's type."""

    EXTENDED = 0x10
    """A further request tells whether the parameter is persistent."""
    READ_ONLY = 0x40
    """The parameter cannot be written."""


@dataclass(frozen=True, slots=True)
class DeckConditions:
    """Values of the column `deck` of names.csv that are no names of decks."""

    always: str = ""
    """The firmware has the entry with or without decks."""
    any_deck: str = "any"
    """The firmware has the entry with any deck."""


DECK_CONDITIONS = DeckConditions()


@dataclass(frozen=True)
class TocEntry:
    """One entry of a table."""

    group: str
    """Group of the variable or parameter."""
    name: str
    """Name within the group."""
    kind: str
    """C type."""
    persistent: bool = False
    """True if the drone can store the parameter."""
    read_only: bool = False
    """True if clients cannot write the parameter."""
    boot: float = 0.0
    """Value of a parameter after a start."""
    default: float = 0.0
    """Default value of a parameter, as the drone answers a request for it."""
    deck: str = DECK_CONDITIONS.always
    """Names of the decks with which the drone has the entry, separated by "|", or one of
    DECK_CONDITIONS."""

    @property
    def full(self) -> str:
        """Name in the form that clients use."""
        return f"{self.group}.{self.name}"

    @property
    def letter(self) -> str:
        """Letter of its type in struct."""
        return STRUCT_LETTERS[self.kind]

    def is_on_board(self, decks: Sequence[str]) -> bool:
        """Return whether a drone with these decks has the entry."""
        if self.deck == DECK_CONDITIONS.always:
            return True
        if self.deck == DECK_CONDITIONS.any_deck:
            return bool(decks)
        return not set(self.deck.split("|")).isdisjoint(decks)


@cache
def read_firmware_names() -> tuple[tuple[TocEntry, ...], tuple[TocEntry, ...]]:
    """Return log variables and parameters of the firmware with all decks, by group and name."""
    text = (files("crazychoir.radio.virtual") / "names.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    return _parse_entries(rows, "log"), _parse_entries(rows, "parameter")


def _parse_entries(rows: list[dict[str, str]], table: str) -> tuple[TocEntry, ...]:
    """Return the entries of a table, sorted by group and name, as the firmware has them."""
    entries = [_parse_entry(row) for row in rows if row["table"] == table]
    return tuple(sorted(entries, key=lambda entry: (entry.group, entry.name)))


def _parse_entry(row: dict[str, str]) -> TocEntry:
    """Return the entry of a row of names.csv; an empty default is the value after a start."""
    boot = float(row["boot"] or 0.0)
    return TocEntry(
        group=row["group"],
        name=row["name"],
        kind=row["type"],
        persistent=row["persistent"] == "yes",
        read_only=row["access"] == "ro",
        boot=boot,
        default=float(row["default"] or boot),
        deck=row["deck"],
    )


class Toc:
    """The table of one port: entries by index, and a checksum by which clients find a stored table.

    port: port of the table
    entries: entries in the order of their indices
    kinds: number of each type on this port
    info: end of the answer to `TocCommand.INFO`
    """

    def __init__(
        self,
        port: int,
        entries: Iterable[TocEntry],
        kinds: dict[str, int],
        info: bytes = b"",
    ) -> None:
        self.port = port
        self.entries = tuple(entries)
        self._kinds = kinds
        self._info = info
        self._items = tuple(
            self._pack_item(k, entry) for k, entry in enumerate(self.entries)
        )
        self.index = {entry.full: k for k, entry in enumerate(self.entries)}
        self.crc = 0
        for entry in self.entries:
            self.crc = zlib.crc32(
                bytes([self.kind(entry)]) + entry.full.encode(), self.crc
            )

    def kind(self, entry: TocEntry) -> int:
        """Return the type byte of an entry."""
        flags = (
            TypeFlag.EXTENDED * entry.persistent | TypeFlag.READ_ONLY * entry.read_only
        )
        return self._kinds[entry.kind] | flags

    def take(self, data: bytes) -> Iterator[Packet]:
        """Return the answer to a packet of channel 0."""
        match list(data):
            case [TocCommand.INFO]:
                body = (
                    bytes([TocCommand.INFO])
                    + struct.pack("<HI", len(self.entries), self.crc)
                    + self._info
                )
                yield Packet(self.port, 0, body)
            case [TocCommand.ITEM, low, high]:
                yield Packet(self.port, 0, self._item(low | high << 8))

    def _item(self, k: int) -> bytes:
        """Return the answer for entry k; only the command if there is no such entry."""
        return self._items[k] if k < len(self._items) else bytes([TocCommand.ITEM])

    def _pack_item(self, k: int, entry: TocEntry) -> bytes:
        return (
            struct.pack("<BHB", TocCommand.ITEM, k, self.kind(entry))
            + f"{entry.group}\0{entry.name}\0".encode()
        )
