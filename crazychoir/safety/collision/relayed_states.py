"""Relayed states: a drone asks others about drones that it does not hear, and answers them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.topics import MESSAGE_TOPICS, Topic
from crazychoir.errors import CodecError
from crazychoir.safety.collision.neighbour_table import (
    NEIGHBOUR_AGES,
    NEIGHBOUR_ROW,
    NeighbourTable,
)
from crazychoir.types import State


@dataclass(frozen=True, slots=True)
class RelayRequests:
    """When a drone asks others for a newer state of a third one, and how many of them."""

    least_age: float = 0.25
    """Age in s of a state before which no newer one is asked for."""
    lead_time: float = 1.0
    """Seconds before the drone would brake for want of a state, at which it begins to ask."""
    checks_if_unanswered: int = 5
    """Number of checks between two questions about a drone unanswered for RELAY_REQUESTS.lead_time s."""
    checks_if_gone: int = 10
    """Number of checks between two questions about a drone that is gone or was never heard."""
    nearest_asked: int = 2
    """Number of drones that are asked each time about one drone.

    They are the heard drones that are nearest to it. One more drone is asked in turn.
    """


RELAY_REQUESTS = RelayRequests()


class RelayedStates:
    """Asks and answers for a Traffic.

    A relayed state counts as heard, except for the question whether this drone is cut off.

    If one link fails, other drones hear both its ends. Two drones that do not hear each other have
    such a third drone between them, unless one of the two hears less than half of the others. That
    drone lands (NEIGHBOUR_AGES.deaf). The reason: let F be the number of flying drones, as both know. Both hear at
    least (F - 1) / 2 of the F - 2 others. So a drone that gets no answer may assume that the other
    one comes down.

    It is unknown whether the drones that were last seen on the floor fly. A network that splits
    before the take-off is for the roster to notice.

    traffic: the table of the other drones
    """

    def __init__(self, traffic: NeighbourTable) -> None:
        self.traffic = traffic
        self.port = traffic.port
        self._sent = self._asks = 0
        self._turns = np.zeros(len(traffic.ids), dtype=int)
        self.port.handlers[MESSAGE_TOPICS.wanted_states.number] = self._asked
        self.port.handlers[MESSAGE_TOPICS.relayed_states.number] = self._told

    def seek(self, now: float) -> None:
        """Ask for the drones from which a newer state is needed soon.

        Ask less often for a drone if a second of asking has not helped.
        """
        rows = self.traffic.rows
        ids = self.traffic.ids
        age = now - rows[:, NEIGHBOUR_ROW.state_time]
        self._asks = self._asks + 1
        there = age < NEIGHBOUR_AGES.gone
        needed = np.maximum(
            RELAY_REQUESTS.least_age,
            rows[:, NEIGHBOUR_ROW.age_limit] - RELAY_REQUESTS.lead_time,
        )
        every = np.where(
            there,
            np.where(
                age < needed + RELAY_REQUESTS.lead_time,
                1,
                RELAY_REQUESTS.checks_if_unanswered,
            ),
            RELAY_REQUESTS.checks_if_gone,
        )
        sought = np.flatnonzero((~there | (age > needed)) & (self._asks % every == 0))
        heard = np.flatnonzero(
            now - rows[:, NEIGHBOUR_ROW.heard_time] < NEIGHBOUR_AGES.silent
        )
        asked: dict[int, list[int]] = {}
        for s in sought.tolist():
            others = heard[heard != s]
            if others.size:
                far = np.linalg.norm(rows[others, 0:3] - rows[s, 0:3], axis=1)
                self._turns[s] += 1
                chosen = {
                    *np.argsort(far, kind="stable")[
                        : RELAY_REQUESTS.nearest_asked
                    ].tolist(),
                    int(self._turns[s]) % others.size,
                }
                for k in sorted(chosen):
                    asked.setdefault(ids[int(others[k])], []).append(ids[s])
        for k, those in asked.items():
            self._send(MESSAGE_TOPICS.wanted_states, k, those)

    def _send(self, topic: Topic, to: int, value: list[Any]) -> None:
        """Send a list, unless it is empty."""
        if value:
            self._sent += 1
            self.port.send(topic, (to,), encode(value), self._sent)

    def _asked(
        self,
        source: int,
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        """Answer a question with the usable states of the drones it lists."""
        traffic = self.traffic
        those = self._opened(payload)
        now = traffic.now()
        told = []
        for j in those if all(type(j) is int for j in those) else self._none():
            row = traffic.row(j)
            if (
                row is not None
                and now - row[NEIGHBOUR_ROW.state_time] < NEIGHBOUR_AGES.usable
            ):
                told.append(
                    [
                        j,
                        State(row[0:13].copy(), 0.0, row[13:16].copy()),
                        now - float(row[NEIGHBOUR_ROW.state_time]),
                    ]
                )
        self._send(MESSAGE_TOPICS.relayed_states, source, told)

    def _told(
        self,
        source: int,
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        """Keep the states of an answer."""
        for item in self._opened(payload):
            match item:
                case [int(j), State() as state, float(old)] if (
                    0.0 <= old < NEIGHBOUR_AGES.gone
                ):
                    self.traffic.told((j, state), age + old)
                case _:
                    self._none()

    def _opened(self, payload: bytes) -> list[Any]:
        """Return the list in a message.

        Returns an empty list, and counts the message as malformed, if it is none or longer than the
        number of drones.
        """
        try:
            value = decode(payload)
        except CodecError:
            return self._none()
        return (
            value
            if isinstance(value, list) and len(value) <= len(self.traffic.ids)
            else self._none()
        )

    def _none(self) -> list[Any]:
        """Count a malformed message and return an empty list."""
        self.port.counters.malformed += 1
        return []
