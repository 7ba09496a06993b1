"""Between the motor-level world and MuJoCo: what the drones' rotors and the air do goes there, what came of it back.

MuJoCo has [w, x, y, z] in the places of joints, and counts heights of centres of mass from the floor; a world's states
count heights from where a drone stands.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel, matrix, memory, table, vector
from crazychoir.numerics.math3d import (
    GRAVITY,
    Triple,
    columns,
    dot,
    exponential,
    product,
    unit,
)
from crazychoir.simulation.motor_level.lanes import LANES, SX, Blocks, blocks
from crazychoir.types import Mat, Vec

Rows = npt.NDArray[np.int64]
numbers = numba.types.Array(numba.int64, 1, "C", readonly=True)
seen = numba.types.Array(numba.float64, 2, "A", readonly=True)
pairs = numba.types.Array(numba.int32, 2, "A", readonly=True)
body_numbers = numba.types.Array(numba.int32, 1, "C", readonly=True)


@kernel(matrix, vector, numbers, numbers, memory, memory)
def place(
    x: Mat, stands: Vec, places: Rows, speeds: Rows, qpos: Vec, qvel: Vec
) -> None:
    """The states x (N, 13) as places and speeds of MuJoCo's free joints, which begin at these rows of qpos and qvel.

    stands: (N,) m, of the centre of mass above the floor of a drone that stands.
    """
    for n in range(x.shape[0]):
        a = places[n]
        b = speeds[n]
        for c in range(3):
            qpos[a + c] = x[n, c]
            qpos[a + 4 + c] = x[n, 6 + c]
            qvel[b + c] = x[n, 3 + c]
            qvel[b + 3 + c] = x[n, 10 + c]
        qpos[a + 2] += stands[n]
        qpos[a + 3] = x[n, 9]


@kernel(matrix, matrix, matrix, numbers, numba.float64, table)
def impel(x0: Mat, x1: Mat, inertia: Mat, bodies: Rows, h: float, applied: Mat) -> None:
    """The wrenches by which bodies that touch nothing come from the velocities of x0 to those of x1 in h s.

        F = m (v1 - v0) / h + m g e3,   tau = R0 (J (w1 - w0) / h + w0 x J w0)

    They are the means of what rotors and air do in that time. x0, x1: (N, 13);  inertia: (N, 4) m kg, diagonal of J
    kg m2;  bodies: rows of applied (n, 6), N and N m in the world, at the centre of mass.
    """
    for n in range(x0.shape[0]):
        b = bodies[n]
        m = inertia[n, 0]
        for c in range(3):
            applied[b, c] = m * (x1[n, 3 + c] - x0[n, 3 + c]) / h
        applied[b, 2] += m * GRAVITY
        j = (inertia[n, 1], inertia[n, 2], inertia[n, 3])
        w = (x0[n, 10], x0[n, 11], x0[n, 12])
        tx = j[0] * (x1[n, 10] - w[0]) / h + (j[2] - j[1]) * w[1] * w[2]
        ty = j[1] * (x1[n, 11] - w[1]) / h + (j[0] - j[2]) * w[2] * w[0]
        tz = j[2] * (x1[n, 12] - w[2]) / h + (j[1] - j[0]) * w[0] * w[1]
        bx, by, bz = columns((x0[n, 6], x0[n, 7], x0[n, 8], x0[n, 9]))
        for c in range(3):
            applied[b, 3 + c] = tx * bx[c] + ty * by[c] + tz * bz[c]


@kernel(matrix, vector, numbers, numba.float64, vector, table, blocks)
def settle(
    x0: Mat, qvel: Vec, speeds: Rows, h: float, forces: Vec, x: Mat, lanes: Blocks
) -> None:
    """The states x (N, 13) after a step of h s, by the velocities that MuJoCo has found for its end.

        p = p0 + h (v0 + v) / 2,   q = q0 exp(h (w0 + w) / 2)

    MuJoCo's own step goes on with v alone, which leads by half a step. forces: (3 N,) m/s2 body, what the
    accelerometers say, for the inertial sensors on board.
    """
    for n in range(x.shape[0]):
        b = speeds[n]
        for c in range(3):
            x[n, 3 + c] = qvel[b + c]
            x[n, 10 + c] = qvel[b + 3 + c]
            x[n, c] = x0[n, c] + 0.5 * h * (x0[n, 3 + c] + x[n, 3 + c])
            lanes[n // LANES].m[SX + c * LANES + n % LANES] = forces[3 * n + c]
        turn = exponential(
            0.5 * h * (x0[n, 10] + x[n, 10]),
            0.5 * h * (x0[n, 11] + x[n, 11]),
            0.5 * h * (x0[n, 12] + x[n, 12]),
        )
        x[n, 6], x[n, 7], x[n, 8], x[n, 9] = unit(
            product((x0[n, 6], x0[n, 7], x0[n, 8], x0[n, 9]), turn)
        )


@kernel()
def _velocity(body: int, p: Triple, twists: Mat, centres: Mat, roots: Rows) -> Triple:
    """m/s, world, of the point p of a body; twists: (n, 6) as MuJoCo's cvel, about the centres of the bodies' trees."""
    o = roots[body]
    r = (p[0] - centres[o, 0], p[1] - centres[o, 1], p[2] - centres[o, 2])
    w = (twists[body, 0], twists[body, 1], twists[body, 2])
    return (
        twists[body, 3] + w[1] * r[2] - w[2] * r[1],
        twists[body, 4] + w[2] * r[0] - w[0] * r[2],
        twists[body, 5] + w[0] * r[1] - w[1] * r[0],
    )


@kernel(
    pairs,
    seen,
    seen,
    body_numbers,
    body_numbers,
    matrix,
    matrix,
    numbers,
    memory,
    memory,
    numba.int64[::1],
)
def touch(
    geoms: Rows,
    points: Mat,
    frames: Mat,
    body_of: Rows,
    roots: Rows,
    twists: Mat,
    centres: Mat,
    drone_of: Rows,
    touching: Vec,
    impact: Vec,
    against: Rows,
) -> None:
    """Which drones touch something, and how fast the fastest has hit what.

        speed = n . (v_1 - v_2),  n from geom 1 to geom 2

    geoms: (k, 2), points: (k, 3), frames: (k, 9), whose first row is n: the contacts;  body_of: of a geom;  drone_of:
    row of a body, -1 for none;  touching: (N,) 0 or 1;  impact: (N,) m/s, against: (N,) the geom: replaced by worse.
    """
    for c in range(geoms.shape[0]):
        one = body_of[geoms[c, 0]]
        two = body_of[geoms[c, 1]]
        p = (points[c, 0], points[c, 1], points[c, 2])
        u = _velocity(one, p, twists, centres, roots)
        v = _velocity(two, p, twists, centres, roots)
        n = (frames[c, 0], frames[c, 1], frames[c, 2])
        speed = dot(n, (u[0] - v[0], u[1] - v[1], u[2] - v[2]))
        for k in range(2):
            row = drone_of[one if k == 0 else two]
            if row >= 0:
                touching[row] = 1.0
                if speed > impact[row] and math.isfinite(speed):
                    impact[row] = speed
                    against[row] = geoms[c, 1 - k]
