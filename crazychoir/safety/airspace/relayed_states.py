"""Relayed states: a drone asks others about drones that it does not hear, and answers them."""

from typing import Any

from crazychoir.bus.codec import encode
from crazychoir.bus.message import Message
from crazychoir.bus.topics import MESSAGE_TOPICS, Topic
from crazychoir.errors import CodecError
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.types import State


class RelayedStates:
    """Asks others for states, and answers them.

    A relayed state counts as heard, except for the question whether this drone is cut off.

    If one link fails, other drones hear both its ends. Two drones that do not hear each other have
    such a third drone between them, unless one of the two hears less than half of the others. That
    drone lands (NEIGHBOUR_AGES.deaf). The reason: let F be the number of flying drones, as both know. Both hear at
    least (F - 1) / 2 of the F - 2 others. So a drone that gets no answer may assume that the other
    one comes down.

    It is unknown whether the drones that were last seen on the floor fly. A network that splits
    before the take-off is for the roster to notice.

    traffic: what this drone knows of the others
    """

    def __init__(self, traffic: Neighbours) -> None:
        self.traffic = traffic
        self.port = traffic.port
        self._sent = 0
        self.port.handlers[MESSAGE_TOPICS.wanted_states.number] = self._asked
        self.port.handlers[MESSAGE_TOPICS.relayed_states.number] = self._told

    def seek(self) -> None:
        """Ask for some of the drones from which a newer state is needed soon."""
        asked: dict[int, list[int]] = {}
        for j, sought in self.traffic.choose_asked():
            asked.setdefault(j, []).append(sought)
        for j, those in asked.items():
            self._send(MESSAGE_TOPICS.wanted_states, j, those)

    def _send(self, topic: Topic, to: int, value: list[Any]) -> None:
        """Send a list, unless it is empty."""
        if value:
            self._sent += 1
            payload = encode(value)
            message = Message(topic, self.port.address, payload, self._sent)
            self.port.send(message, (to,))

    def _asked(self, message: Message, age: float) -> None:
        """Answer a question with the usable states of the drones it lists."""
        traffic = self.traffic
        those = self._opened(message)
        now = traffic.now()
        told = []
        for j in those if all(type(j) is int for j in those) else self._none():
            row = traffic.known(j)
            if row is not None and now - row["state_time"] < NEIGHBOUR_AGES.usable:
                state = State(row["state"].copy(), 0.0, row["acceleration"].copy())
                told.append([j, state, now - float(row["state_time"])])
        self._send(MESSAGE_TOPICS.relayed_states, message.source, told)

    def _told(self, message: Message, age: float) -> None:
        """Keep the states of an answer."""
        for item in self._opened(message):
            match item:
                case [int(j), State() as state, float(old)] if (
                    0.0 <= old < NEIGHBOUR_AGES.gone
                ):
                    self.traffic.told((j, state), age + old)
                case _:
                    self._none()

    def _opened(self, message: Message) -> list[Any]:
        """Return the list in a message.

        Returns an empty list, and counts the message as malformed, if it is none or longer than the
        number of drones.
        """
        try:
            value = message.open()
        except CodecError:
            return self._none()
        return (
            value
            if isinstance(value, list) and len(value) < len(self.traffic.airspace.ids)
            else self._none()
        )

    def _none(self) -> list[Any]:
        """Count a malformed message and return an empty list."""
        self.port.counters.malformed += 1
        return []
