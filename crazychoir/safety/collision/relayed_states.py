"""What the others hear of a drone that this one does not hear: it asks them, and tells what it hears itself."""

from typing import Any

import numpy as np

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.topics import HEARSAY, SOUGHT, Topic
from crazychoir.errors import CodecError
from crazychoir.safety.collision.neighbour_table import (
    BORN,
    BORNE,
    GONE,
    HEARD,
    SILENT,
    USABLE,
    Traffic,
)
from crazychoir.types import State

ASKS = 0.25
"""s, of the age of a state, before which nobody is asked for a newer one."""
AHEAD = 1.0
"""s before it would brake for want of a state, from when on it asks."""
RARELY, SELDOM = 5, 10
"""Times that it looks, once for those of whom nobody has told for AHEAD s, and for those never heard, or gone."""
NEAREST = 2
"""Of those that it hears, so many that are nearest to whom it seeks are asked each time, and one more in turn."""


class Hearsay:
    """Asks and answers for a Traffic; what is told counts as heard, but for who asks whether it is cut off.

    Where one link fails, others hear both its ends. Two that do not hear each other have such a third one, unless
    one of them hears less than half of the others, which lands (DEAF): of F that fly, as both know, both hear at least
    (F - 1) / 2 among F - 2. So who is told nothing may count on it that the other comes down. Of those that were last
    seen on the floor nobody knows whether they fly: a network that splits before the take-off is for
    the roster to notice.
    """

    def __init__(self, traffic: Traffic) -> None:
        self.traffic = traffic
        self.port = traffic.port
        self._sent = self._asks = 0
        self._turns = np.zeros(len(traffic.ids), dtype=int)
        self.port.handlers[SOUGHT.number] = self._asked
        self.port.handlers[HEARSAY.number] = self._told

    def seek(self, now: float) -> None:
        """Ask for those whose newer state is needed soon; less often for whom a second of asking has not helped."""
        rows = self.traffic.rows
        ids = self.traffic.ids
        age = now - rows[:, BORN]
        self._asks = self._asks + 1
        there = age < GONE
        needed = np.maximum(ASKS, rows[:, BORNE] - AHEAD)
        every = np.where(there, np.where(age < needed + AHEAD, 1, RARELY), SELDOM)
        sought = np.flatnonzero((~there | (age > needed)) & (self._asks % every == 0))
        heard = np.flatnonzero(now - rows[:, HEARD] < SILENT)
        asked: dict[int, list[int]] = {}
        for s in sought.tolist():
            others = heard[heard != s]
            if others.size:
                far = np.linalg.norm(rows[others, 0:3] - rows[s, 0:3], axis=1)
                self._turns[s] += 1
                chosen = {
                    *np.argsort(far, kind="stable")[:NEAREST].tolist(),
                    int(self._turns[s]) % others.size,
                }
                for k in sorted(chosen):
                    asked.setdefault(ids[int(others[k])], []).append(ids[s])
        for k, those in asked.items():
            self._send(SOUGHT, k, those)

    def _send(self, topic: Topic, to: int, value: list[Any]) -> None:
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
        traffic = self.traffic
        those = self._opened(payload)
        now = traffic.now()
        told = []
        for j in those if all(type(j) is int for j in those) else self._none():
            row = traffic.row(j)
            if row is not None and now - row[BORN] < USABLE:
                told.append(
                    [
                        j,
                        State(row[0:13].copy(), 0.0, row[13:16].copy()),
                        now - float(row[BORN]),
                    ]
                )
        self._send(HEARSAY, source, told)

    def _told(
        self,
        source: int,
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        for item in self._opened(payload):
            match item:
                case [int(j), State() as state, float(old)] if 0.0 <= old < GONE:
                    self.traffic.told((j, state), age + old)
                case _:
                    self._none()

    def _opened(self, payload: bytes) -> list[Any]:
        """What a message lists; nothing, and it is counted, if it is none, or longer than there are drones."""
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
        self.port.counters.malformed += 1
        return []
