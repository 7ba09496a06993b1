"""Frames of an airspace: the states of all drones of a process, in one message to the others."""

from typing import Any

import numpy as np

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.airspace.airspace import Airspace


class AirspaceFrames:
    """Exchanges the states of drones with the other processes of the swarm.

    airspace: of this process; call `send` after each of its steps
    """

    def __init__(self, airspace: Airspace) -> None:
        self.airspace = airspace
        self._address = airspace.own_ids[0]
        bus = airspace.bus
        bus.subscribe(
            DRONE_TOPICS.airspace,
            PORT_ADDRESSES.any_drone,
            self._address,
            Call(bus.clock, self.take, "airspace"),
        )

    def send(self) -> None:
        """Publish the states that drones of other processes need now."""
        airspace = self.airspace
        due = airspace.due_frame()
        port = airspace.bus.ports.get(self._address)
        if due.size == 0 or port is None:
            return
        frame = [
            airspace.swarm["drone"][airspace.own_places[due]].copy(),
            airspace.numbers[due],
            airspace.states[due],
            airspace.now() - airspace.times[due],
        ]
        port.publish(DRONE_TOPICS.airspace, frame)

    def take(self, message: tuple[int, list[Any]], age: float) -> None:
        """Let the own drones hear a frame that another process sent `age` s ago.

        message: address of the sender, and the arguments of Airspace.hear_frame
        """
        frame = message[1]
        if not is_frame(frame):
            self.airspace.bus.ports[self._address].counters.malformed += 1
            return
        ids, numbers, states, ages = frame
        self.airspace.hear_frame(ids, numbers, states, ages + age)


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
