"""Separation in time: who waits how long at home, so that the flights of a team keep their distance.

Every robot computes the same answer from the same timed paths: the lower id goes first, each next one waits for the
shortest time after which it keeps clear of all before it, of those that wait and of those that have landed.
"""

import math
from collections.abc import Mapping

import numpy as np

from crazychoir.errors import Refused
from crazychoir.math3d import Mat

STEP = 0.1
"""s between the samples of a path."""
DOWNWASH = 0.5
"""Vertical distance counts for half: the air below a drone is rough."""


def start_delays(paths: Mapping[int, Mat], clearance: float, slack: float = 0.3, wait: float = 0.5) -> dict[int, float]:
    """Delay in s of each path.

    paths: {id: (T_i, 3) m, sampled every STEP s, from the floor to the floor};  clearance: m to keep, vertical
    distances halved;  slack: s that any two drones may be out of step;  wait: s, granularity of the delays.
    A drone at its home or back there counts as an obstacle too, by its true distance.
    Raises Refused if a flight comes too near to the home of another drone, however long it waits.
    """
    delays: dict[int, float] = {}
    for i in sorted(paths):
        before = list(delays)
        all_down = max((delays[j] + len(paths[j]) * STEP for j in before), default=0.0) + slack
        for n in range(math.ceil(all_down / wait) + 1):
            delays[i] = n * wait
            near = [j for j in before if not _clear(paths, delays, i, j, clearance, slack)]
            if not near:
                break
        else:
            others = ", ".join(map(str, near))
            reason = f"within {clearance:g} m of drone(s) {others} however long it waits: move their homes apart"
            raise Refused(f"the flight of drone {i}", reason)
    return delays


def _clear(
    paths: Mapping[int, Mat], delays: Mapping[int, float], i: int, j: int, clearance: float, slack: float
) -> bool:
    end = max(delays[k] + len(paths[k]) * STEP for k in (i, j)) + slack
    times = np.arange(0.0, end, STEP)
    a = _at(paths[i], times - delays[i])
    return all(_distance(a, _at(paths[j], times - delays[j] + shift)) >= clearance for shift in (-slack, 0.0, slack))


def _at(path: Mat, times: Mat) -> Mat:
    index = np.clip(np.round(times / STEP).astype(int), 0, len(path) - 1)
    at: Mat = path[index]
    return at


def _distance(a: Mat, b: Mat) -> float:
    """Smallest distance of two sampled paths; where one of them is on the floor, the plain one."""
    d = a - b
    flying = np.minimum(a[:, 2], b[:, 2]) > 0.1
    d[flying, 2] *= DOWNWASH
    return float(np.sqrt((d**2).sum(axis=1).min()))
