"""The motor-level body against equations written once more, an adaptive integrator, MuJoCo, and conservation laws."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from crazychoir.numerics.math3d import STANDARD_GRAVITY, rotation, rotation_exponential
from crazychoir.platforms import (
    CRAZYFLIE_21,
    CRAZYFLIE_21_BRUSHLESS,
    PLATFORM_BY_NAME,
    BodyEffects,
    rotor_speed,
)
from crazychoir.simulation.motor_level import lanes
from crazychoir.simulation.motor_level.body import (
    ROTOR_HEIGHT,
    compute_ground_effect,
    integrate_bodies,
)
from crazychoir.simulation.motor_level.lanes import (
    FULL_STEP_DECAY,
    GOAL_THRUST_1,
    HALF_STEP_DECAY,
    LANE_COUNT,
)
from crazychoir.simulation.motor_level.motors import MotorConditions, MotorWorld

P = replace(
    CRAZYFLIE_21,
    effects=BodyEffects(speed_moment=(6e-4, 7e-4), rate_damping=(5e-5, 6e-5, 8e-5)),
)
WIND = np.array([0.5, -0.3, 0.2])
PUSH, TWIST = np.array([0.01, -0.02, 0.015]), np.array([1e-5, -2e-5, 1.5e-5])
PLACES = P.arm * np.array([[1, -1, 0], [-1, -1, 0], [-1, 1, 0], [1, 1, 0]])
TURNS = np.array([1, -1, 1, -1])  # counter-clockwise seen from above
START = np.array(
    [
        0.3,
        -0.2,
        0.15,
        0.8,
        -0.5,
        0.9,
        *rotation_exponential(0.2, -0.3, 0.5),
        2.0,
        -3.0,
        4.0,
    ]
)


def rotors(f, goal, platform):
    """Speeds rad/s and their derivatives, and the drag N m of four rotors with the thrusts f (4,)."""
    c1, c2 = platform.rotor.thrust
    r = np.array([rotor_speed(platform.rotor, one) for one in f])
    change = (goal - f) / platform.rotor.lag / (c1 + 2 * c2 * r)
    drag = platform.rotor.torque[0] * r + platform.rotor.torque[1] * r**2
    return r * math.pi / 30, change * math.pi / 30, drag


def wrench(p, v, r, w, f, goal, platform=P, wind=WIND, push=PUSH, twist=TWIST):
    """Force N world without the weight, torque N m body without that of the body's own angular momentum."""
    height = max(p[2], 0) + ROTOR_HEIGHT
    ground = 1 / (1 - (platform.rotor.radius / (4 * height)) ** 2)
    speed, change, drag = rotors(f, goal, platform)
    force = (
        r[:, 2] * ground * f.sum()
        - r @ np.diag(platform.drag) @ r.T @ (v - wind)
        + push
    )
    torque = sum(
        np.cross(at, [0, 0, ground * one])
        for at, one in zip(PLACES * platform.arm / P.arm, f, strict=True)
    )
    torque[2] -= TURNS @ (drag + platform.rotor.inertia * change)
    spin = np.array([0, 0, platform.rotor.inertia * TURNS @ speed])
    effects = platform.effects
    x, y, _ = r.T @ (v - wind)
    about_x, about_y = effects.speed_moment or (0.0, 0.0)
    lifted = np.array([about_x * y, -about_y * x, 0.0])
    damped = np.array(effects.rate_damping or (0.0, 0.0, 0.0)) * w
    return force, torque - np.cross(w, spin) + twist + lifted - damped


def slope(t, y, goal):
    p, v, q, w, f = y[:3], y[3:6], y[6:10], y[10:13], y[13:]
    r = rotation(q / np.linalg.norm(q))
    force, torque = wrench(p, v, r, w, f, goal)
    j = np.array(P.inertia)
    dq = 0.5 * np.array([*(q[3] * w + np.cross(q[:3], w)), -q[:3] @ w])
    a = force / P.mass - [0, 0, STANDARD_GRAVITY]
    return np.concatenate(
        [v, a, dq, (torque - np.cross(w, j * w)) / j, (goal - f) / P.rotor.lag]
    )


def hovering(start=START, platform=P):
    """A world of one drone in the air, its rotors at hover."""
    world = MotorWorld(
        [0],
        np.array([[*start[:2], 1.0]]),
        platform=platform,
        conditions=MotorConditions(has_downwash=False),
    )
    world.states[0] = start
    return world


def flown(h, until, goal):
    world = hovering()
    world.force[0], world.torque[0] = PUSH, TWIST
    world._run(0, 0)
    m = world._blocks[0]
    for name, value in {
        HALF_STEP_DECAY: math.exp(-0.5 * h / P.rotor.lag),
        FULL_STEP_DECAY: math.exp(-h / P.rotor.lag),
    }.items():
        m[name : name + LANE_COUNT] = value
    for c in range(4):
        m[GOAL_THRUST_1 + c * LANE_COUNT] = goal[c]
    for c in range(3):
        m[lanes.WIND_X + c * LANE_COUNT] = WIND[c]
    for _ in range(round(until / h)):
        integrate_bodies(m, h)
    return m[0 : 13 * LANE_COUNT : LANE_COUNT].copy()


GOAL = np.array([0.093, 0.086, 0.088, 0.090])


@pytest.fixture(scope="module")
def truth():
    y0 = np.concatenate([START, np.full(4, P.weight / 4)])
    return solve_ivp(
        slope, (0, 0.4), y0, method="DOP853", rtol=1e-13, atol=1e-15, args=(GOAL,)
    ).y[:13, -1]


def test_the_order_is_four(truth):
    steps = np.array([0.008, 0.004, 0.002])
    errors = [np.linalg.norm(flown(h, 0.4, GOAL)[:3] - truth[:3]) for h in steps]
    orders = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert np.all(orders > 3.9), (orders, errors)
    assert np.all(orders < 4.1), (orders, errors)


def test_a_step_of_a_millisecond_follows_the_equations_to_a_nanometre(truth):
    x = flown(0.001, 0.4, GOAL)
    assert np.linalg.norm(x[:3] - truth[:3]) < 1e-9
    np.testing.assert_allclose(
        x[6:10], truth[6:10] / np.linalg.norm(truth[6:10]), atol=1e-9
    )
    np.testing.assert_allclose(x[10:13], truth[10:13], atol=1e-7)


def test_motors_make_their_share_of_the_thrust_after_their_delay():
    factors = (0.9, 1.0, 1.05, 0.8)
    delay = 0.02
    platform = replace(P, effects=BodyEffects(motor_factors=factors, delay=delay))
    world = hovering(platform=platform)
    hover = platform.weight / 4
    world.command(0, np.full(4, 0.09 / platform.firmware.thrust_max))
    for _ in range(3):
        world.step()
    goals = world._blocks[0][
        GOAL_THRUST_1 : GOAL_THRUST_1 + 4 * LANE_COUNT : LANE_COUNT
    ]
    wanted = 0.09 * np.array(factors)
    np.testing.assert_allclose(
        goals, wanted + (hover - wanted) * math.exp(-0.03 / delay), rtol=1e-12
    )


def test_the_effects_that_flights_show_are_off_for_every_platform():
    assert {row.effects for row in PLATFORM_BY_NAME.values()} == {BodyEffects()}
    for platform in PLATFORM_BY_NAME.values():
        constants = lanes.compute_constants(platform, 0.001, True)
        assert constants[lanes.DELAY_DECAY] == 0.0
        assert constants[lanes.SPEED_MOMENT_X] == 0.0
        assert constants[lanes.RATE_DAMPING_X] == 0.0


def test_without_torque_and_drag_a_tumbling_fall_keeps_energy_and_angular_momentum():
    platform = replace(CRAZYFLIE_21_BRUSHLESS, drag=(0.0, 0.0, 0.0))
    world = hovering(
        np.array(
            [
                0,
                0,
                50.0,
                1,
                -2,
                3,
                *rotation_exponential(0.2, -0.3, 0.5),
                9.0,
                -7.0,
                4.0,
            ]
        ),
        platform,
    )
    world.cut(0)
    m = world._blocks[0]
    for c in range(4):  # rotors that stand still from the start
        m[lanes.ROTOR_THRUST_1 + c * LANE_COUNT] = m[
            lanes.STAGE_THRUST_1 + c * LANE_COUNT
        ] = 0.0
        m[lanes.THRUST_SLOPE_1 + c * LANE_COUNT] = abs(platform.rotor.thrust[0])
    j = np.array(platform.inertia)

    def kept():
        x = world.states[0]
        w = x[10:13]
        energy = (
            0.5 * platform.mass * x[3:6] @ x[3:6]
            + platform.weight * x[2]
            + 0.5 * w @ (j * w)
        )
        return np.array([energy, 0.5 * w @ (j * w), *(rotation(x[6:10]) @ (j * w))])

    before = kept()
    for _ in range(100):
        world.step()
    after = kept()
    assert after[0] == pytest.approx(before[0], rel=1e-10)
    assert after[1] == pytest.approx(before[1], rel=1e-9)
    np.testing.assert_allclose(
        after[2:], before[2:], rtol=0, atol=1e-9 * np.linalg.norm(before[2:])
    )
    assert np.linalg.norm(world.states[0, 10:13] - [9.0, -7.0, 4.0]) > 1.0


def shares(k):
    """An aggressive flight: motor commands of the k-th tenth of a second."""
    draw = np.random.default_rng(k).uniform(-1, 1, 3)
    roll, pitch, yaw = draw * [0.05, 0.05, 0.12]
    mix = np.array([[-1, -1, -1], [-1, 1, 1], [1, 1, -1], [1, -1, 1]])
    return 0.72 + mix @ [roll, pitch, yaw]


def in_mujoco(start, ticks, platform):
    """Fly in MuJoCo's Runge-Kutta integrator, with the wrench computed at each of its stages."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="drone", pos=start[:3])
    body.add_freejoint()
    body.mass, body.inertia, body.explicitinertial = (
        platform.mass,
        platform.inertia,
        True,
    )
    body.ipos, body.iquat = [0, 0, 0], [1, 0, 0, 0]
    spec.option.timestep, spec.option.integrator = 0.001, mujoco.mjtIntegrator.mjINT_RK4
    spec.option.gravity = [0, 0, -STANDARD_GRAVITY]
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = [*start[:3], start[9], *start[6:9]]
    data.qvel[:] = [*start[3:6], *start[10:13]]
    held = {"f": np.full(4, platform.weight / 4), "goal": np.zeros(4), "since": 0.0}

    def thrusts(t):
        return held["goal"] + (held["f"] - held["goal"]) * math.exp(
            -(t - held["since"]) / platform.rotor.lag
        )

    def push(model, data):
        q = data.qpos[[4, 5, 6, 3]]
        r = rotation(q / np.linalg.norm(q))
        none = np.zeros(3)
        v, w = data.qvel[:3].copy(), data.qvel[3:6].copy()
        force, torque = wrench(
            data.qpos[:3],
            v,
            r,
            w,
            thrusts(data.time),
            held["goal"],
            platform,
            none,
            none,
            none,
        )
        data.qfrc_passive[:] = [*force, *torque]

    mujoco.set_mjcb_passive(push)
    try:
        for k in range(ticks):
            if k % 10 == 0:
                held["f"], held["since"] = thrusts(data.time), data.time
                held["goal"] = shares(k // 10) * platform.firmware.thrust_max
            mujoco.mj_step(model, data, nstep=10)
    finally:
        mujoco.set_mjcb_passive(None)
    return data.qpos.copy()


@pytest.mark.parametrize(
    "platform", [CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS], ids=lambda row: row.name
)
def test_two_seconds_of_aggressive_flight_end_where_mujoco_says(platform):
    start = np.array([0, 0, 8.0, 0, 0, 0, 0, 0, 0, 1.0, 0, 0, 0])
    world, fastest = hovering(start, platform), 0.0
    for k in range(200):
        world.command(0, shares(k // 10))
        world.step()
        fastest = max(fastest, np.abs(world.states[0, 10:13]).max())
    expected = in_mujoco(start, 200, platform)
    x = world.states[0]
    assert fastest > 4.0
    assert np.linalg.norm(x[3:6]) > 2.0
    assert world.limited[0] == 0
    assert np.linalg.norm(x[:3] - expected[:3]) < 1e-5, np.linalg.norm(
        x[:3] - expected[:3]
    )
    q = x[[9, 6, 7, 8]] * np.sign(x[9] * expected[3])
    np.testing.assert_allclose(q, expected[3:], atol=1e-5)


def test_ground_effect_is_that_of_cheeseman_and_bennett_bounded_and_gone_far_above():
    radius = P.rotor.radius
    ground = (radius / 4) ** 2
    for height in (0.03, 0.05, 0.1):
        assert compute_ground_effect(height - ROTOR_HEIGHT, ground) == pytest.approx(
            1 / (1 - (radius / 4 / height) ** 2)
        )
    assert (
        compute_ground_effect(-1.0, ground) == compute_ground_effect(0.0, ground) < 1.1
    )
    assert compute_ground_effect(0.5, ground) == pytest.approx(1.0, abs=2e-4)
    assert compute_ground_effect(0.0, 0.0) == 1.0
