"""The newest state that a drone has of each other drone, and the rate at which it sends its own."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crazychoir.bus.port import PORT_ADDRESSES, Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.runtime.mailbox import Call
from crazychoir.types import LinkStatus, State, Vec


class NeighbourRow(NamedTuple):
    """Columns of the table of the other drones, after the state (13,) and the acceleration (3,)."""

    state_time: int = 16
    """column: time in s of the state and the acceleration."""
    share: int = 17
    """Column: 1 if the drone gives way to no other, else 0.5."""
    meeting_time: int = 18
    """Column: s until both drones could be near each other."""
    age_limit: int = 19
    """Column: age in s of the state beyond which this drone brakes for want of a newer one."""
    heard_time: int = 20
    """Column: time in s of the last state that the drone sent itself.

    States that others relay may be newer.
    """
    size: int = 21
    """Number of columns."""


NEIGHBOUR_ROW = NeighbourRow()


class NeighbourAges(NamedTuple):
    """Ages, s, of the news of another drone from which on it is treated differently."""

    usable: float = 0.6
    """Age in s beyond which a state is of no use."""
    unheard: float = 0.2
    """Seconds without a state after which a place from the cameras counts."""
    silent: float = 1.5
    """Seconds of silence after which a drone that flew counts as not heard.

    If this holds for more than half of the other flying drones, this drone is cut off, see
    CollisionFilter.cut_off.
    """
    gone: float = 10.0
    """Seconds after which a drone that no other drone hears has come down, see Hearsay.

    It is cut off itself, or has failed.
    """
    deaf: float = 0.3
    """Seconds of silence of its radio after which a drone does not do what its agent says."""


NEIGHBOUR_AGES = NeighbourAges()


LARGEST_STATE_NORM = 1e6
"""Largest norm of a valid state (13,), in the units of its entries."""
LARGEST_ACCELERATION_NORM = 100.0
"""Largest norm of a valid acceleration, m/s2."""
SPEED_ALLOWANCE = 0.3
"""Speed in m/s that two drones may gain at once."""


@dataclass(frozen=True, slots=True)
class StateRates:
    """How often drones hear each other's states."""

    lowest: float = 2.0
    """Least rate in Hz at which a far drone is heard."""
    highest: float = 20.0
    """Largest rate in Hz at which a far drone is heard."""
    total: float = 100.0
    """Rate in Hz at which all far drones together are heard, within the two limits above."""
    by_meeting_time: tuple[tuple[float, ...], ...] = ((0.7, 50.0), (3.0, 20.0))
    """Pairs of a time and a rate for drones that may soon be near each other.

    s: within which both drones could be near each other
    Hz: at which they then hear each other.
    """
    by_age_limit: tuple[tuple[float, ...], ...] = ((1.0, 10.0), (2.0, 5.0))
    """Pairs of an age and a rate for drones that would brake without a new state.

    s: age of a state beyond which the drone brakes
    Hz: at which both then hear each other

    Several states in a row may be lost before a drone brakes.
    """
    check_interval: float = 0.1
    """Seconds between two checks of the distances."""


STATE_RATES = StateRates()


class NeighbourTable:
    """Table of the other drones, in the order of `ids`: see the columns above.

    Each drone hears all others at a low rate. It sends its own state more often to drones that
    could be near soon, and to drones that would soon brake without it. Both sides know when that
    is.

    port: the port of this drone
    ids: of the other drones; the own id is left out
    alone: ids of the drones that do not give way, because a planner on board flies them
    """

    def __init__(
        self, port: Port, ids: Iterable[int], alone: Sequence[int] = ()
    ) -> None:
        self.port = port
        self.clock = port.bus.clock
        self.ids = [j for j in ids if j != port.address]
        self.rows = np.zeros((len(self.ids), NEIGHBOUR_ROW.size))
        self._parts = {
            j: (row, row[0:13], row[13:16])
            for j, row in zip(self.ids, self.rows, strict=True)
        }
        self.rows[:, 9] = 1.0
        self.rows[:, NEIGHBOUR_ROW.state_time] = -np.inf
        self.rows[:, NEIGHBOUR_ROW.meeting_time] = np.inf
        self.rows[:, NEIGHBOUR_ROW.heard_time] = -np.inf
        self.rows[:, NEIGHBOUR_ROW.age_limit] = np.inf
        self._shares = {j: 1.0 if j in alone else 0.5 for j in self.ids}
        self._deaf = dict.fromkeys(self.ids, False)
        self.rows[:, NEIGHBOUR_ROW.share] = list(self._shares.values())
        self._pace = np.zeros(len(self.ids))
        self._looks = 0.0
        if self.ids:
            rate = min(
                max(STATE_RATES.total / len(self.ids), STATE_RATES.lowest),
                STATE_RATES.highest,
            )
            port.bus.subscribe(
                DRONE_TOPICS.state,
                PORT_ADDRESSES.any_drone,
                port.address,
                Call(self.clock, self.hear, "traffic"),
                rate,
            )

    def now(self) -> float:
        """Return the time in s on the clock of the ages."""
        return self.clock.now_ns() / NS_PER_SECOND

    def row(self, j: int) -> Vec | None:
        """Return the row of drone j, all columns; None if j is not among the others."""
        found = self._parts.get(j)
        return None if found is None else found[0]

    def hear(self, message: tuple[int, State], age: float) -> None:
        """Keep a state that a drone sent `age` s ago, unless it is invalid or outdated."""
        row = self._keep(message, age)
        if row is not None:
            j = message[0]
            row[NEIGHBOUR_ROW.heard_time] = max(
                row[NEIGHBOUR_ROW.heard_time], self.now() - age
            )
            row[NEIGHBOUR_ROW.share] = 1.0 if self._deaf[j] else self._shares[j]

    def told(self, message: tuple[int, State], age: float) -> None:
        """Keep the state of a drone that another drone has relayed."""
        self._keep(message, age)

    def seen(self, j: int, state: State, age: float) -> None:
        """Keep the place of drone j that the cameras see, while no state is heard of it.

        The drone then counts as giving way to no other.
        """
        row = self.row(j)
        if (
            row is not None
            and self.now() - row[NEIGHBOUR_ROW.state_time] > NEIGHBOUR_AGES.unheard
        ):
            self._keep((j, state), age)
            row[NEIGHBOUR_ROW.share] = 1.0

    def linked(self, j: int, link: LinkStatus | None, age: float) -> None:
        """Note the state of the radio of drone j.

        A drone that does not hear its agent gives way to no other, whatever the agent says.
        """
        if j in self._deaf and link is not None:
            self._deaf[j] = link.silence + age > NEIGHBOUR_AGES.deaf

    def deaf(self, j: int) -> bool:
        """Return whether the radio of drone j is silent: it goes on with its last command."""
        return self._deaf[j]

    def _keep(self, message: tuple[int, State], age: float) -> Vec | None:
        """Store a state and return the row of its drone.

        Returns None if the state is invalid or the drone unknown.
        """
        j, state = message
        found = self._parts.get(j)
        if found is None or not (
            math.hypot(*state.flat.tolist()) < LARGEST_STATE_NORM
            and math.hypot(*state.a.tolist()) < LARGEST_ACCELERATION_NORM
        ):
            return None
        row, flat, a = found
        born = self.now() - age
        if born >= row[NEIGHBOUR_ROW.state_time]:
            flat[:] = state.flat
            a[:] = state.a
            row[NEIGHBOUR_ROW.state_time] = born
        return row

    def look(self, now: float) -> bool:
        """Send the own state more often to near drones; return whether it was time to check."""
        if now < self._looks:
            return False
        self._looks = now + STATE_RATES.check_interval
        soon = self.rows[:, NEIGHBOUR_ROW.meeting_time]
        borne = self.rows[:, NEIGHBOUR_ROW.age_limit]
        pace = np.zeros(len(self.ids))
        for reached, tiers in (
            (soon, STATE_RATES.by_meeting_time),
            (borne, STATE_RATES.by_age_limit),
        ):
            for within, rate in tiers:
                pace[reached < within] = np.maximum(pace[reached < within], rate)
        for k in np.flatnonzero(pace != self._pace).tolist():
            self.port.pace(DRONE_TOPICS.state, self.ids[k], float(pace[k]))
        self._pace = pace
        return True
