"""What a connected drone is asked and told: parameters, release, arming; each ends by its deadline."""

import difflib
import struct
from collections.abc import Mapping

from crazychoir.errors import LinkFailed
from crazychoir.radio.connection import Connection
from crazychoir.radio.crtp import FORMS, MEMORY, PARAM, PLATFORM, Packet

READ, WRITE = 1, 2
DEADLINE = 2.0
"""s of one request: eight times asked."""
CHUNK = 24
"""Bytes of a memory in one packet."""
TRAJECTORIES, SIZE = 1, 4096
"""Memory of trajectories: its number where it is the only one, and its bytes."""


class Firmware:
    """The firmware at the other end of a connection; raises LinkFailed for what it does not answer or do."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    async def release(self) -> str:
        """Its tag, as "2025.12"."""
        asked = Packet(PLATFORM, 1, b"\x01")
        answer = await self._ask(asked, lambda p: p[:2] == asked[:2] and p.data[:1] == b"\x01", "its release")
        return answer.data[1:].split(b"\0")[0].decode(errors="replace")

    async def get(self, name: str) -> float:
        """A parameter now."""
        element = self._parameter(name)
        ident = struct.pack("<H", element.ident)
        answer = await self._ask(
            Packet(PARAM, READ, ident), lambda p: p[:2] == (PARAM, READ) and p.data[:2] == ident, f"parameter {name}"
        )
        if len(answer.data) != 3 + struct.calcsize(element.pytype):
            raise LinkFailed(self.connection.uri, f"parameter {name}: its firmware does not read it")
        value: float = struct.unpack(element.pytype, answer.data[3:])[0]
        return value

    async def has(self, name: str) -> bool:
        """Whether it has a parameter of this name, and it is not 0."""
        there = self.connection.cf.param.toc.get_element_by_complete_name(name) is not None
        return there and await self.get(name) != 0

    async def set(self, name: str, value: float) -> float:
        """A parameter, to this value; what the firmware has taken."""
        element, uri = self._parameter(name), self.connection.uri
        if element.access == element.RO_ACCESS:
            raise LinkFailed(uri, f"parameter {name} can only be read")
        whole = element.pytype[-1] not in "fde"
        try:
            said = struct.pack(element.pytype, int(value) if whole else value)
        except (struct.error, OverflowError, ValueError) as error:
            raise LinkFailed(uri, f"parameter {name} = {value!r}: no {element.ctype} ({error})") from error
        ident = struct.pack("<H", element.ident)
        asked = Packet(PARAM, WRITE, ident + said)
        answer = await self._ask(
            asked, lambda p: p[:2] == (PARAM, WRITE) and p.data[:2] == ident, f"parameter {name} = {value}"
        )
        if answer.data != asked.data:
            raise LinkFailed(uri, f"parameter {name} = {value!r}: its firmware does not take it")
        return value

    async def set_all(self, values: Mapping[str, float]) -> None:
        """Several, one after the other."""
        for name, value in values.items():
            await self.set(name, value)

    async def arm(self, on: bool = True) -> None:
        """Let its motors turn, or not."""
        asked = FORMS["arm"].packet(on)
        head = bytes([0x80 | asked.data[0]])
        answer = await self._ask(asked, lambda p: p[:2] == asked[:2] and p.data[:1] == head, "arming")
        if answer.data[1:3] != bytes([1, on]):
            raise LinkFailed(self.connection.uri, "its firmware refuses to arm: see its supervisor")

    async def upload(self, memory: bytes, slot: int, pieces: int, offset: int = 0) -> None:
        """A trajectory of so many pieces, as planning/upload.py makes them, to be started by its slot."""
        if offset + len(memory) > SIZE:
            allowed = f"{SIZE} are there: 31 pieces"
            raise LinkFailed(self.connection.uri, f"trajectory {slot} ends at byte {offset + len(memory)}; {allowed}")
        for start in range(0, len(memory), CHUNK):
            head = struct.pack("<BI", TRAJECTORIES, offset + start)
            asked = Packet(MEMORY, WRITE, head + memory[start : start + CHUNK])
            answer = await self._ask(
                asked, lambda p, head=head: p[:2] == (MEMORY, WRITE) and p.data[:5] == head, f"trajectory {slot}"
            )
            if answer.data[5:6] != b"\0":
                raise LinkFailed(self.connection.uri, f"trajectory {slot}: its memory does not take byte {start}")
        await self.plan(FORMS["define_trajectory"].packet(slot, 1, 0, offset, pieces))

    async def plan(self, packet: Packet) -> None:
        """Something for the planner on board that may be said twice."""
        answer = await self._ask(packet, lambda p: p[:2] == packet[:2] and p.data[:3] == packet.data[:3], "a plan")
        if answer.data[3:4] != b"\0":
            raise LinkFailed(self.connection.uri, f"its planner refuses ({answer.data[3]})")

    async def _ask(self, packet: Packet, answers: object, what: str) -> Packet:
        try:
            return await self.connection.ask(packet, answers, DEADLINE)  # type: ignore[arg-type]
        except TimeoutError:
            raise LinkFailed(self.connection.uri, f"no answer about {what} within {DEADLINE:g} s") from None

    def _parameter(self, name: str) -> "Element":
        element = self.connection.cf.param.toc.get_element_by_complete_name(name)
        if element is None:
            toc = self.connection.cf.param.toc.toc
            known = [f"{group}.{item}" for group, items in toc.items() for item in items]
            near = ", ".join(difflib.get_close_matches(name, known, 3, 0.4)) or "none like it"
            raise LinkFailed(self.connection.uri, f"its firmware has no parameter {name}; it has {near}")
        return element  # type: ignore[no-any-return]


class Element:
    """What of cflib's entry of a table is read here."""

    ident: int
    pytype: str
    ctype: str
    access: int
    RO_ACCESS: int
