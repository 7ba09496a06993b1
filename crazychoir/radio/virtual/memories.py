"""Port 4: the memory for trajectories of a virtual drone, read and written piece by piece."""

import struct
from collections.abc import Iterator

from crazychoir.radio.crtp import MEMORY, Packet
from crazychoir.simulation.onboard.onboard import Onboard

INFO, READ, WRITE = range(3)
"""Channels."""
COUNT, ABOUT = 1, 2
"""Commands of INFO."""
TRAJECTORY = 0x12
"""Type of the one memory that there is."""
OK, EIO = 0, 5
MOST = 24
"""Bytes that one packet reads or writes."""
_ABOUT, _WHERE = struct.Struct("<BBBI8x"), struct.Struct("<BI")


class Memories:
    """One memory, number 0: the firmware's 4096 bytes for trajectories."""

    def __init__(self, onboard: Onboard) -> None:
        self.onboard = onboard

    def take(self, packet: Packet) -> Iterator[Packet]:
        """The answers to a packet."""
        data = packet.data
        if packet.channel == INFO:
            if data[:1] == bytes([COUNT]):
                yield Packet(MEMORY, INFO, bytes([COUNT, 1]))
            elif data[:1] == bytes([ABOUT]) and len(data) == 2:
                known = data[1] == 0
                body = _ABOUT.pack(ABOUT, 0, TRAJECTORY, self.onboard.memory.size) if known else data
                yield Packet(MEMORY, INFO, body)
        elif packet.channel in (READ, WRITE) and len(data) > _WHERE.size:
            number, address = _WHERE.unpack_from(data)
            body, reads = data[_WHERE.size :], packet.channel == READ
            status, found = self._read(number, address, body[0]) if reads else self._write(number, address, body)
            yield Packet(MEMORY, packet.channel, data[: _WHERE.size] + bytes([status]) + found)

    def _read(self, number: int, address: int, length: int) -> tuple[int, bytes]:
        memory = self.onboard.memory
        if number != 0 or length > MOST or address + length > memory.size:
            return EIO, b""
        return OK, memory[address : address + length].tobytes()

    def _write(self, number: int, address: int, body: bytes) -> tuple[int, bytes]:
        memory = self.onboard.memory
        if number != 0 or address + len(body) > memory.size:
            return EIO, b""
        memory[address : address + len(body)] = memoryview(body)
        return OK, b""
