"""Whose turn it is at a place that several drones want: the lowest id's. The others wait around it."""

import math

import numpy as np

from crazychoir.math3d import Vec
from crazychoir.safety.collision.filter import STANDING, USABLE
from crazychoir.safety.collision.traffic import BORN
from crazychoir.safety.pilot import Pilot

NEAR, AROUND = 0.5, 0.75
"""m from a place, in the plane: who flies within wants it too, it may be; who waits for it does so outside."""


def first_at(pilot: Pilot, p: Vec) -> int:
    """The lowest id of those that fly near a place p (3,) m, as far as this drone hears; its own if there is none."""
    if pilot.collision is None:
        return pilot.drone
    traffic, now = pilot.collision.traffic, pilot.clock.now()
    rows, floor = traffic.rows, pilot.limits.ground + STANDING
    near = np.hypot(rows[:, 0] - p[0], rows[:, 1] - p[1]) < NEAR
    fly = near & (rows[:, 2] > floor) & (now - rows[:, BORN] < USABLE)
    return min([traffic.ids[k] for k in np.flatnonzero(fly)], default=pilot.drone)


def aside(at: Vec, p: Vec) -> Vec:
    """Where a drone at `at` (3,) m waits for its turn at p (3,) m: on its own side, as high as p."""
    angle = math.atan2(at[1] - p[1], at[0] - p[0])
    return np.array([p[0] + AROUND * math.cos(angle), p[1] + AROUND * math.sin(angle), p[2]])
