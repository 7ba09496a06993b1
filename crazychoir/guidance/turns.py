"""Whose turn it is at a place that several drones want: the lowest id's. The others wait around it."""

import math

import numpy as np

from crazychoir.flight.pilot import Pilot
from crazychoir.safety.collision.filter import STANDING
from crazychoir.safety.collision.neighbour_table import BORN, USABLE
from crazychoir.safety.rules.guard import EDGE, Fence
from crazychoir.types import Vec

NEAR, AROUND = 0.5, 0.75
"""m from a place, in the plane: who flies within wants it too, it may be; who waits for it does so outside."""
BLOCKED, CLOSE, TURN = 0.5, 0.1, 10.0
"""s since it gave way in which others are in its way; m from a goal that then counts as there; s that it leaves it to
one whose turn it is."""
PATIENT, LEAVES = 3.0, 5.0
"""s that others, who may want nothing, are given to get out of its way before it goes aside; s that it does so."""
SIDES = (0.0, 0.5 * math.pi, -0.5 * math.pi, math.pi)


def blocked(pilot: Pilot) -> bool:
    """Whether others are in its way, or it is in theirs."""
    return pilot.clock.now() < pilot.clearance.gave_way + BLOCKED


def first_at(pilot: Pilot, p: Vec) -> int:
    """The lowest id of those that fly near a place p (3,) m, as far as this drone hears; its own if there is none."""
    return min(_flying_near(pilot, p, NEAR), default=pilot.drone)


def aside(at: Vec, p: Vec, fence: Fence) -> Vec:
    """Where a drone at `at` (3,) m waits for its turn at p (3,) m, as high: on its own side, if the fence allows."""
    angle = math.atan2(at[1] - p[1], at[0] - p[0])
    places = [
        p + AROUND * np.array([math.cos(angle + side), math.sin(angle + side), 0.0])
        for side in SIDES
    ]
    inside = [
        place
        for place in places
        if np.array_equal(fence.nearest(place, inset=EDGE)[0:2], place[0:2])
    ]
    return inside[0] if inside else places[0]


def _flying_near(pilot: Pilot, p: Vec, far: float) -> dict[int, Vec]:
    """Where those are that fly less than `far` m from p (3,), in the plane, as far as this drone hears."""
    traffic = pilot.clearance.traffic
    if traffic is None:
        return {}
    now = pilot.clock.now()
    rows = traffic.rows
    floor = pilot.limits.ground + STANDING
    near = np.hypot(rows[:, 0] - p[0], rows[:, 1] - p[1]) < far
    fly = near & (rows[:, 2] > floor) & (now - rows[:, BORN] < USABLE)
    return {traffic.ids[k]: rows[k, 0:3].copy() for k in np.flatnonzero(fly)}


class Turns:
    """Where a drone flies whose guidance decides again and again: to its place, or aside for others."""

    def __init__(self, pilot: Pilot) -> None:
        self.pilot = pilot
        self._aside = np.zeros(3)
        self._until = 0.0
        self._free = 0.0  # s, when nobody was in its way for the last time

    def to(self, p: Vec) -> Vec:
        """Where to fly now for who wants to be at p (3,) m: aside, while it is another one's turn, at most LEAVES s."""
        pilot = self.pilot
        now = self.pilot.clock.now()
        if not blocked(pilot):
            self._free = now
        if now < self._until and first_at(pilot, p) < pilot.drone:
            return self._aside
        self._until = 0.0
        if (
            now - self._free > PATIENT
            and pilot.gap(p) < NEAR
            and first_at(pilot, p) < pilot.drone
        ):
            return self._leave(p)
        return p

    def away(self) -> Vec | None:
        """Where to fly for who wants nothing, but is in another's way; None: nowhere."""
        pilot = self.pilot
        now = self.pilot.clock.now()
        assert pilot.state is not None  # noqa: S101 - who flies has a state
        here = pilot.state.p
        if now < self._until and pilot.gap(self._aside) > CLOSE:
            return self._aside
        self._until = 0.0
        self._free = now
        others = _flying_near(pilot, here, AROUND) if blocked(pilot) else {}
        if not others:
            return None
        nearest = min(others.values(), key=lambda p: math.dist(p, here))
        return self._leave(np.array([nearest[0], nearest[1], here[2]]))

    def _leave(self, p: Vec) -> Vec:
        assert self.pilot.state is not None  # noqa: S101 - who flies has a state
        self._aside = aside(self.pilot.state.p, p, self.pilot.fence)
        self._until = self.pilot.clock.now() + LEAVES
        return self._aside
