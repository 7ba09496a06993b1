"""Conversion of a State to nav_msgs/Odometry, with velocities in the frame of the body, and back."""

from collections.abc import Sequence

import numpy as np

from crazychoir.types import Mat, State


def odometry_numbers(state: State) -> list[float]:
    """Return p, q, v_b, w: nav_msgs/Odometry has velocities in the frame of the body.

        v_b = R(q)^T v = v - q_w t + u x t,  t = 2 u x v,  u = (q_x, q_y, q_z)

    v_b: (3,) m/s, body
    v: (3,) m/s, world
    The formula is computed with plain numbers, because the call of a compiled function takes
    longer.
    """
    x, y, z, vx, vy, vz, a, b, c, d, p, q, r = state.flat.tolist()
    tx = 2.0 * (b * vz - c * vy)
    ty = 2.0 * (c * vx - a * vz)
    tz = 2.0 * (a * vy - b * vx)
    forward = vx - d * tx + b * tz - c * ty
    left = vy - d * ty + c * tx - a * tz
    up = vz - d * tz + a * ty - b * tx
    return [x, y, z, a, b, c, d, forward, left, up, p, q, r]


def state_of(x: Sequence[float]) -> State:
    """Return the State of the numbers of `odometry_numbers`; the drone's command is not recorded."""
    flat = np.array(x, dtype=float)
    v = rotate_to_world(flat[None, 3:7], flat[None, 7:10])[0]
    return State(np.concatenate([flat[0:3], v, flat[3:7], flat[10:13]]))


def rotate_to_world(q: Mat, v_b: Mat) -> Mat:
    """Return v = R(q) v_b, row by row.

        v = v_b + 2 q_w (u x v_b) + 2 u x (u x v_b),  u = (q_x, q_y, q_z)

    q: (n, 4): unit quaternions
    v_b: (n, 3), body
    Returns (n, 3), world.
    """
    u = q[:, :3]
    twice = 2.0 * np.cross(q[:, :3], v_b)
    v: Mat = v_b + q[:, 3:] * twice + np.cross(u, twice)
    return v
