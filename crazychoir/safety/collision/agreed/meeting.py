"""Meeting of two paths: the first time at which two drones on them come too near to each other."""

import math
from typing import NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel, matrix, real, vector
from crazychoir.safety.collision.agreed.paths import (
    compute_motion,
    compute_path_duration,
    compute_place,
    plan_braking,
    plan_hold,
)
from crazychoir.types import Mat, Vec


class MeetingCheck(NamedTuple):
    """How a path is checked against the paths of other drones, and where drones with unknown paths
    are assumed to be.
    """

    step: float = 0.05
    """Seconds between two checks.

    At 2 m/s of relative speed a distance of 0.3 m is seen at most 4 mm too large.
    """
    approach_tolerance: float = 1e-3
    """Distance in m by which two drones that are too near may still approach, for rounding."""
    largest_guess_margin: float = 0.15
    """Largest extra distance in m from a path that is only guessed."""
    guess_growth: float = 0.15
    """Growth in m/s of the uncertainty of such a guess."""
    silent_spacing: float = 0.1
    """Seconds between the places on its path at which a silent drone may be."""
    descent_spacing: float = 0.3
    """Height in m between the places where a drone that may have come down may be."""
    coasting_time: float = 0.3
    """Seconds that a drone without an announced path is assumed to go on before it brakes."""


MEETING_CHECK = MeetingCheck()


# Columns of what is known of another drone's path.
PATH_FIRST_PIECE = 0  # first row of its pieces
PATH_PIECE_COUNT = 1  # number of its pieces
PATH_BEGIN_TIME = 2  # s, when it began
PATH_ON_FLOOR = 3  # 1 if the drone stands on the floor, else 0
PATH_GUESS_GROWTH = 4  # m/s, growth of the uncertainty
PATH_DRONE_ID = 5  # id of the drone


@kernel(matrix, real, matrix, matrix, real, vector)
def find_first_meeting(
    way: Mat, began: float, pieces: Mat, others: Mat, now: float, f: Vec
) -> tuple[float, float]:
    """Return the first time in s at which a path meets another, and the id of that drone.

        |S (p_i(t) - p_j(t))| < min(D, |S (p_i - p_j)| when both have begun),
        S = diag(1, s_x / s_y, s_x / s_z)

    By the minimum, two drones that are too near may part again.

    way: (k, 25): the path
    began: s, when it begins
    pieces: (., 25): pieces of the other paths
    others: (n, 6): PATH_FIRST_PIECE ... PATH_DRONE_ID of each other path
    now: s
    f: (4,): diagonal of S without its first element, D m, and the width m of a drone on the floor,
        for which S = 1
    Returns (inf, -1) if the path meets no other.
    """
    duration = 0.0
    for k in range(way.shape[0]):
        duration += way[k, 0]
    soonest = math.inf
    other_id = -1.0
    for row in range(others.shape[0]):
        other = others[row]
        first = int(other[PATH_FIRST_PIECE])
        theirs = pieces[first : first + int(other[PATH_PIECE_COUNT])]
        lasts = 0.0
        for k in range(theirs.shape[0]):
            lasts += theirs[k, 0]
        sy, sz, width = (
            (1.0, 1.0, f[3]) if other[PATH_ON_FLOOR] > 0.0 else (f[0], f[1], f[2])
        )
        t = max(now, began, other[PATH_BEGIN_TIME])
        ends = min(
            max(began + duration, other[PATH_BEGIN_TIME] + lasts) + MEETING_CHECK.step,
            soonest,
        )
        nearest = math.inf
        while t < ends:
            p = compute_place(way, t - began)
            q = compute_place(theirs, t - other[PATH_BEGIN_TIME])
            d = math.sqrt(
                (p[0] - q[0]) ** 2
                + (sy * (p[1] - q[1])) ** 2
                + (sz * (p[2] - q[2])) ** 2
            )
            nearest = (
                min(nearest, d - MEETING_CHECK.approach_tolerance)
                if nearest == math.inf
                else nearest
            )
            if d < min(
                width
                + min(
                    other[PATH_GUESS_GROWTH] * (t - now),
                    MEETING_CHECK.largest_guess_margin,
                ),
                nearest,
            ):
                soonest = t
                other_id = other[PATH_DRONE_ID]
                break
            t += MEETING_CHECK.step
    return soonest, other_id


class OtherPaths:
    """The paths of the others that a path must not meet.

    figures: (4,), as f of `find_first_meeting`
    a_max: m/s2, with which a drone without an announced path is assumed to brake
    """

    def __init__(self, figures: Vec, a_max: float) -> None:
        self.figures = figures
        self.a_max = a_max
        self._pieces: list[Mat] = []
        self._rows: list[tuple[float, ...]] = []
        self._count = 0
        self._packed: tuple[Mat, Mat] | None = None

    def way(
        self, j: int, way: Mat, began: float, guess: float = 0.0, floor: bool = False
    ) -> None:
        """Add the path of drone j.

        way: (k, 25)
        began: s
        guess: m/s, growth of the uncertainty
        floor: whether the drone stands on the floor
        """
        self._rows.append((self._count, len(way), began, float(floor), guess, j))
        self._pieces.append(way)
        self._count += len(way)

    def somewhere(self, j: int, way: Mat, began: float, heard: float) -> None:
        """Add drone j, silent since `heard` s.

        It may have stopped anywhere on the path that was left then.
        """
        lasts = compute_path_duration(way)
        for t in np.arange(
            min(max(0.0, heard - began), lasts),
            lasts + MEETING_CHECK.silent_spacing,
            MEETING_CHECK.silent_spacing,
        ).tolist():
            self.way(j, plan_hold(compute_motion(way, t)[0:3], 0.0), -math.inf)

    def below(self, j: int, p: Vec) -> None:
        """Add drone j, which may have come down from p, (3,) m, to the ground."""
        for z in np.arange(
            p[2], -MEETING_CHECK.silent_spacing, -MEETING_CHECK.descent_spacing
        ).tolist():
            self.way(j, plan_hold(np.array([p[0], p[1], z]), 0.0), -math.inf)

    def stands(self, j: int, p: Vec) -> None:
        """Add drone j, which stands on the floor at p, (3,) m."""
        self.way(j, plan_hold(p, 0.0), -math.inf, floor=True)

    def guessed(self, j: int, p: Vec, v: Vec, born: float) -> None:
        """Add drone j without an announced path: it goes on for a short time, then brakes.

        p: (3,) m
        v: (3,) m/s
        born: s, time of p and v
        """
        start = np.concatenate([p, v, np.zeros(6)])
        going = plan_hold(p, MEETING_CHECK.coasting_time)
        going[0, 2], going[0, 10], going[0, 18] = v
        start[0:3] += MEETING_CHECK.coasting_time * v
        self.way(
            j,
            np.concatenate([going, plan_braking(start, self.a_max)]),
            born,
            guess=MEETING_CHECK.guess_growth,
        )

    def first(
        self, way: Mat, began: float, now: float, room: float = 0.0
    ) -> tuple[float, int | None]:
        """Return the time in s at which a path first meets another, and the id of that drone.

        way: (k, 25)
        began: s
        now: s
        room: m, distance to keep beside D
        Returns infinity and None if the path is clear.
        """
        if not self._rows:
            return math.inf, None
        if self._packed is None:
            self._packed = np.concatenate(self._pieces), np.array(self._rows)
        figures = self.figures.copy()
        figures[2] += room
        time, other_id = find_first_meeting(way, began, *self._packed, now, figures)
        return time, None if other_id < 0.0 else int(other_id)

    def clear(self, way: Mat, began: float, now: float) -> bool:
        """Return whether the path meets no other."""
        return self.first(way, began, now)[1] is None
