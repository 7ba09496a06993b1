"""What unicycles and integrators do, and the laws that drive them."""

import math

import numpy as np
import pytest
from robots import heading, world_of
from scipy.integrate import solve_ivp

from crazychoir.config.checks import WORLD_URIS
from crazychoir.control.robots import DoubleIntegratorCtrl, SingleIntegratorCtrl
from crazychoir.control.unicycle import UnicyclePoseCtrl, UnicycleVelocityCtrl
from crazychoir.numerics.math3d import quaternion_of_yaw, wrap_angle
from crazychoir.types import Acc, Drive, FullState, State, Vel

DRAW = np.random.default_rng(3)


def after(world, command, seconds):
    world.link(0, world.kind).send(command)
    for _ in range(round(seconds / world.dt)):
        world.step()
    return world.state(0)


@pytest.mark.parametrize(("v", "w"), [(0.7, 1.9), (-0.4, -2.5), (0.5, 0.0)])
def test_a_unicycle_moves_as_its_equations_say(v, w):
    start = (0.3, -0.2, 0.8)
    exact = solve_ivp(
        lambda t, y: [v * math.cos(y[2]), v * math.sin(y[2]), w],
        (0.0, 2.0),
        start,
        rtol=1e-12,
        atol=1e-12,
    ).y[:, -1]
    world = world_of(WORLD_URIS.unicycle, [(*start[:2], 0.0)], [start[2]], dt=0.1)
    state = after(world, Drive(np.array([v, w])), 2.0)
    assert [*state.p[:2], 0.0] == pytest.approx([*exact[:2], 0.0], abs=1e-9)
    assert wrap_angle(heading(world) - exact[2]) == pytest.approx(0.0, abs=1e-9)
    assert state.v[:2] == pytest.approx(
        [v * math.cos(exact[2]), v * math.sin(exact[2])], abs=1e-9
    )
    assert state.w[2] == w


def test_integrators_move_as_their_equations_say():
    u = np.array([0.4, -0.3, 0.2])
    single = after(
        world_of(WORLD_URIS.single_integrator, [(1.0, 2.0, 3.0)]),
        Vel(np.array([*u, 0.5])),
        2.0,
    )
    assert single.p == pytest.approx([1.8, 1.4, 3.4])
    assert single.v == pytest.approx(u)
    assert 2.0 * math.atan2(single.q[2], single.q[3]) == pytest.approx(1.0)
    double = after(
        world_of(WORLD_URIS.double_integrator, [(1.0, 2.0, 3.0)], dt=0.1), Acc(u), 2.0
    )
    assert double.p == pytest.approx(np.array([1.0, 2.0, 3.0]) + 2.0 * u), (
        "p + u t^2 / 2, whatever dt is"
    )
    assert double.v == pytest.approx(2.0 * u)


@pytest.mark.parametrize("yaw", [0.0, 0.9, 2.7, -1.6])
def test_the_point_ahead_of_the_axle_obeys_its_velocity(yaw):
    law = UnicycleVelocityCtrl(ahead=0.1, v_max=9.0, w_max=99.0)
    u, h = np.array([0.3, -0.4]), 1e-6
    world = world_of(WORLD_URIS.unicycle, [(0.5, 0.2, 0.0)], [yaw], dt=h)
    before = world.state(0).p[:2] + 0.1 * np.array([math.cos(yaw), math.sin(yaw)])
    p = after(world, Drive(law.input(yaw, u)), h).p[:2]
    turned = heading(world)
    assert (
        p + 0.1 * np.array([math.cos(turned), math.sin(turned)]) - before
    ) / h == pytest.approx(u, abs=1e-4)


def test_a_cut_of_v_and_w_keeps_the_way():
    free, cut = (
        UnicycleVelocityCtrl(v_max=99.0, w_max=99.0),
        UnicycleVelocityCtrl(v_max=0.5, w_max=2.0),
    )
    for yaw in np.linspace(-3.0, 3.0, 20):
        (v, w), (a, b) = (
            free.input(yaw, np.array([2.0, 1.0])),
            cut.input(yaw, np.array([2.0, 1.0])),
        )
        assert a * w == pytest.approx(b * v)
        assert abs(a) <= 0.5 + 1e-12
        assert abs(b) <= 2.0 + 1e-12


def test_the_axle_never_goes_away_from_a_goal_that_it_is_drawn_to():
    law, goal = UnicycleVelocityCtrl(), np.array([0.4, -0.7])
    for yaw in DRAW.uniform(-3.0, 3.0, 5):
        world, far = world_of(WORLD_URIS.unicycle, [(-0.5, 0.6, 0.0)], [yaw]), []
        for _ in range(1000):
            state = after(
                world,
                Drive(law.input(heading(world), 1.5 * (goal - world.state(0).p[:2]))),
                0.01,
            )
            far.append(float(np.linalg.norm(state.p[:2] - goal)))
        assert np.diff(far).max() < 1e-4, "but for what a step of 10 ms adds"
        assert far[-1] < 1e-3


def test_the_error_of_the_steering_decays_over_the_way():
    """z = delta - atan(-k1 theta):  z' = -k2 (v / r) z, under theta' = delta' - w = (v / r) sin delta."""
    law = UnicyclePoseCtrl(k1=1.3, k2=2.5, w_max=99.0)
    for r, theta, delta in DRAW.uniform([0.3, -1.4, -1.4], [2.0, 1.4, 1.4], (20, 3)):
        kappa, v, h = law.curvature(r, theta, delta), 0.4, 1e-6

        def z(theta, delta):
            return delta - math.atan(-1.3 * theta)

        turn = v / r * math.sin(delta)
        rate = (
            z(theta + h * turn, delta + h * (turn + kappa * v)) - z(theta, delta)
        ) / h
        assert rate == pytest.approx(-2.5 * v / r * z(theta, delta), abs=1e-4)


@pytest.mark.parametrize("goal_yaw", [0.0, 1.5, 3.1, -2.0])
@pytest.mark.parametrize("place", [(1.5, 0.0), (-1.0, 0.8), (0.0, -1.2)])
def test_it_parks_at_a_place_with_a_heading(place, goal_yaw):
    law, goal = UnicyclePoseCtrl(v_max=0.5), np.array(place)
    world = world_of(WORLD_URIS.unicycle, [(0.0, 0.0, 0.0)], [0.3])
    for _ in range(1500):
        state = world.state(0)
        if np.linalg.norm(state.p[:2] - goal) < 0.02:
            break
        u = law.input(state.p[:2], heading(world), goal, goal_yaw)
        assert 0.0 < u[0] <= 0.5, "forwards, never faster than allowed"
        after(world, Drive(u), 0.01)
    assert np.linalg.norm(world.state(0).p[:2] - goal) < 0.02
    assert abs(wrap_angle(heading(world) - goal_yaw)) < 0.05


def test_integrators_come_to_a_reference_as_their_laws_say():
    reference = FullState.at(
        (1.0, 0.5, 0.2), (0.1, -0.2, 0.0), (0.3, 0.0, -0.1), yaw=0.4, yaw_rate=0.1
    ).flat
    state = State(
        np.array([0.8, 0.6, 0.1, 0.0, 0.1, 0.2, *quaternion_of_yaw(0.1), 0.0, 0.0, 0.0])
    )
    e, de = reference[0:3] - state.p, reference[3:6] - state.v
    single = SingleIntegratorCtrl(k=2.0, v_max=9.0).input(state, reference)
    assert single == pytest.approx([*(reference[3:6] + 2.0 * e), 0.1 + 2.0 * 0.3])
    assert np.linalg.norm(
        SingleIntegratorCtrl(v_max=0.1).input(state, reference)[:3]
    ) == pytest.approx(0.1)
    double = DoubleIntegratorCtrl(kp=3.0, kv=2.0, a_max=9.0).input(state, reference)
    assert double == pytest.approx(reference[6:9] + 2.0 * de + 3.0 * e)
    assert np.linalg.norm(
        DoubleIntegratorCtrl(a_max=0.1).input(state, reference)
    ) == pytest.approx(0.1)
