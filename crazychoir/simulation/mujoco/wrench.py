"""Exchange between the motor-level world and MuJoCo: wrenches of rotors and air, resulting states.

MuJoCo has quaternions [w, x, y, z] in the places of joints, and measures the height of the centre
of mass from the floor. The states of a world measure the height from where a drone stands.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel, matrix, memory, table, vector
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    Triple,
    dot,
    normalize_quaternion,
    quaternion_product,
    rotation_columns,
    rotation_exponential,
)
from crazychoir.simulation.motor_level.lanes import (
    LANE_COUNT,
    SPECIFIC_FORCE_X,
    Blocks,
    blocks,
)
from crazychoir.types import Mat, Vec

Rows = npt.NDArray[np.int64]
numbers = numba.types.Array(numba.int64, 1, "C", readonly=True)
strided_matrix = numba.types.Array(numba.float64, 2, "A", readonly=True)
pairs = numba.types.Array(numba.int32, 2, "A", readonly=True)
body_numbers = numba.types.Array(numba.int32, 1, "C", readonly=True)


@kernel(matrix, vector, numbers, numbers, memory, memory)
def write_joint_states(
    x: Mat, stands: Vec, places: Rows, speeds: Rows, qpos: Vec, qvel: Vec
) -> None:
    """Write the states x (N, 13) as positions and velocities of MuJoCo's free joints.

    stands: (N,) m: height of the centre of mass above the floor when the drone stands
    places: (N,): rows of qpos where the joints begin
    speeds: (N,): rows of qvel where the joints begin
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
def write_mean_wrenches(
    x0: Mat, x1: Mat, inertia: Mat, bodies: Rows, h: float, applied: Mat
) -> None:
    """Write the wrenches that change the velocities of x0 into those of x1 in h s.

    The bodies touch nothing.

        F = m (v1 - v0) / h + m g e3,   tau = R0 (J (w1 - w0) / h + w0 x J w0)

    They are the means of the wrenches of rotors and air in that time.
    x0: (N, 13): states before
    x1: (N, 13): states after
    inertia: (N, 4): m in kg, diagonal of J in kg m2
    bodies: (N,): rows of the drones in applied
    h: s
    applied: (n, 6): N and N m, world, at the centre of mass; result
    """
    for n in range(x0.shape[0]):
        b = bodies[n]
        m = inertia[n, 0]
        for c in range(3):
            applied[b, c] = m * (x1[n, 3 + c] - x0[n, 3 + c]) / h
        applied[b, 2] += m * STANDARD_GRAVITY
        j = (inertia[n, 1], inertia[n, 2], inertia[n, 3])
        w = (x0[n, 10], x0[n, 11], x0[n, 12])
        tx = j[0] * (x1[n, 10] - w[0]) / h + (j[2] - j[1]) * w[1] * w[2]
        ty = j[1] * (x1[n, 11] - w[1]) / h + (j[0] - j[2]) * w[2] * w[0]
        tz = j[2] * (x1[n, 12] - w[2]) / h + (j[1] - j[0]) * w[0] * w[1]
        bx, by, bz = rotation_columns((x0[n, 6], x0[n, 7], x0[n, 8], x0[n, 9]))
        for c in range(3):
            applied[b, 3 + c] = tx * bx[c] + ty * by[c] + tz * bz[c]


@kernel(matrix, vector, numbers, numba.float64, vector, table, blocks)
def read_joint_states(
    x0: Mat, qvel: Vec, speeds: Rows, h: float, forces: Vec, x: Mat, lanes: Blocks
) -> None:
    """Write the states x (N, 13) after a step of h s, with the velocities that MuJoCo has found.

        p = p0 + h (v0 + v) / 2,   q = q0 exp(h (w0 + w) / 2)

    MuJoCo's own step uses v alone, which leads by half a step.
    x0: (N, 13): states before
    qvel: velocities of MuJoCo's joints
    speeds: (N,): rows of qvel where the joints begin
    forces: (3 N,) m/s2, body: accelerometer readings, passed to the sensors on board
    """
    for n in range(x.shape[0]):
        b = speeds[n]
        for c in range(3):
            x[n, 3 + c] = qvel[b + c]
            x[n, 10 + c] = qvel[b + 3 + c]
            x[n, c] = x0[n, c] + 0.5 * h * (x0[n, 3 + c] + x[n, 3 + c])
            lanes[n // LANE_COUNT].m[
                SPECIFIC_FORCE_X + c * LANE_COUNT + n % LANE_COUNT
            ] = forces[3 * n + c]
        turn = rotation_exponential(
            0.5 * h * (x0[n, 10] + x[n, 10]),
            0.5 * h * (x0[n, 11] + x[n, 11]),
            0.5 * h * (x0[n, 12] + x[n, 12]),
        )
        x[n, 6], x[n, 7], x[n, 8], x[n, 9] = normalize_quaternion(
            quaternion_product((x0[n, 6], x0[n, 7], x0[n, 8], x0[n, 9]), turn)
        )


@kernel()
def _compute_point_velocity(
    body: int, p: Triple, twists: Mat, centres: Mat, roots: Rows
) -> Triple:
    """Return the velocity of the point p of a body in m/s, world.

    twists: (n, 6): MuJoCo's cvel, about the centres of the bodies' trees
    centres: (n, 3) m: these centres
    roots: (n,): root of the tree of each body
    """
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
    strided_matrix,
    strided_matrix,
    body_numbers,
    body_numbers,
    matrix,
    matrix,
    numbers,
    memory,
    memory,
    numba.int64[::1],
)
def find_contacts(
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
    """Find the drones that touch something, and the geom that each hit fastest.

        speed = n . (v_1 - v_2),  n from geom 1 to geom 2

    geoms: (k, 2): geoms of each contact
    points: (k, 3) m: point of each contact
    frames: (k, 9): frame of each contact, with n as its first row
    body_of: body of each geom
    drone_of: row of the drone of each body, -1 for none
    touching: (N,): 1 for a drone that touches something
    impact: (N,) m/s: fastest hit, replaced by a faster hit
    against: (N,): the geom of that hit
    """
    for c in range(geoms.shape[0]):
        one = body_of[geoms[c, 0]]
        two = body_of[geoms[c, 1]]
        p = (points[c, 0], points[c, 1], points[c, 2])
        u = _compute_point_velocity(one, p, twists, centres, roots)
        v = _compute_point_velocity(two, p, twists, centres, roots)
        n = (frames[c, 0], frames[c, 1], frames[c, 2])
        speed = dot(n, (u[0] - v[0], u[1] - v[1], u[2] - v[2]))
        for k in range(2):
            row = drone_of[one if k == 0 else two]
            if row >= 0:
                touching[row] = 1.0
                if speed > impact[row] and math.isfinite(speed):
                    impact[row] = speed
                    against[row] = geoms[c, 1 - k]
