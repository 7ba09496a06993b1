"""Frames of an airspace: the states of drones of a process, in one message to another process."""

from typing import Any

import numpy as np

from crazychoir.bus.codec import encode
from crazychoir.bus.port import PORT_ADDRESSES, Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.airspace.airspace import Airspace
from crazychoir.safety.airspace.airspace_rows import ALL_BITS
from crazychoir.types import Ints

PROCESS_BITS = 62
"""Number of processes with a bit of their own. Further processes share these bits."""


class AirspaceFrames:
    """Exchanges the states of drones with the other processes of the swarm.

    Each process sends another one the states that its drones need now: in rounds, because they are
    near, or because laws hear them. The first drone of a process stands for the process. Each
    process gets a bit when its first frame arrives. Until then it gets all that any process needs.

    airspace: of this process; call `send` after each of its steps
    """

    def __init__(self, airspace: Airspace) -> None:
        self.airspace = airspace
        self._address = airspace.own_ids[0]
        self._bits: dict[int, int] = {}
        """The bit of each other process, by the first of its drones."""
        self._told: Ints = np.zeros(len(airspace.own_ids), np.int64)
        """(n,): bits of the processes with laws that hear each own drone."""
        self._told_for: tuple[int, ...] = ()
        self._number = 0
        bus = airspace.bus
        bus.subscribe(
            DRONE_TOPICS.airspace,
            PORT_ADDRESSES.any_drone,
            self._address,
            Call(bus.clock, self.take, "airspace"),
        )

    def send(self) -> None:
        """Send the states that drones of other processes need now."""
        airspace = self.airspace
        port = airspace.bus.ports.get(self._address)
        if port is None:
            return
        self._refresh_told()
        bits = airspace.due_frame() | self._told
        self._number += 1
        payloads: dict[bytes, bytes] = {}
        for address in port.list_readers(DRONE_TOPICS.airspace):
            due = np.flatnonzero(bits & self._bits.get(address, ALL_BITS))
            if due.size == 0:
                continue
            payload = payloads.get(due.tobytes())
            if payload is None:
                payload = payloads[due.tobytes()] = self._encode(due)
            port.send(DRONE_TOPICS.airspace, (address,), payload, self._number)

    def _encode(self, due: Ints) -> bytes:
        """Return the frame with these own drones."""
        airspace = self.airspace
        return encode(
            [
                airspace.swarm["drone"][airspace.own_places[due]].copy(),
                airspace.numbers[due],
                airspace.states[due],
                airspace.now() - airspace.times[due],
            ]
        )

    def _refresh_told(self) -> None:
        """Note anew which processes have laws that hear the own drones, if that has changed."""
        airspace = self.airspace
        bus = airspace.bus
        read = bus.find_read_addresses(DRONE_TOPICS.framed_state)
        if read is self._told_for:
            return
        self._told_for = read
        self._told[:] = 0
        for at, i in enumerate(airspace.own_ids):
            if i in read and i in bus.ports:
                self._told[at] = self._find_bits(bus.ports[i])

    def _find_bits(self, port: Port) -> int:
        """Return the bits of the processes with laws that hear the drone of a port."""
        bits = 0
        for reader in port.list_readers(DRONE_TOPICS.framed_state):
            place = self.airspace.places.get(reader)
            if place is not None:
                bits |= int(self.airspace.swarm["process_bits"][place])
        return bits

    def take(self, message: tuple[int, list[Any]], age: float) -> None:
        """Let the own drones hear a frame that another process sent `age` s ago.

        message: address of the sender, and the arguments of Airspace.hear_frame
        """
        source, frame = message
        if not is_frame(frame):
            self.airspace.bus.ports[self._address].counters.malformed += 1
            return
        ids, numbers, states, ages = frame
        self._note_process(source, ids)
        self.airspace.hear_frame(ids, numbers, states, ages, age)

    def _note_process(self, source: int, ids: Ints) -> None:
        """Note the process that flies these drones, by the first of its drones."""
        bit = self._bits.get(source)
        if bit is None:
            bit = self._bits[source] = 1 << len(self._bits) % PROCESS_BITS
        places = [self.airspace.places.get(j, -1) for j in ids.tolist()]
        if np.any(self.airspace.swarm["process_bits"][places] != bit):
            self.airspace.note_process(ids, bit)
            self._told_for = ()


def is_frame(frame: list[Any]) -> bool:
    """Return whether a message contains the arguments of Airspace.hear_frame."""
    if len(frame) != 4 or not all(isinstance(part, np.ndarray) for part in frame):
        return False
    ids, numbers, states, ages = frame
    count = len(ids) if ids.ndim == 1 else -1
    return bool(
        ids.dtype == numbers.dtype == np.int64
        and states.dtype == ages.dtype == np.float64
        and ids.shape == numbers.shape == ages.shape == (count,)
        and states.shape == (count, 16)
        and np.all(ages >= 0.0)
    )
