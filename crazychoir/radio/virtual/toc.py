"""Tables of contents: what a drone calls its log variables and parameters, and how it tells a client."""

import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from crazychoir.radio.protocol.crtp import Packet

ITEM, INFO = 2, 3
"""Commands of channel 0, with indices of two bytes."""
LETTERS = {
    "uint8_t": "B",
    "uint16_t": "H",
    "uint32_t": "I",
    "int8_t": "b",
    "int16_t": "h",
    "int32_t": "i",
    "float": "f",
}
"""Of struct, by type."""
LOG_TYPES = {
    "uint8_t": 1,
    "uint16_t": 2,
    "uint32_t": 3,
    "int8_t": 4,
    "int16_t": 5,
    "int32_t": 6,
    "float": 7,
}
PARAM_TYPES = {
    "uint8_t": 0x08,
    "uint16_t": 0x09,
    "uint32_t": 0x0A,
    "int8_t": 0x00,
    "int16_t": 0x01,
    "int32_t": 0x02,
    "float": 0x06,
}
EXTENDED, READ_ONLY = 0x10, 0x40
"""Bits of a parameter's type: more is to be asked for, which is whether it is persistent; it cannot be written."""


@dataclass(frozen=True)
class Entry:
    """One name. kind: C type;  boot: value after a start, of parameters."""

    group: str
    name: str
    kind: str
    persistent: bool = False
    read_only: bool = False
    boot: float = 0.0

    @property
    def full(self) -> str:
        """As clients write it."""
        return f"{self.group}.{self.name}"

    @property
    def letter(self) -> str:
        """Of struct."""
        return LETTERS[self.kind]


@cache
def names() -> tuple[tuple[Entry, ...], tuple[Entry, ...]]:
    """Log variables and parameters of the firmware, in the order of their indices."""
    logs: list[Entry] = []
    parameters: list[Entry] = []
    for line in (
        (files("crazychoir.radio.virtual") / "names.txt")
        .read_text(encoding="utf-8")
        .splitlines()
    ):
        if not line.startswith("#"):
            which, group, *items = line.split()
            (logs if which == "L" else parameters).extend(
                _entry(group, item) for item in items
            )
    return _grouped(logs), _grouped(parameters)


def _grouped(entries: list[Entry]) -> tuple[Entry, ...]:
    """Those of a group one after the other, as the firmware has them, by name."""
    return tuple(sorted(entries, key=lambda entry: (entry.group, entry.name)))


def _entry(group: str, item: str) -> Entry:
    """Of "name:type*!=boot", the last three as far as they are there."""
    name, _, rest = item.partition(":")
    kind, _, boot = rest.partition("=")
    return Entry(
        group, name, kind.rstrip("*!"), "*" in kind, "!" in kind, float(boot or 0.0)
    )


class Toc:
    """The table of one port: entries by index, and their checksum, by which clients find what they have stored.

    kinds: the number that a type has on this port;  info: what the answer to INFO ends with.
    """

    def __init__(
        self,
        port: int,
        entries: Iterable[Entry],
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

    def kind(self, entry: Entry) -> int:
        """The type byte of an entry."""
        flags = EXTENDED * entry.persistent | READ_ONLY * entry.read_only
        return self._kinds[entry.kind] | flags

    def take(self, data: bytes) -> Iterator[Packet]:
        """The answer to a packet of channel 0."""
        match list(data):
            case [3]:
                body = (
                    bytes([INFO])
                    + struct.pack("<HI", len(self.entries), self.crc)
                    + self._info
                )
                yield Packet(self.port, 0, body)
            case [2, low, high]:
                yield Packet(self.port, 0, self._item(low | high << 8))

    def _item(self, k: int) -> bytes:
        """The answer for entry k; the command alone where there is none."""
        if k >= len(self.entries):
            return bytes([ITEM])
        entry = self.entries[k]
        return (
            struct.pack("<BHB", ITEM, k, self.kind(entry))
            + f"{entry.group}\0{entry.name}\0".encode()
        )
