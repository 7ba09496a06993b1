"""Obstacles: all other drones, on their announced paths, else as predicted from their states."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.safety.airspace.distances import COLLISION_DISTANCES
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.safety.collision.agreed.agreement import Agreement, OtherPlanner
from crazychoir.safety.collision.agreed.meeting import OtherPaths
from crazychoir.safety.collision.agreed.paths import compute_end_place
from crazychoir.safety.rules.guard import FENCE_INSET, Fence
from crazychoir.types import Mat, Records, Vec


@dataclass(frozen=True, slots=True)
class ObstacleLimits:
    """When another drone counts as standing or unreachable, and the clearance of a landing beside it."""

    standing_speed: float = 0.3
    """Speed in m/s below which a low drone stands."""
    landing_clearance: float = 0.25
    """Further distance in m that a drone keeps when it lands beside others."""
    answer_timeout: float = 5.0
    """Seconds for which a landing drone waits for agreement.

    After this it lands without, as long as the landing is clear of all obstacles that it knows.
    """


OBSTACLE_LIMITS = ObstacleLimits()
LANDING_SEARCH_RADII = 0.1 * np.arange(21)
"""m, distances from the present place that are tried."""
LANDING_SEARCH_ANGLES = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
"""rad, directions from the present place that are tried."""


class Obstacles:
    """All other drones, as obstacles for a drone with agreed paths.

    figures: (4,), as f of `find_first_meeting`
    agreement: paths and offers of the drones with agreed paths
    traffic: the states of all other drones; it keeps all of them
    a_max: m/s2, at which a drone without an announced path is assumed to brake
    ground: m, height of the ground
    """

    def __init__(
        self,
        figures: Vec,
        agreement: Agreement,
        traffic: Neighbours,
        a_max: float,
        ground: float,
    ) -> None:
        self.figures = figures
        self.agreement = agreement
        self.traffic = traffic
        self.a_max = a_max
        self._ground = ground
        self._guessed = [j for j in traffic.ids if j not in agreement.others]

    def look(self, now: float) -> None:
        """Mark drones that have landed since their last message.

        Such a drone has stood on the floor since it announced its path.
        """
        for j, other in self.agreement.others.items():
            other.stands = self.stands(j) and bool(
                self._row(j)["state_time"] > other.heard + NEIGHBOUR_AGES.usable
            )

    def find_drone_at(self, p: Vec) -> int | None:
        """Return the id of a drone that stands on the floor below p, (3,) m, or None.

        This drone must not land there: it may sink below p, on to the other one.
        """
        for j in self.traffic.ids:
            x = self._row(j)["state"]
            if math.hypot(
                x[0] - p[0], x[1] - p[1]
            ) < COLLISION_DISTANCES.standing_drone and self.stands(j):
                return j
        return None

    def stands(self, j: int) -> bool:
        """Return whether drone j stood on the floor in its newest state."""
        row = self._row(j)
        x = row["state"]
        return bool(
            row["state_time"] > -math.inf
            and x[2] < self._ground + COLLISION_DISTANCES.standing_height
            and np.linalg.norm(x[3:6]) < OBSTACLE_LIMITS.standing_speed
        )

    def beside(self, p: Vec, fence: Fence) -> Vec | None:
        """Return the place nearest to p, at the same height, where a landing is clear of all others.

        p: (3,) m, world
        fence: where the drone may fly
        Returns None if there is none near p.
        """
        spots = []
        for j in self.traffic.ids:
            row = self._row(j)
            x = row["state"]
            if row["state_time"] > -math.inf:
                other = self.agreement.others.get(j)
                at = (
                    compute_end_place(other.way)
                    if other is not None and other.flies
                    else x[0:3]
                )
                spots.append(
                    (
                        at[0],
                        at[1],
                        self.figures[3 if self.stands(j) else 2]
                        + OBSTACLE_LIMITS.landing_clearance,
                    )
                )
        return find_free_place(p, np.array(spots), fence)

    def all(self, now: float) -> OtherPaths:
        """Return all obstacles that the path of this drone must keep clear of."""
        meeting = self.strangers()
        for other in self.agreement.others.values():
            self._add(meeting, other, now)
        return meeting

    def strangers(self) -> OtherPaths:
        """Return the drones without agreed paths, which avoid collisions in another way."""
        meeting = OtherPaths(self.figures, self.a_max)
        for j in self._guessed:
            self._guess(meeting, j)
        return meeting

    def _add(self, meeting: OtherPaths, other: OtherPlanner, now: float) -> None:
        """Add the path of a drone, and its offer if it may fly that."""
        if not other.flies:
            self._guess(meeting, other.id)
            return
        ways = [(other.way, other.began)]
        if self.agreement.may_be_flown(other):
            ways.append((other.offer, other.begins))
        for way, began in ways:
            if other.silent(now):
                meeting.somewhere(other.id, way, began, other.heard)
            else:
                meeting.way(other.id, way, began)
        if now - other.heard > OBSTACLE_LIMITS.answer_timeout:
            meeting.below(other.id, compute_end_place(other.way))
        # It may follow its announced path, or not: both count.
        if self.traffic.deaf(other.id):
            self._guess(meeting, other.id)

    def _guess(self, meeting: OtherPaths, j: int) -> None:
        """Add a drone by its newest state."""
        row = self._row(j)
        x = row["state"]
        if self.stands(j):
            meeting.stands(j, x[0:3])
        elif row["state_time"] > -math.inf:
            meeting.guessed(j, x[0:3], x[3:6], float(row["state_time"]))

    def _row(self, j: int) -> Records:
        """Return the row of drone j."""
        row = self.traffic.row(j)
        assert row is not None  # noqa: S101 - all others are kept
        return row


def find_free_place(p: Vec, others: Mat, fence: Fence) -> Vec | None:
    """Return the nearest place to p, at the same height, inside the fence and away from all others.

    p: (3,) m, world
    others: (n, 3): x m, y m, and the horizontal distance in m to keep from there
    fence: where the drone flies
    Returns None if there is no such place.
    """
    for radius in LANDING_SEARCH_RADII.tolist():
        for angle in LANDING_SEARCH_ANGLES.tolist():
            place: Vec = p + radius * np.array([np.cos(angle), np.sin(angle), 0.0])
            inside = (
                np.array_equal(fence.nearest(place, FENCE_INSET)[0:2], place[0:2])
                or radius == 0.0
            )
            if inside and np.all(
                np.hypot(*(others[:, 0:2] - place[0:2]).T) >= others[:, 2]
            ):
                return place
    return None
