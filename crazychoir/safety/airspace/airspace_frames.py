"""Frames of an airspace: the states of drones of a process, in one message to another process."""

from collections import deque

import numpy as np

from crazychoir.bus.codec import encode
from crazychoir.bus.message import Message
from crazychoir.bus.port import PORT_ADDRESSES, Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.airspace.airspace import Airspace
from crazychoir.safety.airspace.airspace_rows import ALL_BITS, FRAME_ROW
from crazychoir.types import Ints

PROCESS_BITS = 62
"""Number of processes with a bit of their own. Further processes share these bits."""

MOST_FRAMES = 1024
"""Number of frames that are kept between two steps. More than these replace the oldest ones."""


class AirspaceFrames:
    """Exchanges the states of drones with the other processes of the swarm.

    Each process sends another one the states that its drones need now: in rounds, because they are
    near, or because laws hear them. The first drone of a process stands for the process. Each
    process gets a bit when its first frame arrives. Until then it gets all that any process needs.

    airspace: of this process; call `hear` before each of its steps, and `send` after it
    """

    def __init__(self, airspace: Airspace) -> None:
        self.airspace = airspace
        self._address = airspace.own_ids[0]
        self._bits: dict[int, int] = {}
        """The bit of each other process, by the first of its drones."""
        self._told: Ints = np.zeros(len(airspace.own_ids), np.int64)
        """(n,): bits of the processes with laws that hear each own drone."""
        self._told_for: tuple[int, ...] | None = None
        """What `_told` was made for; None: it must be made anew."""
        self._number = 0
        self._rows = np.zeros(len(airspace.own_ids), FRAME_ROW)
        """(n,): the newest states of the own drones."""
        self._rows["drone"] = airspace.own_ids
        self._frames: deque[tuple[bytes, float, int, int]] = deque(maxlen=MOST_FRAMES)
        """The frames since the last step: each with its time in s, and host and bit of its sender."""
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
        is_new = airspace.numbers != self._rows["number"]
        bits = airspace.due_frame() | np.where(is_new, self._told, 0)
        self._number += 1
        self._fill_rows()
        if not bits.any():  # so it is in most ticks
            return
        payloads: dict[bytes, bytes] = {}
        for address in port.list_readers(DRONE_TOPICS.airspace):
            due = np.flatnonzero(bits & self._bits.get(address, ALL_BITS))
            if due.size == 0:
                continue
            payload = payloads.get(due.tobytes())
            if payload is None:
                payload = encode(self._rows[due].tobytes())
                payloads[due.tobytes()] = payload
            message = Message(
                DRONE_TOPICS.airspace, port.address, payload, self._number
            )
            port.send(message, (address,))

    def _fill_rows(self) -> None:
        """Write the newest states of the own drones for the other processes."""
        airspace = self.airspace
        rows = self._rows
        rows["number"] = airspace.numbers
        rows["age"] = airspace.now() - airspace.times
        rows["state"] = airspace.states[:, 0:13]
        rows["acceleration"] = airspace.states[:, 13:16]

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
        """Return the bits of the processes with laws that hear the drone of a port.

        A reader that is no drone of the airspace may be in any process. Then all get each state.
        """
        bits = 0
        for reader in port.list_readers(DRONE_TOPICS.framed_state):
            place = self.airspace.places.get(reader)
            if place is None:
                return ALL_BITS
            bits |= int(self.airspace.swarm["process_bits"][place])
        return bits

    def take(self, message: tuple[int, object], age: float) -> None:
        """Keep a frame that another process sent `age` s ago, until `hear`.

        message: address of the sender, and records of FRAME_ROW
        """
        source, frame = message
        place = self.airspace.places.get(source)
        if (
            place is None
            or not isinstance(frame, bytes)
            or len(frame) % FRAME_ROW.itemsize
        ):
            self.airspace.bus.ports[self._address].counters.malformed += 1
            return
        if source not in self._bits:
            self._bits[source] = 1 << len(self._bits) % PROCESS_BITS
        sent_time = self.airspace.now() - age
        host = int(self.airspace.swarm["host"][place])
        self._frames.append((frame, sent_time, host, self._bits[source]))

    def hear(self) -> None:
        """Let the own drones hear the frames that have arrived since the last call."""
        if not self._frames:
            return
        frames, *senders = zip(*self._frames, strict=True)
        self._frames.clear()
        rows = np.frombuffer(b"".join(frames), FRAME_ROW)
        counts = [len(frame) // FRAME_ROW.itemsize for frame in frames]
        times, hosts, bits = (np.repeat(np.array(column), counts) for column in senders)
        if self.airspace.hear_frames(rows, times, hosts, bits):
            self._told_for = None
