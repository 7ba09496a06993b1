"""The equations of the collision filter, against finite differences and a reference solver."""

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.safety.airspace.distances import BRAKING_MODEL, compute_silent_gap
from crazychoir.safety.airspace.motion import predict_late_motion
from crazychoir.safety.collision.barrier import (
    compute_barrier_acceleration,
    compute_closing_speed,
    compute_yield_share,
)
from crazychoir.safety.collision.cells import compute_cell_acceleration
from crazychoir.safety.collision.projection import project

STIFF, GAMMA = 1.5, 4.0
BOX = np.array(
    [
        [s * (c == axis) for c in range(3)] + [-4.0]
        for axis in range(3)
        for s in (1.0, -1.0)
    ]
)


def motions(seed):
    """r, w m and m/s, and accelerations of both m/s2, all scaled, drawn at random."""
    draw = np.random.default_rng(seed)
    r = draw.normal(size=3) * draw.uniform(0.2, 1.5)
    return r, draw.normal(size=3), draw.normal(size=3), draw.normal(size=3)


def limit(gap, brake):
    return compute_closing_speed(gap, brake, STIFF)[0]


def test_the_braking_curve_is_smooth_and_beyond_its_knee_one_can_brake_on_it():
    gaps = np.linspace(-0.2, 2.0, 2001)
    speeds, slopes = np.array([compute_closing_speed(g, 1.0, STIFF) for g in gaps]).T
    assert np.allclose(np.gradient(speeds, gaps)[1:-1], slopes[1:-1], atol=5e-3)
    assert np.all(np.abs(np.diff(slopes)) < 5e-3), "no kink"
    assert np.allclose((speeds * slopes)[gaps > 0.45], 1.0), (
        "s s' = alpha: braking with alpha stays on the curve"
    )
    assert np.allclose(speeds[gaps < 0.4], STIFF * gaps[gaps < 0.4])


@pytest.mark.parametrize("seed", range(20))
def test_the_barrier_asks_for_its_own_derivative(seed):
    r, w, a_i, a_j = motions(seed)
    brake, width, dt = 1.3, 0.3, 1e-6

    def h(t):
        rt, wt = r + t * w + 0.5 * t * t * (a_i - a_j), w + t * (a_i - a_j)
        d = np.linalg.norm(rt)
        return limit(d - width, brake) + rt @ wt / d - 0.1

    rate = (h(dt) - h(-dt)) / (2.0 * dt)
    gap = float(np.linalg.norm(r)) - width
    asked = compute_barrier_acceleration(
        tuple(r), tuple(w), gap, 0.1, brake, STIFF, GAMMA
    )
    given = r @ (a_i - a_j) / np.linalg.norm(r)
    assert given - asked == pytest.approx(rate + GAMMA * h(0.0), abs=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_the_cell_asks_for_its_own_derivative(seed):
    r, w, a_i, a_j = motions(seed)
    own = np.random.default_rng(1000 + seed).normal(size=3)
    brake, width, dt = 0.8, 0.3, 1e-6

    def h(t):
        rt, vt = r + t * w + 0.5 * t * t * (a_i - a_j), own + t * a_i
        d = np.linalg.norm(rt)
        return limit(0.5 * (d - width), brake) + rt @ vt / d - 0.1

    rate = (h(dt) - h(-dt)) / (2.0 * dt)
    gap = float(np.linalg.norm(r)) - width
    asked = compute_cell_acceleration(
        tuple(r), tuple(w), tuple(own), gap, 0.1, brake, STIFF, GAMMA
    )
    assert r @ a_i / np.linalg.norm(r) - asked == pytest.approx(
        rate + GAMMA * h(0.0), abs=1e-5
    )


def test_both_drones_together_take_the_whole_barrier():
    for own, other in ((-1.0, 0.0), (-0.3, -0.9), (0.5, 0.2), (0.0, 0.0)):
        assert compute_yield_share(own, other) + compute_yield_share(
            other, own
        ) == pytest.approx(1.0)
    assert compute_yield_share(0.0, -1.0) < 0.06, "a drone that stands gives way little"


def test_a_drone_that_obeys_late_is_a_double_integrator_in_its_late_motion():
    """a_t' = (u - a_t) / T, v' = a_t, p' = v, in small steps: p~ and v~ are those of constant u."""
    lag, u, h, steps = 0.12, np.array([0.8, -0.5, 0.3]), 1e-5, 20_000
    a, v, p = (
        np.array([1.5, 0.4, 0.3]),
        np.array([0.2, -0.1, 0.4]),
        np.array([0.1, 0.2, 1.0]),
    )

    def state(p, v, a):
        z = np.array([a[0], a[1], STANDARD_GRAVITY]) / np.linalg.norm(
            [a[0], a[1], STANDARD_GRAVITY]
        )
        q = np.array([-z[1], z[0], 0.0, 1.0 + z[2]])
        return np.concatenate([p, v, q / np.linalg.norm(q), np.zeros(3)])

    expected = np.array(predict_late_motion(state(p, v, a), u, lag, h * steps, 1.0))
    for _ in range(steps):
        p, v, a = p + h * v, v + h * a, a + h * (u - a) / lag
    assert np.allclose(
        np.array(predict_late_motion(state(p, v, a), u, lag, 0.0, 1.0)),
        expected,
        atol=2e-5,
    )


def problem(seed):
    draw = np.random.default_rng(seed)
    n = draw.normal(size=(draw.integers(1, 12), 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    rows = np.vstack([BOX, np.column_stack([n, 2.5 * draw.normal(size=len(n))])])
    return draw.normal(size=3) * 4.0, rows


def relaxed(rows):
    """The half spaces, each moved by its least violation where those before it leave no point."""
    rows = rows.copy()
    for k in range(6, len(rows)):
        most = linprog(
            -rows[k, :3],
            A_ub=-rows[:k, :3],
            b_ub=-rows[:k, 3],
            bounds=[(None, None)] * 3,
        )
        rows[k, 3] = min(rows[k, 3], -most.fun - 1e-6)
    return rows


@pytest.mark.parametrize("seed", range(40))
def test_the_projection_is_that_of_a_quadratic_program_relaxed_in_order(seed):
    u, rows = problem(seed)
    wanted, x, out = relaxed(rows), cp.Variable(3), np.empty(3)
    cp.Problem(
        cp.Minimize(cp.sum_squares(x - u)), [wanted[:, :3] @ x >= wanted[:, 3] - 1e-9]
    ).solve(cp.CLARABEL)
    count = project(u, rows, out)
    assert count == np.sum(wanted[:, 3] < problem(seed)[1][:, 3] - 1e-9)
    assert np.linalg.norm(out - x.value) < 3e-3
    assert np.linalg.norm(out - u) <= np.linalg.norm(x.value - u) + 1e-3
    assert np.all(wanted[:, :3] @ out >= wanted[:, 3] - 1e-5)


@pytest.mark.parametrize(("v_max", "a_max"), [(1.0, 2.0), (3.0, 6.0), (1.0, 8.0)])
def test_two_silent_drones_keep_room_for_both_to_stop(v_max, a_max):
    """Each flies on at first, then brakes with the smaller of a_max and k v."""
    h = 1e-4
    v, flown = v_max, BRAKING_MODEL.response_time * v_max
    while v > 1e-4 * v_max:
        flown += h * v
        v -= h * min(a_max, BRAKING_MODEL.gain * v)
    assert compute_silent_gap(v_max, a_max) == pytest.approx(2.0 * flown, rel=2e-3)


def test_slow_drones_keep_half_a_metre_from_a_silent_one():
    assert compute_silent_gap(0.2, 2.0) == 0.5
