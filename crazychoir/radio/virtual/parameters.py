"""Port 2: parameters of a virtual drone.

A parameter that the firmware model knows acts at once. The others are only stored, and
`parameter_effects` says which of them the drone around the model uses.
"""

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum

from crazychoir.errors import ConfigError
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.radio.virtual.toc import PARAM_TYPES, Toc, TocEntry
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.parameters import PARAMETER_PLACES, RESET_ESTIMATION

PARAMETER_READ_CHANNEL = 1
"""Channel that reads parameters."""
PARAMETER_WRITE_CHANNEL = 2
"""Channel that writes parameters."""
PARAMETER_MISC_CHANNEL = 3
"""Channel of the commands of `ParameterCommand`."""


class ParameterResult(IntEnum):
    """Results of requests for parameters, with the numbers of errno."""

    OK = 0
    """The request was done."""
    ENOENT = 2
    """There is no such parameter, or it cannot be stored and so has no extended type."""
    EACCES = 13
    """The parameter is read-only."""
    EINVAL = 22
    """The type is not that of the parameter."""


class ParameterCommand(IntEnum):
    """Commands of PARAMETER_MISC_CHANNEL.

    An answer to a command with the suffix _V1 has no byte for the result, so an error looks like a
    value. The later command with the same purpose has this byte.
    """

    SET_BY_NAME = 0
    """Sets a parameter by its name."""
    VALUE_UPDATED = 1
    """Tells that the drone itself has changed a parameter."""
    EXTENDED_TYPE_V1 = 2
    """Asks whether a parameter can be stored."""
    STORE = 3
    """Stores a parameter."""
    STORED_STATE = 4
    """Asks for the stored value."""
    CLEAR_STORED = 5
    """Clears the stored value."""
    DEFAULT_VALUE_V1 = 6
    """Asks for the value after a start."""
    EXTENDED_TYPE = 7
    """Asks whether a parameter can be stored."""
    DEFAULT_VALUE = 8
    """Asks for the value after a start."""


@dataclass(frozen=True, slots=True)
class StorageAnswers:
    """Answers about the storage of a parameter."""

    persistent: int = 1
    """The parameter can be stored."""
    not_stored: int = 0
    """The parameter is not stored."""
    stored: int = 1
    """The parameter is stored."""


STORAGE_ANSWERS = StorageAnswers()


WrittenCallback = Callable[[TocEntry, float], None]
"""Callback that takes the entry and the value of a parameter that was set."""


def ignore_write(entry: TocEntry, value: float) -> None:
    """Ignore that a parameter was set."""


def make_parameter_toc(entries: tuple[TocEntry, ...]) -> Toc:
    """Return the table of these parameters."""
    return Toc(CrtpPort.PARAMETERS, entries, PARAM_TYPES)


class ParameterService:
    """Parameters by name.

    onboard: model of the firmware
    toc: table of the parameters
    stored: values that survive a restart, as in the drone's own memory
    written: called with the entry and the value after a client, or the drone's own memory at a
        start, has set a parameter
    """

    def __init__(
        self,
        onboard: Onboard,
        toc: Toc,
        stored: dict[str, float] | None = None,
        written: WrittenCallback = ignore_write,
    ) -> None:
        self.written = written
        self.onboard = onboard
        self.toc = toc
        self.values: dict[str, float] = {}
        """Values that were set since the start, by name."""
        self.stored = {} if stored is None else stored
        self._channels: tuple[Callable[[bytes], Iterator[Packet]], ...] = (
            self.toc.take,
            self._read,
            self._write,
            self._do_command,
        )

    def restore(self) -> None:
        """Set the stored parameters, as the firmware does when it starts."""
        for name, value in list(self.stored.items()):
            if name in self.toc.index:
                self.set(name, value)
                self.written(self.toc.entries[self.toc.index[name]], value)

    def take(self, packet: Packet) -> Iterator[Packet]:
        """Return the answers to a packet."""
        return self._channels[packet.channel](packet.data)

    def get(self, entry: TocEntry) -> float:
        """Return the current value of an entry."""
        return self.read(entry.full)

    def read(self, name: str) -> float:
        """Return the current value of a parameter in the table of contents."""
        if name in PARAMETER_PLACES:
            return self.onboard.get(name)
        if name in self.values:
            return self.values[name]
        return self.toc.entries[self.toc.index[name]].boot

    def set(self, name: str, value: float) -> None:
        """Set a parameter, even a read-only one, as the firmware itself does.

        A value that the model refuses is only stored.
        """
        if name in PARAMETER_PLACES or name == RESET_ESTIMATION:
            with suppress(ConfigError):
                self.onboard.write(name, value)
        self.values[name] = value

    def _found(self, data: bytes) -> TocEntry | None:
        k = int.from_bytes(data[:2], "little")
        return (
            self.toc.entries[k]
            if len(data) >= 2 and k < len(self.toc.entries)
            else None
        )

    def _read(self, data: bytes) -> Iterator[Packet]:
        entry = self._found(data)
        body = (
            bytes([ParameterResult.ENOENT])
            if entry is None
            else bytes([ParameterResult.OK]) + pack_parameter(entry, self.get(entry))
        )
        yield Packet(CrtpPort.PARAMETERS, PARAMETER_READ_CHANNEL, data[:2] + body)

    def _write(self, data: bytes) -> Iterator[Packet]:
        """Set a parameter and echo the packet.

        A read-only parameter gets no answer, as from the firmware.
        """
        entry = self._found(data)
        if entry is None:
            yield Packet(
                CrtpPort.PARAMETERS,
                PARAMETER_WRITE_CHANNEL,
                data[:2] + bytes([ParameterResult.ENOENT]),
            )
        elif not entry.read_only:
            self._take(entry, data[2:])
            yield Packet(CrtpPort.PARAMETERS, PARAMETER_WRITE_CHANNEL, data)
            yield from self._done()

    def _done(self) -> Iterator[Packet]:
        """Reset the parameter that starts an estimator reset, and tell the client.

        The firmware does this as soon as the reset has begun.
        """
        if self.values.pop(RESET_ESTIMATION, 0.0):
            index = self.toc.index[RESET_ESTIMATION].to_bytes(2, "little")
            yield Packet(
                CrtpPort.PARAMETERS,
                PARAMETER_MISC_CHANNEL,
                bytes([ParameterCommand.VALUE_UPDATED]) + index + b"\0",
            )

    def _take(self, entry: TocEntry, body: bytes) -> None:
        """Set a parameter from as many bytes as its type has.

        Missing bytes are 0, as in the firmware.
        """
        layout = struct.Struct("<" + entry.letter)
        (value,) = layout.unpack(body[: layout.size].ljust(layout.size, b"\0"))
        self.set(entry.full, value)
        self.written(entry, value)

    def _do_command(self, data: bytes) -> Iterator[Packet]:
        """Return the answers to a packet of the channel for commands; an unknown one has none."""
        if not data:
            return
        command = data[0]
        body = data[1:]
        match command:
            case ParameterCommand.SET_BY_NAME:
                yield from self._by_name(body)
                return
            case ParameterCommand.EXTENDED_TYPE_V1:
                answer = self._extended_type(body)[-1:]
            case ParameterCommand.EXTENDED_TYPE:
                answer = self._extended_type(body)
            case ParameterCommand.STORE | ParameterCommand.CLEAR_STORED:
                is_stored = command == ParameterCommand.STORE
                answer = bytes([self._keep(body, is_stored)])
            case ParameterCommand.STORED_STATE:
                answer = self._kept(body)
            case ParameterCommand.DEFAULT_VALUE_V1 | ParameterCommand.DEFAULT_VALUE:
                has_result = command == ParameterCommand.DEFAULT_VALUE
                answer = self._boot(body, has_result)
            case _:
                return
        yield Packet(
            CrtpPort.PARAMETERS,
            PARAMETER_MISC_CHANNEL,
            data[:3] + answer,
        )

    def _extended_type(self, body: bytes) -> bytes:
        """Return the result, and that the parameter can be stored.

        Only parameters that can be stored have an extended type.
        """
        entry = self._found(body)
        if entry is None or not entry.persistent:
            return bytes([ParameterResult.ENOENT])
        return bytes([ParameterResult.OK, STORAGE_ANSWERS.persistent])

    def _by_name(self, body: bytes) -> Iterator[Packet]:
        """Set a parameter by name; the packet has names, type and value.

        In the answer an error code takes the place of type and value. A packet without the names
        gets no answer.
        """
        parts = body.split(b"\0", 2)
        if len(parts) == 3:
            names = b"\0".join(parts[:2]) + b"\0"
            yield Packet(
                CrtpPort.PARAMETERS,
                PARAMETER_MISC_CHANNEL,
                bytes([ParameterCommand.SET_BY_NAME])
                + names
                + bytes([self._named(parts)]),
            )
            yield from self._done()

    def _named(self, parts: list[bytes]) -> int:
        k = self.toc.index.get(b".".join(parts[:2]).decode(errors="replace"))
        if k is None:
            return ParameterResult.ENOENT
        entry = self.toc.entries[k]
        if parts[2][:1] != bytes([PARAM_TYPES[entry.kind]]):
            return ParameterResult.EINVAL
        if entry.read_only:
            return ParameterResult.EACCES
        self._take(entry, parts[2][1:])
        return ParameterResult.OK

    def _keep(self, body: bytes, store: bool) -> int:
        entry = self._found(body)
        if entry is None or not entry.persistent:
            return ParameterResult.ENOENT
        if store:
            self.stored[entry.full] = self.get(entry)
        else:
            self.stored.pop(entry.full, None)
        return ParameterResult.OK

    def _kept(self, body: bytes) -> bytes:
        """Return whether a value is stored, the default value, and the stored value.

        The firmware answers this for any parameter, also if it cannot be stored.
        """
        entry = self._found(body)
        if entry is None:
            return bytes([ParameterResult.ENOENT])
        default = pack_parameter(entry, entry.default)
        if entry.full not in self.stored:
            return bytes([STORAGE_ANSWERS.not_stored]) + default
        return (
            bytes([STORAGE_ANSWERS.stored])
            + default
            + pack_parameter(entry, self.stored[entry.full])
        )

    def _boot(self, body: bytes, second: bool) -> bytes:
        entry = self._found(body)
        if entry is None or entry.read_only:
            return bytes([ParameterResult.ENOENT])
        return bytes([ParameterResult.OK] * second) + pack_parameter(
            entry, entry.default
        )


def pack_parameter(entry: TocEntry, value: float) -> bytes:
    """Return the bytes of a value, little endian, in the C type of its entry.

    A whole number that is too large keeps only its lowest bytes, as in a cast in C.
    """
    if entry.letter == "f":
        return struct.pack("<f", value)
    size = struct.calcsize(entry.letter)
    return (int(value) & (1 << 8 * size) - 1).to_bytes(size, "little")
