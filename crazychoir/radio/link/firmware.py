"""Requests to a connected drone: parameters, release, arming, trajectories.

Each ends by its deadline.
"""

import difflib
import math
import struct
from collections.abc import Callable, Mapping
from functools import partial

from crazychoir.errors import LinkFailed
from crazychoir.firmware.memories import (
    MEMORY_KINDS,
    MEMORY_PACKETS,
    TRAJECTORY_KINDS,
    TRAJECTORY_MEMORY,
)
from crazychoir.firmware.requests import (
    PARAMETER_CHANNELS,
    PLATFORM_REQUESTS,
    SUPERVISOR_REQUESTS,
)
from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.pending_requests import REQUEST_RETRY_PERIOD
from crazychoir.radio.protocol.crtp import PACKET_FORMS, CrtpPort, Packet
from crazychoir.radio.protocol.handlers import ALL_GROUPS

COUNT_REQUEST = Packet(
    CrtpPort.MEMORY, MEMORY_PACKETS.information, bytes([MEMORY_PACKETS.count_command])
)
"""Packet that asks for the number of memories."""
REQUEST_DEADLINE = 2.0
"""Seconds for one request, which is sent eight times by then."""


class ConnectedFirmware:
    """The firmware at the other end of a connection.

    Its methods raise LinkFailed if the firmware does not answer, or does not do what they ask.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    async def release(self) -> str:
        """Return the firmware's release tag, such as "2025.12"."""
        asked = Packet(
            CrtpPort.PLATFORM,
            PLATFORM_REQUESTS.version_channel,
            bytes([PLATFORM_REQUESTS.release]),
        )
        answer = await self._ask(
            asked,
            lambda p: p[:2] == asked[:2] and p.data[:1] == asked.data,
            "its release",
        )
        return answer.data[1:].split(b"\0")[0].decode(errors="replace")

    async def get(self, name: str) -> float:
        """Return the value of a parameter."""
        element = self._parameter(name)
        ident = struct.pack("<H", element.ident)
        answer = await self._ask(
            Packet(CrtpPort.PARAMETERS, PARAMETER_CHANNELS.read, ident),
            lambda p: (
                p[:2] == (CrtpPort.PARAMETERS, PARAMETER_CHANNELS.read)
                and p.data[:2] == ident
            ),
            f"parameter {name}",
        )
        if len(answer.data) != 3 + struct.calcsize(element.pytype):
            raise LinkFailed(
                self.connection.uri, f"parameter {name}: its firmware does not read it"
            )
        value: float = struct.unpack(element.pytype, answer.data[3:])[0]
        return value

    async def has(self, name: str) -> bool:
        """Return whether the drone has a parameter of this name and its value is not 0."""
        there = (
            self.connection.cf.param.toc.get_element_by_complete_name(name) is not None
        )
        return there and await self.get(name) != 0

    async def set(self, name: str, value: float) -> float:
        """Set a parameter, and return the value that the firmware has taken."""
        element = self._parameter(name)
        uri = self.connection.uri
        if element.access == element.RO_ACCESS:
            raise LinkFailed(uri, f"parameter {name} can only be read")
        try:
            said = _pack_value(element.pytype, value)
        except (struct.error, OverflowError, TypeError, ValueError) as error:
            allowed = f"{_describe_range(element.pytype)} ({element.ctype})"
            raise LinkFailed(
                uri, f"parameter {name} = {value!r}; allowed: {allowed}"
            ) from error
        asked = Packet(
            CrtpPort.PARAMETERS,
            PARAMETER_CHANNELS.write,
            struct.pack("<H", element.ident) + said,
        )
        answer = await self._ask(
            asked, partial(_is_write_answer, asked), f"parameter {name} = {value}"
        )
        if answer.data != asked.data:
            raise LinkFailed(
                uri, f"parameter {name} = {value!r}: its firmware does not accept it"
            )
        return value

    def list_names(self, name: str) -> list[str]:
        """Return the parameters of a group, or the parameter of this name.

        Raises LinkFailed if there is none.
        """
        toc = self.connection.cf.param.toc.toc
        if name in toc:
            return [f"{name}.{item}" for item in sorted(toc[name])]
        self._parameter(name)
        return [name]

    def describe_parameters(self) -> dict[str, tuple[str, bool]]:
        """Return, by name, the type of each parameter and whether it can be set."""
        toc = self.connection.cf.param.toc.toc
        return {
            f"{group}.{item}": (element.ctype, element.access != element.RO_ACCESS)
            for group, items in sorted(toc.items())
            for item, element in sorted(items.items())
        }

    async def set_all(self, values: Mapping[str, float]) -> None:
        """Set several parameters, one after the other."""
        for name, value in values.items():
            await self.set(name, value)

    async def arm(self, on: bool = True) -> None:
        """Arm the drone, or disarm it."""
        asked = PACKET_FORMS["arm"].packet(on)
        head = bytes([SUPERVISOR_REQUESTS.answer | asked.data[0]])
        answer = await self._ask(
            asked, lambda p: p[:2] == asked[:2] and p.data[:1] == head, "arming"
        )
        if answer.data[1:3] != bytes([1, on]):
            raise LinkFailed(
                self.connection.uri, "its firmware refuses to arm: see its supervisor"
            )

    async def upload(
        self, memory: bytes, slot: int, pieces: int, offset: int = 0
    ) -> None:
        """Upload a trajectory, which is then started by its slot.

        Too large a trajectory is refused before anything is sent.

        memory: bytes from planning/upload.py
        pieces: number of pieces
        offset: first byte in the memory of trajectories
        """
        uri = self.connection.uri
        if not 0 <= slot < TRAJECTORY_MEMORY.slot_count:
            raise LinkFailed(
                uri,
                f"trajectory {slot}: slots 0 to {TRAJECTORY_MEMORY.slot_count - 1} are there",
            )
        if not 0 <= offset <= offset + len(memory) <= TRAJECTORY_MEMORY.byte_count:
            allowed = f"{TRAJECTORY_MEMORY.byte_count} are there: {TRAJECTORY_MEMORY.most_pieces} pieces"
            raise LinkFailed(
                uri, f"trajectory {slot} ends at byte {offset + len(memory)}; {allowed}"
            )
        where = await self._memory()
        for start in range(0, len(memory), MEMORY_PACKETS.largest_part):
            head = struct.pack("<BI", where, offset + start)
            asked = Packet(
                CrtpPort.MEMORY,
                MEMORY_PACKETS.write,
                head + memory[start : start + MEMORY_PACKETS.largest_part],
            )
            answer = await self._ask(
                asked, partial(_is_memory_write_answer, head), f"trajectory {slot}"
            )
            if answer.data[5:6] != bytes([FIRMWARE_RESULTS.done]):
                raise LinkFailed(
                    self.connection.uri,
                    f"trajectory {slot}: its memory does not accept byte {start}",
                )
        await self.plan(
            PACKET_FORMS["define_trajectory"].packet(
                slot,
                TRAJECTORY_KINDS.memory,
                TRAJECTORY_KINDS.polynomial,
                offset,
                pieces,
            )
        )

    async def start(
        self,
        slot: int,
        timescale: float = 1.0,
        relative: bool = False,
        is_reversed: bool = False,
    ) -> None:
        """Start an uploaded trajectory.

        The packet is sent once: a second packet, after a lost answer, would start the trajectory
        again.

        timescale: factor by which the trajectory is slower
        relative: start from where the drone is
        is_reversed: fly it from its end to its start
        """
        await self.plan(
            PACKET_FORMS["start_trajectory"].packet(
                ALL_GROUPS, relative, False, is_reversed, slot, timescale
            ),
            math.inf,
        )

    async def _memory(self) -> int:
        """Return the number of the memory of trajectories.

        cflib would read the memories of decks too.
        """
        count = await self._ask(
            COUNT_REQUEST,
            lambda p: p[:2] == COUNT_REQUEST[:2] and p.data[:1] == COUNT_REQUEST.data,
            "its memories",
        )
        for number in range(count.data[1] if len(count.data) > 1 else 0):
            asked = Packet(
                CrtpPort.MEMORY,
                MEMORY_PACKETS.information,
                bytes([MEMORY_PACKETS.description_command, number]),
            )
            answer = await self._ask(
                asked, partial(_is_memory_description, asked), f"memory {number}"
            )
            if answer.data[2:3] == bytes([MEMORY_KINDS.trajectory]):
                return number
        raise LinkFailed(
            self.connection.uri, "its firmware has no memory for trajectories"
        )

    async def plan(self, packet: Packet, again: float = REQUEST_RETRY_PERIOD) -> None:
        """Send a packet to the planner on board, and wait until it accepts.

        again: s after which it is sent again; infinite for a packet that must not be sent twice
        Raises LinkFailed if the planner refuses, or does not answer within REQUEST_DEADLINE s.
        """
        answer = await self._ask(
            packet,
            lambda p: p[:2] == packet[:2] and p.data[:3] == packet.data[:3],
            "a plan",
            again,
        )
        if answer.data[3:4] != bytes([FIRMWARE_RESULTS.done]):
            raise LinkFailed(
                self.connection.uri, f"its planner refuses ({answer.data[3]})"
            )

    async def _ask(
        self,
        packet: Packet,
        answers: Callable[[Packet], bool],
        what: str,
        again: float = REQUEST_RETRY_PERIOD,
    ) -> Packet:
        try:
            return await self.connection.ask(packet, answers, REQUEST_DEADLINE, again)
        except TimeoutError:
            raise LinkFailed(
                self.connection.uri,
                f"no answer about {what} within {REQUEST_DEADLINE:g} s",
            ) from None

    def _parameter(self, name: str) -> "ParameterElement":
        element = self.connection.cf.param.toc.get_element_by_complete_name(name)
        if element is None:
            toc = self.connection.cf.param.toc.toc
            known = [
                f"{group}.{item}" for group, items in toc.items() for item in items
            ]
            near = (
                ", ".join(difflib.get_close_matches(name, known, 3, 0.4))
                or "none like it"
            )
            raise LinkFailed(
                self.connection.uri,
                f"its firmware has no parameter {name}; it has {near}",
            )
        return element  # type: ignore[no-any-return]


LARGEST_FLOATS = {"e": 65504.0, "f": 3.4028235e38, "d": 1.7976931348623157e308}
"""Largest number of each floating-point kind, by struct's letter."""


def _pack_value(kind: str, value: float) -> bytes:
    """Return a value in the firmware's format.

    Raises the errors of int, float and struct; ValueError if it is not finite.
    """
    if kind[-1] not in LARGEST_FLOATS:
        return struct.pack(kind, int(value))
    if not math.isfinite(value):
        raise ValueError(value)
    return struct.pack(kind, value)


def _describe_range(kind: str) -> str:
    """Return the range of a kind as text."""
    if kind[-1] in LARGEST_FLOATS:
        return f"finite numbers, {-LARGEST_FLOATS[kind[-1]]:.5g} to {LARGEST_FLOATS[kind[-1]]:.5g}"
    bits = 8 * struct.calcsize(kind)
    signed = kind[-1].islower()
    return (
        f"{-(1 << bits - 1)} to {(1 << bits - 1) - 1}"
        if signed
        else f"0 to {(1 << bits) - 1}"
    )


def _is_write_answer(asked: Packet, packet: Packet) -> bool:
    """Return whether a packet answers this write of a parameter.

    The answer has the value written, or an error of three bytes. A repeated request gets two
    answers, and a late answer to an earlier value must not count. A value of one byte is as long as
    an error; then only the written value counts.
    """
    if (
        packet[:2] != (CrtpPort.PARAMETERS, PARAMETER_CHANNELS.write)
        or packet.data[:2] != asked.data[:2]
    ):
        return False
    return packet.data == asked.data or len(packet.data) == 3 != len(asked.data)


def _is_memory_description(asked: Packet, packet: Packet) -> bool:
    """Return whether a packet describes this memory."""
    return packet[:2] == asked[:2] and packet.data[:2] == asked.data


def _is_memory_write_answer(head: bytes, packet: Packet) -> bool:
    """Return whether a packet answers a write of a memory with this head."""
    return (
        packet[:2] == (CrtpPort.MEMORY, MEMORY_PACKETS.write)
        and packet.data[:5] == head
    )


class ParameterElement:
    """The fields of cflib's table entries that are read here."""

    ident: int
    pytype: str
    ctype: str
    access: int
    RO_ACCESS: int
