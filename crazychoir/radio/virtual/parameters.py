"""Port 2: parameters of a virtual drone: those that its firmware models act at once, the others are remembered."""

import math
import struct
from collections.abc import Callable, Iterator

from crazychoir.errors import ConfigError
from crazychoir.radio.crtp import PARAM, Packet
from crazychoir.radio.virtual.toc import PARAM_TYPES, Entry, Toc
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.parameters import RESET_ESTIMATION, TABLE

TOC, READ, WRITE, MISC = range(4)
"""Channels."""
OK, ENOENT = 0, 2
SET_BY_NAME, UPDATED, EXTENDED_V1, STORE, STATE, CLEAR, DEFAULT_V1, EXTENDED, DEFAULT = range(9)
"""Commands of MISC."""
PERSISTENT = 1
NOT_STORED, STORED = 0, 1


class Parameters:
    """Values by name; `stored` survives a restart, as on the drone's own memory."""

    def __init__(self, onboard: Onboard, entries: tuple[Entry, ...], stored: dict[str, float] | None = None) -> None:
        self.onboard, self.toc = onboard, Toc(PARAM, entries, PARAM_TYPES)
        self.values = {entry.full: entry.boot for entry in entries}
        self.stored = {} if stored is None else stored
        self._channels: tuple[Callable[[bytes], Iterator[Packet]], ...] = (
            self.toc.take, self._read, self._write, self._misc,
        )  # fmt: skip
        for entry in entries:
            if not entry.read_only and entry.full in self.stored:
                self._set(entry, self.stored[entry.full])

    def take(self, packet: Packet) -> Iterator[Packet]:
        """The answers to a packet."""
        return self._channels[packet.channel](packet.data)

    def get(self, entry: Entry) -> float:
        """Its value now."""
        if entry.full in TABLE:
            return self.onboard.get(entry.full)
        return self.values[entry.full]

    def _set(self, entry: Entry, value: float) -> None:
        if entry.full in TABLE or entry.full == RESET_ESTIMATION:
            self.onboard.set(entry.full, value)
        self.values[entry.full] = value

    def _found(self, data: bytes) -> Entry | None:
        k = int.from_bytes(data[:2], "little")
        return self.toc.entries[k] if len(data) >= 2 and k < len(self.toc.entries) else None

    def _read(self, data: bytes) -> Iterator[Packet]:
        entry = self._found(data)
        body = bytes([ENOENT]) if entry is None else bytes([OK]) + packed(entry, self.get(entry))
        yield Packet(PARAM, READ, data[:2] + body)

    def _write(self, data: bytes) -> Iterator[Packet]:
        """Echoed with the value that it has then; one that cannot be written is not answered, as by the firmware."""
        entry = self._found(data)
        if entry is None:
            yield Packet(PARAM, WRITE, data[:2] + bytes([ENOENT]))
        elif not entry.read_only and self._taken(entry, data[2:]):
            yield Packet(PARAM, WRITE, data[:2] + packed(entry, self.get(entry)))

    def _taken(self, entry: Entry, body: bytes) -> bool:
        layout = struct.Struct("<" + entry.letter)
        if len(body) != layout.size:
            return False
        (value,) = layout.unpack(body)
        if not math.isfinite(value):
            return False
        try:
            self._set(entry, value)
        except ConfigError:
            return False
        return True

    def _misc(self, data: bytes) -> Iterator[Packet]:
        command, body = data[:1], data[1:]
        match command[0] if command else -1:
            case 0:
                yield Packet(PARAM, MISC, data + bytes([self._by_name(body)]))
            case 2 | 7:
                entry = self._found(body)
                known = entry is not None and entry.persistent
                answer = bytes([ENOENT]) if entry is None else bytes([OK, PERSISTENT * known])
                yield Packet(PARAM, MISC, command + body[:2] + (answer if command[0] == EXTENDED else answer[-1:]))
            case 3 | 5:
                yield Packet(PARAM, MISC, command + body[:2] + bytes([self._keep(body, command[0] == STORE)]))
            case 4:
                yield Packet(PARAM, MISC, command + body[:2] + self._kept(body))
            case 6 | 8:
                yield Packet(PARAM, MISC, command + body[:2] + self._boot(body, command[0] == DEFAULT))

    def _by_name(self, body: bytes) -> int:
        group, _, rest = body.partition(b"\0")
        name, _, rest = rest.partition(b"\0")
        k = self.toc.index.get(f"{group.decode(errors='replace')}.{name.decode(errors='replace')}")
        if k is None or not rest:
            return ENOENT
        entry = self.toc.entries[k]
        return OK if not entry.read_only and self._taken(entry, rest[1:]) else ENOENT

    def _keep(self, body: bytes, store: bool) -> int:
        entry = self._found(body)
        if entry is None or not entry.persistent:
            return ENOENT
        if store:
            self.stored[entry.full] = self.get(entry)
        else:
            self.stored.pop(entry.full, None)
        return OK

    def _kept(self, body: bytes) -> bytes:
        entry = self._found(body)
        if entry is None or not entry.persistent:
            return bytes([ENOENT])
        default = packed(entry, entry.boot)
        if entry.full not in self.stored:
            return bytes([NOT_STORED]) + default
        return bytes([STORED]) + default + packed(entry, self.stored[entry.full])

    def _boot(self, body: bytes, second: bool) -> bytes:
        entry = self._found(body)
        if entry is None or entry.read_only:
            return bytes([ENOENT])
        return bytes([OK] * second) + packed(entry, entry.boot)


def packed(entry: Entry, value: float) -> bytes:
    """As it travels; whole numbers are cut to what their type holds."""
    if entry.letter == "f":
        return struct.pack("<f", value)
    size = struct.calcsize(entry.letter)
    return (int(value) & (1 << 8 * size) - 1).to_bytes(size, "little")
