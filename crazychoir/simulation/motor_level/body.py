"""The body of a quadrotor: the wrench of its four rotors and the step of its equations of motion.

The inputs are motor commands. Motors are arranged in an X: M1 front right, M2 back right, M3 back
left, M4 front left. M1 and M3 turn counter-clockwise seen from above, so their drag turns the body
clockwise. The drones lie in the blocks of `lanes`.
"""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import STANDARD_GRAVITY, dot, rotation_columns
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    WIND_X,
    WIND_Y,
    WIND_Z,
    MOTOR_ALIVE_1,
    ARM_LENGTH,
    INERTIA_PER_LAG,
    THRUST_CEILING,
    THRUST_CURVE_1,
    THRUST_CURVE_2,
    DRAG_X,
    DRAG_Y,
    DRAG_Z,
    EXTERNAL_FORCE_X,
    EXTERNAL_FORCE_Y,
    EXTERNAL_FORCE_Z,
    ROTOR_THRUST_1,
    AIRBORNE_FLAG,
    FULL_STEP_DECAY,
    GOAL_THRUST_1,
    GOAL_THRUST_2,
    GOAL_THRUST_3,
    GOAL_THRUST_4,
    GROUND_EFFECT_AREA,
    HALF_STEP_DECAY,
    INVERSE_INERTIA_X,
    INVERSE_INERTIA_Y,
    INVERSE_INERTIA_Z,
    ROTOR_INERTIA,
    INERTIA_X,
    INERTIA_Y,
    INERTIA_Z,
    LANE_COUNT,
    SMALLEST_THRUST,
    TOTAL_LIFT,
    INVERSE_MASS,
    LARGEST_THRUST,
    STAGE_THRUST_1,
    STAGE_THRUST_2,
    STAGE_THRUST_3,
    STAGE_THRUST_4,
    EXTERNAL_TORQUE_X,
    EXTERNAL_TORQUE_Y,
    EXTERNAL_TORQUE_Z,
    POSITION_X,
    POSITION_Y,
    POSITION_Z,
    QUATERNION_W,
    QUATERNION_X,
    QUATERNION_Y,
    QUATERNION_Z,
    THRUST_SLOPE_1,
    THRUST_SLOPE_2,
    THRUST_SLOPE_3,
    THRUST_SLOPE_4,
    SLOPE_1,
    SLOPE_2,
    SLOPE_3,
    SLOPE_4,
    SPEED_PER_SLOPE,
    ROTOR_MOMENTUM,
    STAGE_STATE,
    SPECIFIC_FORCE_X,
    SPECIFIC_FORCE_Y,
    SPECIFIC_FORCE_Z,
    TORQUE_CURVE_1,
    TORQUE_CURVE_2,
    ROTOR_TORQUE_X,
    ROTOR_TORQUE_Y,
    ROTOR_TORQUE_Z,
    MOTOR_COMMAND_1,
    VELOCITY_X,
    VELOCITY_Y,
    VELOCITY_Z,
    RATE_X,
    RATE_Y,
    RATE_Z,
    DELAY_DECAY,
    MOTOR_FACTOR_1,
    RATE_DAMPING_X,
    RATE_DAMPING_Y,
    RATE_DAMPING_Z,
    SPEED_MOMENT_X,
    SPEED_MOMENT_Y,
)
# isort: on

ROTOR_HEIGHT = 0.025
"""Height in m of the rotors above the floor when the drone stands.

The whole drone is 29 mm high (Bitcraze).
"""


@kernel()
def set_goal_thrusts(m: Vec) -> None:
    """Turn the commands u into goal thrusts of the rotors.

        f_n = c_n min(u_n f_max, f(vbat)),  0 if u_n f_max < f_min or the motor is cut
        f_c = f_n + (f_c' - f_n) exp(-h / delay)

    f_max: N: thrust of the command 1, not the greatest thrust
    f(vbat): N: thrust at full duty cycle, the only upper limit of a motor
    f_min: N: a motor stops below this thrust
    c_n: factors of the motors, and `delay`: see `platforms.BodyEffects`
    f_c': N: goal one step of h s before
    The firmware divides its voltage by the battery's, so the thrust is as commanded until the duty
    cycle is 1.
    """
    for k in range(LANE_COUNT):
        for n in range(0, 4 * LANE_COUNT, LANE_COUNT):
            f = m[MOTOR_COMMAND_1 + n + k] * m[LARGEST_THRUST + k]
            f = 0.0 if f < m[SMALLEST_THRUST + k] else f
            f = (
                min(f, m[THRUST_CEILING + k])
                * m[MOTOR_FACTOR_1 + n + k]
                * m[MOTOR_ALIVE_1 + n + k]
            )
            m[GOAL_THRUST_1 + n + k] = (
                f + (m[GOAL_THRUST_1 + n + k] - f) * m[DELAY_DECAY + k]
            )


@kernel()
def _apply_rotor_lag(m: Vec, decay: int) -> None:
    """Write the thrusts N and slopes S of the rotors after their lag has decayed.

        f(t) = f_c + (f(0) - f_c) exp(-t / lag),  S = df/dr = sqrt(c1^2 + 4 c2 f)

    decay: row of the block with the decay exp(-t / lag), HALF_STEP_DECAY or FULL_STEP_DECAY
    """
    for k in range(LANE_COUNT):
        c1 = m[THRUST_CURVE_1 + k]
        c2 = m[THRUST_CURVE_2 + k]
        for n in range(0, 4 * LANE_COUNT, LANE_COUNT):
            f = (
                m[GOAL_THRUST_1 + n + k]
                + (m[ROTOR_THRUST_1 + n + k] - m[GOAL_THRUST_1 + n + k]) * m[decay + k]
            )
            m[STAGE_THRUST_1 + n + k] = f
            m[THRUST_SLOPE_1 + n + k] = math.sqrt(c1 * c1 + 4.0 * c2 * f)


@kernel()
def _compute_rotor_drag(m: Vec, k: int, s: float) -> tuple[float, float]:
    """Return the speed in rpm and the drag in N m of a rotor at the slope s.

    r = (s - c1) / (2 c2),   m = t1 r + t2 r^2
    """
    r = (s - m[THRUST_CURVE_1 + k]) * m[SPEED_PER_SLOPE + k]
    return r, r * (m[TORQUE_CURVE_1 + k] + m[TORQUE_CURVE_2 + k] * r)


@kernel()
def _sum_rotor_wrench(m: Vec) -> None:
    """Write the force and torques of the four rotors together, about the body's axes.

    TOTAL_LIFT = f1 + f2 + f3 + f4
    TX = arm (-f1 - f2 + f3 + f4)
    TY = arm (-f1 + f2 + f3 - f4)
    TZ = -m1 + m2 - m3 + m4,   m = t1 r + t2 r^2 + J r',   r' = f' / S,   f' = (f_c - f) / lag
    ROTOR_MOMENTUM = J (r1 - r2 + r3 - r4)
    """
    for k in range(LANE_COUNT):
        f1 = m[STAGE_THRUST_1 + k]
        f2 = m[STAGE_THRUST_2 + k]
        f3 = m[STAGE_THRUST_3 + k]
        f4 = m[STAGE_THRUST_4 + k]
        s1 = m[THRUST_SLOPE_1 + k]
        s2 = m[THRUST_SLOPE_2 + k]
        s3 = m[THRUST_SLOPE_3 + k]
        s4 = m[THRUST_SLOPE_4 + k]
        r1, m1 = _compute_rotor_drag(m, k, s1)
        r2, m2 = _compute_rotor_drag(m, k, s2)
        r3, m3 = _compute_rotor_drag(m, k, s3)
        r4, m4 = _compute_rotor_drag(m, k, s4)
        # r1' + r3' and r2' + r4' share one denominator: a division costs as much as the rest.
        odd = ((m[GOAL_THRUST_1 + k] - f1) * s3 + (m[GOAL_THRUST_3 + k] - f3) * s1) * (
            s2 * s4
        )
        even = ((m[GOAL_THRUST_2 + k] - f2) * s4 + (m[GOAL_THRUST_4 + k] - f4) * s2) * (
            s1 * s3
        )
        m[TOTAL_LIFT + k] = (f1 + f2) + (f3 + f4)
        m[ROTOR_TORQUE_X + k] = m[ARM_LENGTH + k] * ((f3 + f4) - (f1 + f2))
        m[ROTOR_TORQUE_Y + k] = m[ARM_LENGTH + k] * ((f2 + f3) - (f1 + f4))
        m[ROTOR_TORQUE_Z + k] = (
            (m2 + m4)
            - (m1 + m3)
            + m[INERTIA_PER_LAG + k] * ((even - odd) / ((s1 * s3) * (s2 * s4)))
        )
        m[ROTOR_MOMENTUM + k] = m[ROTOR_INERTIA + k] * ((r1 + r3) - (r2 + r4))


@kernel()
def compute_ground_effect(z: float, ground: float) -> float:
    """Return the factor by which a rotor's thrust grows near the floor.

        f / f_free = 1 / (1 - (R / (4 z))^2)

    z: m, height of the drone; its rotors are higher, so the factor is bounded
    ground: (R / 4)^2 in m2, R the radius of a rotor
    Source: Cheeseman & Bennett 1955, ARC R&M 3021.
    """
    h = max(z, 0.0) + ROTOR_HEIGHT
    return h * h / (h * h - ground)


@kernel()
def _store_slope(m: Vec, row: int, at: int, slope: float, ahead: float) -> None:
    """Store a slope and set the state of the next stage, `ahead` s along that slope."""
    m[at + row] = slope
    m[STAGE_STATE + row] = m[row] + ahead * slope


@kernel()
def _compute_stage(m: Vec, at: int, ahead: float) -> None:
    """Compute one stage of the Runge-Kutta method: the forces and the slopes at the stage's state.

        p' = v,  v' = -g e3 + R s + F / m,  q' = 1/2 q (w, 0)
        m s = g(z) TOTAL_LIFT e3 - A R^T (v - wind),  J w' = tau - w x (J w + ROTOR_MOMENTUM e3)
        tau = g(z) (TX, TY, 0) + (0, 0, TZ) + M + (c_x a_y, -c_y a_x, 0) - D w
        a = R^T (v - wind)

    F: N, world: external force
    M: N m, body: external torque
    A: kg/s: diagonal drag matrix
    c_x, c_y: N m per m/s: moments that the air makes of speed, see `platforms.BodyEffects`
    D: N m per rad/s: diagonal matrix of the rate damping
    The specific force, which the accelerometer senses, is s + R^T F / m.
    """
    for k in range(LANE_COUNT):
        s = STAGE_STATE + k
        q = (
            m[s + QUATERNION_X],
            m[s + QUATERNION_Y],
            m[s + QUATERNION_Z],
            m[s + QUATERNION_W],
        )
        bx, by, bz = rotation_columns(q)
        v = (m[s + VELOCITY_X], m[s + VELOCITY_Y], m[s + VELOCITY_Z])
        w = (m[s + RATE_X], m[s + RATE_Y], m[s + RATE_Z])
        air = (v[0] - m[WIND_X + k], v[1] - m[WIND_Y + k], v[2] - m[WIND_Z + k])
        force = (
            m[EXTERNAL_FORCE_X + k],
            m[EXTERNAL_FORCE_Y + k],
            m[EXTERNAL_FORCE_Z + k],
        )
        g = compute_ground_effect(m[s + POSITION_Z], m[GROUND_EFFECT_AREA + k])
        light = m[INVERSE_MASS + k]
        ax = dot(bx, air)
        ay = dot(by, air)
        sx = (dot(bx, force) - m[DRAG_X + k] * ax) * light
        sy = (dot(by, force) - m[DRAG_Y + k] * ay) * light
        sz = (
            dot(bz, force) - m[DRAG_Z + k] * dot(bz, air) + g * m[TOTAL_LIFT + k]
        ) * light
        m[SPECIFIC_FORCE_X + k] = sx
        m[SPECIFIC_FORCE_Y + k] = sy
        m[SPECIFIC_FORCE_Z + k] = sz
        jx = m[INERTIA_X + k]
        jy = m[INERTIA_Y + k]
        jz = m[INERTIA_Z + k]
        spin = m[ROTOR_MOMENTUM + k]
        _store_slope(m, POSITION_X + k, at, v[0], ahead)
        _store_slope(m, POSITION_Y + k, at, v[1], ahead)
        _store_slope(m, POSITION_Z + k, at, v[2], ahead)
        _store_slope(m, VELOCITY_X + k, at, sx * bx[0] + sy * by[0] + sz * bz[0], ahead)
        _store_slope(m, VELOCITY_Y + k, at, sx * bx[1] + sy * by[1] + sz * bz[1], ahead)
        _store_slope(
            m,
            VELOCITY_Z + k,
            at,
            sx * bx[2] + sy * by[2] + sz * bz[2] - STANDARD_GRAVITY,
            ahead,
        )
        _store_slope(
            m,
            QUATERNION_X + k,
            at,
            0.5 * (q[3] * w[0] + q[1] * w[2] - q[2] * w[1]),
            ahead,
        )
        _store_slope(
            m,
            QUATERNION_Y + k,
            at,
            0.5 * (q[3] * w[1] + q[2] * w[0] - q[0] * w[2]),
            ahead,
        )
        _store_slope(
            m,
            QUATERNION_Z + k,
            at,
            0.5 * (q[3] * w[2] + q[0] * w[1] - q[1] * w[0]),
            ahead,
        )
        _store_slope(
            m,
            QUATERNION_W + k,
            at,
            -0.5 * (q[0] * w[0] + q[1] * w[1] + q[2] * w[2]),
            ahead,
        )
        tx = g * m[ROTOR_TORQUE_X + k] + m[EXTERNAL_TORQUE_X + k]
        ty = g * m[ROTOR_TORQUE_Y + k] + m[EXTERNAL_TORQUE_Y + k]
        tz = m[ROTOR_TORQUE_Z + k] + m[EXTERNAL_TORQUE_Z + k]
        tx += m[SPEED_MOMENT_X + k] * ay - m[RATE_DAMPING_X + k] * w[0]
        ty -= m[SPEED_MOMENT_Y + k] * ax + m[RATE_DAMPING_Y + k] * w[1]
        tz -= m[RATE_DAMPING_Z + k] * w[2]
        _store_slope(
            m,
            RATE_X + k,
            at,
            (tx + (jy - jz) * w[1] * w[2] - w[1] * spin) * m[INVERSE_INERTIA_X + k],
            ahead,
        )
        _store_slope(
            m,
            RATE_Y + k,
            at,
            (ty + (jz - jx) * w[2] * w[0] + w[0] * spin) * m[INVERSE_INERTIA_Y + k],
            ahead,
        )
        _store_slope(
            m,
            RATE_Z + k,
            at,
            (tz + (jx - jy) * w[0] * w[1]) * m[INVERSE_INERTIA_Z + k],
            ahead,
        )


@kernel()
def _finish_step(m: Vec, h: float) -> None:
    """End a step: write the new state and the new thrusts of the rotors.

    A drone on the floor (AIRBORNE_FLAG = 0) keeps its state.
    """
    for k in range(LANE_COUNT):
        for c in range(0, 13 * LANE_COUNT, LANE_COUNT):
            middle = m[SLOPE_2 + c + k] + m[SLOPE_3 + c + k]
            m[c + k] += (
                m[AIRBORNE_FLAG + k]
                * (h / 6.0)
                * (m[SLOPE_1 + c + k] + 2.0 * middle + m[SLOPE_4 + c + k])
            )
        n = 1.0 / math.sqrt(
            m[QUATERNION_X + k] ** 2
            + m[QUATERNION_Y + k] ** 2
            + m[QUATERNION_Z + k] ** 2
            + m[QUATERNION_W + k] ** 2
        )
        for c in range(QUATERNION_X, QUATERNION_X + 4 * LANE_COUNT, LANE_COUNT):
            m[c + k] *= n
        for c in range(0, 13 * LANE_COUNT, LANE_COUNT):
            m[STAGE_STATE + c + k] = m[c + k]
        for c in range(0, 4 * LANE_COUNT, LANE_COUNT):
            m[ROTOR_THRUST_1 + c + k] = m[STAGE_THRUST_1 + c + k]


@kernel()
def integrate_bodies(m: Vec, h: float) -> None:
    """Make one step of h s by the classical Runge-Kutta method of order 4.

    The wrench is computed anew at each stage. The lag of the rotors is followed exactly: HALF_STEP_DECAY and
    FULL_STEP_DECAY must be the decays of h/2 and h.
    """
    _sum_rotor_wrench(m)
    _compute_stage(m, SLOPE_1, 0.5 * h)
    _apply_rotor_lag(m, HALF_STEP_DECAY)
    _sum_rotor_wrench(m)
    _compute_stage(m, SLOPE_2, 0.5 * h)
    _compute_stage(m, SLOPE_3, h)
    _apply_rotor_lag(m, FULL_STEP_DECAY)
    _sum_rotor_wrench(m)
    _compute_stage(m, SLOPE_4, 0.0)
    _finish_step(m, h)
