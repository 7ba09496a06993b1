"""Tables of contents: the names of a drone's log variables and parameters, and their packets."""

import struct
import zlib
from collections.abc import Iterable, Iterator
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

    @property
    def full(self) -> str:
        """Name in the form that clients use."""
        return f"{self.group}.{self.name}"

    @property
    def letter(self) -> str:
        """Letter of its type in struct."""
        return STRUCT_LETTERS[self.kind]


@cache
def read_firmware_names() -> tuple[tuple[TocEntry, ...], tuple[TocEntry, ...]]:
    """Return log variables and parameters of the firmware, in the order of their indices."""
    logs: list[TocEntry] = []
    parameters: list[TocEntry] = []
    for line in (
        (files("crazychoir.radio.virtual") / "names.txt")
        .read_text(encoding="utf-8")
        .splitlines()
    ):
        if not line.startswith("#"):
            which, group, *items = line.split()
            (logs if which == "L" else parameters).extend(
                _parse_entry(group, item) for item in items
            )
    return _sort_entries(logs), _sort_entries(parameters)


def _sort_entries(entries: list[TocEntry]) -> tuple[TocEntry, ...]:
    """Return the entries sorted by group and name, as the firmware has them."""
    return tuple(sorted(entries, key=lambda entry: (entry.group, entry.name)))


def _parse_entry(group: str, item: str) -> TocEntry:
    """Return the entry of a text "name:type*!=boot"; the last three parts are optional."""
    name, _, rest = item.partition(":")
    kind, _, boot = rest.partition("=")
    return TocEntry(
        group, name, kind.rstrip("*!"), "*" in kind, "!" in kind, float(boot or 0.0)
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
        if k >= len(self.entries):
            return bytes([TocCommand.ITEM])
        entry = self.entries[k]
        return (
            struct.pack("<BHB", TocCommand.ITEM, k, self.kind(entry))
            + f"{entry.group}\0{entry.name}\0".encode()
        )
