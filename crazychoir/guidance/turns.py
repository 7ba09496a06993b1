"""The order of drones that want the same place: the lowest id first, the others wait around it."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.flight.pilot import Pilot
from crazychoir.safety.airspace.distances import COLLISION_DISTANCES
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.safety.rules.guard import EDGE_MARGIN, Fence
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class TurnDistances:
    """Distances by which drones that want the same place take turns."""

    near: float = 0.5
    """m, in the plane: a drone that flies nearer to a place probably wants it too."""
    waiting: float = 0.75
    """m, in the plane: distance from the place at which a drone waits for its turn."""
    arrived: float = 0.1
    """m: a blocked drone that is nearer to its goal has arrived."""


TURN_DISTANCES = TurnDistances()


@dataclass(frozen=True, slots=True)
class TurnTimes:
    """Times by which drones that want the same place take turns."""

    blocked: float = 0.5
    """s: a drone that gave way less than this ago is blocked by others."""
    turn: float = 10.0
    """s: how long a drone leaves a place to another drone that comes first."""
    patience: float = 3.0
    """s: how long a drone waits for others to clear its way before it moves aside.

    The others may not want the place.
    """
    aside: float = 5.0
    """s: how long a drone stays aside."""


TURN_TIMES = TurnTimes()


ASIDE_DIRECTIONS = (0.0, 0.5 * math.pi, -0.5 * math.pi, math.pi)
"""rad: directions to move aside, from the drone's own side of the place, in order of preference."""


def is_blocked(pilot: Pilot) -> bool:
    """Return whether other drones are in this drone's way, or it is in theirs."""
    return pilot.clock.now() < pilot.follower.clearance.gave_way + TURN_TIMES.blocked


def find_first_at(pilot: Pilot, p: Vec) -> int:
    """Return the lowest id of the drones that fly near a place p (3,) m.

    It is this drone's own id if it hears of no drone there.
    """
    return min(
        _find_flying_near(pilot, p, TURN_DISTANCES.near), default=pilot.port.address
    )


def choose_place_aside(at: Vec, p: Vec, fence: Fence) -> Vec:
    """Return the place where a drone waits for its turn at p, at the same height as p.

    It is on the drone's own side if the fence allows.

    at: (3,) m: where the drone is.
    p: (3,) m: the place that several drones want.
    fence: the fence of the drone.
    """
    angle = math.atan2(at[1] - p[1], at[0] - p[0])
    places = [
        p
        + TURN_DISTANCES.waiting
        * np.array([math.cos(angle + side), math.sin(angle + side), 0.0])
        for side in ASIDE_DIRECTIONS
    ]
    inside = [
        place
        for place in places
        if np.array_equal(fence.nearest(place, inset=EDGE_MARGIN)[0:2], place[0:2])
    ]
    return inside[0] if inside else places[0]


def _find_flying_near(pilot: Pilot, p: Vec, far: float) -> dict[int, Vec]:
    """Return {id: (3,) m} of the drones that fly near a place, as far as this drone hears them.

    p: (3,) m: the place.
    far: m, in the plane: largest distance.
    """
    traffic = pilot.follower.clearance.traffic
    if traffic is None:
        return {}
    now = pilot.clock.now()
    rows = traffic.rows
    floor = pilot.setup.limits.ground + COLLISION_DISTANCES.standing_height
    places = rows["state"][:, 0:3]
    near = np.hypot(places[:, 0] - p[0], places[:, 1] - p[1]) < far
    fly = (
        near
        & (places[:, 2] > floor)
        & (now - rows["state_time"] < NEIGHBOUR_AGES.usable)
    )
    return {int(rows["drone"][k]): places[k].copy() for k in np.flatnonzero(fly)}


class TurnTaking:
    """Where a drone flies that decides again and again: to its own place, or aside for others."""

    def __init__(self, pilot: Pilot) -> None:
        self.pilot = pilot
        self._aside = np.zeros(3)
        self._until = 0.0
        self._free = 0.0  # s: last time without another drone in the way

    def to(self, p: Vec) -> Vec:
        """Return where to fly now, for a drone that wants to be at p (3,) m.

        It is a place aside, for at most TURN_TIMES.aside s, while it is another drone's turn.
        """
        pilot = self.pilot
        now = self.pilot.clock.now()
        if not is_blocked(pilot):
            self._free = now
        if now < self._until and find_first_at(pilot, p) < pilot.port.address:
            return self._aside
        self._until = 0.0
        if (
            now - self._free > TURN_TIMES.patience
            and pilot.gap(p) < TURN_DISTANCES.near
            and find_first_at(pilot, p) < pilot.port.address
        ):
            return self._leave(p)
        return p

    def away(self) -> Vec | None:
        """Return where to fly for a drone that wants no place but is in another drone's way.

        None: stay.
        """
        pilot = self.pilot
        now = self.pilot.clock.now()
        assert pilot.state is not None  # noqa: S101 - a drone in flight has a state
        here = pilot.state.p
        if now < self._until and pilot.gap(self._aside) > TURN_DISTANCES.arrived:
            return self._aside
        self._until = 0.0
        self._free = now
        others = (
            _find_flying_near(pilot, here, TURN_DISTANCES.waiting)
            if is_blocked(pilot)
            else {}
        )
        if not others:
            return None
        nearest = min(others.values(), key=lambda p: math.dist(p, here))
        return self._leave(np.array([nearest[0], nearest[1], here[2]]))

    def _leave(self, p: Vec) -> Vec:
        assert self.pilot.state is not None  # noqa: S101 - a drone in flight has a state
        self._aside = choose_place_aside(self.pilot.state.p, p, self.pilot.setup.fence)
        self._until = self.pilot.clock.now() + TURN_TIMES.aside
        return self._aside
