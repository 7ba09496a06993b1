"""The body of a quadrotor: the wrench of its four rotors and the step of its equations of motion.

The inputs are motor commands. Motors are arranged in an X: M1 front right, M2 back right, M3 back
left, M4 front left. M1 and M3 turn counter-clockwise seen from above, so their drag turns the body
clockwise. The drones lie in the blocks of `lanes`.
"""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import GRAVITY, clip, columns, dot
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    AIRX,
    AIRY,
    AIRZ,
    ALIVE1,
    ARM,
    BOOST,
    CEILING,
    CURVE1,
    CURVE2,
    DRAGX,
    DRAGY,
    DRAGZ,
    EX,
    EY,
    EZ,
    F1,
    FREE,
    FULL,
    G1,
    G2,
    G3,
    G4,
    GROUND,
    HALF,
    IJX,
    IJY,
    IJZ,
    INERTIA,
    JX,
    JY,
    JZ,
    LANES,
    LEAST,
    LIFT,
    LIGHT,
    MOST,
    N1,
    N2,
    N3,
    N4,
    OX,
    OY,
    OZ,
    PX,
    PY,
    PZ,
    QW,
    QX,
    QY,
    QZ,
    S1,
    S2,
    S3,
    S4,
    SLOPE1,
    SLOPE2,
    SLOPE3,
    SLOPE4,
    SPEED,
    SPIN,
    STAGE,
    SX,
    SY,
    SZ,
    TORQUE1,
    TORQUE2,
    TX,
    TY,
    TZ,
    U1,
    VX,
    VY,
    VZ,
    WX,
    WY,
    WZ,
)
# isort: on

ROTOR_HEIGHT = 0.025
"""Height in m of the rotors above the floor when the drone stands.

The whole drone is 29 mm high (Bitcraze).
"""


@kernel()
def obey(m: Vec) -> None:
    """Turn the commands u into goal thrusts of the rotors.

        f_c = min(u f_max, f(vbat)),  0 if u f_max < f_min or the motors are cut

    A goal below the least thrust is 0, and no goal exceeds what the battery gives. The firmware
    divides its voltage by the battery's, so the thrust is as commanded until the duty cycle is 1.
    """
    for k in range(LANES):
        for n in range(0, 4 * LANES, LANES):
            f = clip(m[U1 + n + k], 0.0, 1.0) * m[MOST + k]
            f = 0.0 if f < m[LEAST + k] else f
            m[G1 + n + k] = min(f, m[CEILING + k]) * m[ALIVE1 + n + k]


@kernel()
def _lag(m: Vec, decay: int) -> None:
    """Write the thrusts N and slopes S of the rotors after their lag has decayed.

        f(t) = f_c + (f(0) - f_c) exp(-t / lag),  S = df/dr = sqrt(c1^2 + 4 c2 f)

    decay: row of the block with the decay exp(-t / lag), HALF or FULL
    """
    for k in range(LANES):
        c1 = m[CURVE1 + k]
        c2 = m[CURVE2 + k]
        for n in range(0, 4 * LANES, LANES):
            f = m[G1 + n + k] + (m[F1 + n + k] - m[G1 + n + k]) * m[decay + k]
            m[N1 + n + k] = f
            m[S1 + n + k] = math.sqrt(c1 * c1 + 4.0 * c2 * f)


@kernel()
def _drag(m: Vec, k: int, s: float) -> tuple[float, float]:
    """Return the speed in rpm and the drag in N m of a rotor at the slope s.

    r = (s - c1) / (2 c2),   m = t1 r + t2 r^2
    """
    r = (s - m[CURVE1 + k]) * m[SPEED + k]
    return r, r * (m[TORQUE1 + k] + m[TORQUE2 + k] * r)


@kernel()
def _push(m: Vec) -> None:
    """Write the force and torques of the four rotors together, about the body's axes.

    LIFT = f1 + f2 + f3 + f4
    TX = arm (-f1 - f2 + f3 + f4)
    TY = arm (-f1 + f2 + f3 - f4)
    TZ = -m1 + m2 - m3 + m4,   m = t1 r + t2 r^2 + J r',   r' = f' / S,   f' = (f_c - f) / lag
    SPIN = J (r1 - r2 + r3 - r4)
    """
    for k in range(LANES):
        f1 = m[N1 + k]
        f2 = m[N2 + k]
        f3 = m[N3 + k]
        f4 = m[N4 + k]
        s1 = m[S1 + k]
        s2 = m[S2 + k]
        s3 = m[S3 + k]
        s4 = m[S4 + k]
        r1, m1 = _drag(m, k, s1)
        r2, m2 = _drag(m, k, s2)
        r3, m3 = _drag(m, k, s3)
        r4, m4 = _drag(m, k, s4)
        # r1' + r3' and r2' + r4' share one denominator: a division costs as much as the rest.
        odd = ((m[G1 + k] - f1) * s3 + (m[G3 + k] - f3) * s1) * (s2 * s4)
        even = ((m[G2 + k] - f2) * s4 + (m[G4 + k] - f4) * s2) * (s1 * s3)
        m[LIFT + k] = (f1 + f2) + (f3 + f4)
        m[TX + k] = m[ARM + k] * ((f3 + f4) - (f1 + f2))
        m[TY + k] = m[ARM + k] * ((f2 + f3) - (f1 + f4))
        m[TZ + k] = (
            (m2 + m4)
            - (m1 + m3)
            + m[BOOST + k] * ((even - odd) / ((s1 * s3) * (s2 * s4)))
        )
        m[SPIN + k] = m[INERTIA + k] * ((r1 + r3) - (r2 + r4))


@kernel()
def near_floor(z: float, ground: float) -> float:
    """Return the factor by which a rotor's thrust grows near the floor.

        f / f_free = 1 / (1 - (R / (4 z))^2)

    z: m, height of the drone; its rotors are higher, so the factor is bounded
    ground: (R / 4)^2 in m2, R the radius of a rotor
    Source: Cheeseman & Bennett 1955, ARC R&M 3021.
    """
    h = max(z, 0.0) + ROTOR_HEIGHT
    return h * h / (h * h - ground)


@kernel()
def _go(m: Vec, row: int, at: int, slope: float, ahead: float) -> None:
    """Store a slope and set the state of the next stage, `ahead` s along that slope."""
    m[at + row] = slope
    m[STAGE + row] = m[row] + ahead * slope


@kernel()
def _stage(m: Vec, at: int, ahead: float) -> None:
    """Compute one stage of the Runge-Kutta method: the forces and the slopes at the stage's state.

        p' = v,  v' = -g e3 + R s + F / m,  q' = 1/2 q (w, 0)
        m s = g(z) LIFT e3 - A R^T (v - wind),  J w' = tau - w x (J w + SPIN e3)
        tau = g(z) (TX, TY, 0) + (0, 0, TZ) + M

    F: N, world: external force
    M: N m, body: external torque
    A: kg/s: diagonal drag matrix
    The specific force, which the accelerometer senses, is s + R^T F / m.
    """
    for k in range(LANES):
        s = STAGE + k
        q = (m[s + QX], m[s + QY], m[s + QZ], m[s + QW])
        bx, by, bz = columns(q)
        v = (m[s + VX], m[s + VY], m[s + VZ])
        w = (m[s + WX], m[s + WY], m[s + WZ])
        air = (v[0] - m[AIRX + k], v[1] - m[AIRY + k], v[2] - m[AIRZ + k])
        force = (m[EX + k], m[EY + k], m[EZ + k])
        g = near_floor(m[s + PZ], m[GROUND + k])
        light = m[LIGHT + k]
        sx = (dot(bx, force) - m[DRAGX + k] * dot(bx, air)) * light
        sy = (dot(by, force) - m[DRAGY + k] * dot(by, air)) * light
        sz = (dot(bz, force) - m[DRAGZ + k] * dot(bz, air) + g * m[LIFT + k]) * light
        m[SX + k] = sx
        m[SY + k] = sy
        m[SZ + k] = sz
        jx = m[JX + k]
        jy = m[JY + k]
        jz = m[JZ + k]
        spin = m[SPIN + k]
        _go(m, PX + k, at, v[0], ahead)
        _go(m, PY + k, at, v[1], ahead)
        _go(m, PZ + k, at, v[2], ahead)
        _go(m, VX + k, at, sx * bx[0] + sy * by[0] + sz * bz[0], ahead)
        _go(m, VY + k, at, sx * bx[1] + sy * by[1] + sz * bz[1], ahead)
        _go(m, VZ + k, at, sx * bx[2] + sy * by[2] + sz * bz[2] - GRAVITY, ahead)
        _go(m, QX + k, at, 0.5 * (q[3] * w[0] + q[1] * w[2] - q[2] * w[1]), ahead)
        _go(m, QY + k, at, 0.5 * (q[3] * w[1] + q[2] * w[0] - q[0] * w[2]), ahead)
        _go(m, QZ + k, at, 0.5 * (q[3] * w[2] + q[0] * w[1] - q[1] * w[0]), ahead)
        _go(m, QW + k, at, -0.5 * (q[0] * w[0] + q[1] * w[1] + q[2] * w[2]), ahead)
        tx = g * m[TX + k] + m[OX + k]
        ty = g * m[TY + k] + m[OY + k]
        tz = m[TZ + k] + m[OZ + k]
        _go(
            m,
            WX + k,
            at,
            (tx + (jy - jz) * w[1] * w[2] - w[1] * spin) * m[IJX + k],
            ahead,
        )
        _go(
            m,
            WY + k,
            at,
            (ty + (jz - jx) * w[2] * w[0] + w[0] * spin) * m[IJY + k],
            ahead,
        )
        _go(m, WZ + k, at, (tz + (jx - jy) * w[0] * w[1]) * m[IJZ + k], ahead)


@kernel()
def _arrive(m: Vec, h: float) -> None:
    """End a step: write the new state and the new thrusts of the rotors.

    A drone on the floor (FREE = 0) keeps its state.
    """
    for k in range(LANES):
        for c in range(0, 13 * LANES, LANES):
            middle = m[SLOPE2 + c + k] + m[SLOPE3 + c + k]
            m[c + k] += (
                m[FREE + k]
                * (h / 6.0)
                * (m[SLOPE1 + c + k] + 2.0 * middle + m[SLOPE4 + c + k])
            )
        n = 1.0 / math.sqrt(
            m[QX + k] ** 2 + m[QY + k] ** 2 + m[QZ + k] ** 2 + m[QW + k] ** 2
        )
        for c in range(QX, QX + 4 * LANES, LANES):
            m[c + k] *= n
        for c in range(0, 13 * LANES, LANES):
            m[STAGE + c + k] = m[c + k]
        for c in range(0, 4 * LANES, LANES):
            m[F1 + c + k] = m[N1 + c + k]


@kernel()
def fly(m: Vec, h: float) -> None:
    """Make one step of h s by the classical Runge-Kutta method of order 4.

    The wrench is computed anew at each stage. The lag of the rotors is followed exactly: HALF and
    FULL must be the decays of h/2 and h.
    """
    _push(m)
    _stage(m, SLOPE1, 0.5 * h)
    _lag(m, HALF)
    _push(m)
    _stage(m, SLOPE2, 0.5 * h)
    _stage(m, SLOPE3, h)
    _lag(m, FULL)
    _push(m)
    _stage(m, SLOPE4, 0.0)
    _arrive(m, h)
