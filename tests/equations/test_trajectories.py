"""The equations of planning: polynomials, splines, minimum snap, figures, flatness, scaling."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.numerics.math3d import STANDARD_GRAVITY, UPWARD_AXIS, rotation_from_flat
from crazychoir.planning.feasibility import (
    DEMAND_NAMES,
    Limits,
    compute_demands,
    compute_peaks,
)
from crazychoir.planning.figure import circle, eight
from crazychoir.planning.minimum_snap import allocate_times, compute_snap, minimum_snap
from crazychoir.planning.piecewise import Piecewise, join_pieces
from crazychoir.planning.polynomial import Polynomial7th
from crazychoir.planning.scaling import (
    SlowedTrajectory,
    compute_slowdown,
    fit_to_limits,
)
from crazychoir.planning.spline import fit_spline
from crazychoir.planning.trajectory import sample_setpoints
from crazychoir.types import FullState

number = st.floats(-2.0, 2.0)
triple = st.tuples(number, number, number)
states = st.builds(FullState.at, triple, triple, triple, triple, number, number)
WAYPOINTS = np.array(
    [[0, 0, 1], [1, 0, 1.2], [1.5, 1, 1], [0.2, 1.4, 0.8], [-0.5, 0.3, 1]], dtype=float
)
TIMES = np.array([0.0, 1.3, 2.1, 4.0, 5.2])


def assert_flat(trajectory, times, h=1e-5, rtol=1e-5):
    """v, a, j and the yaw rate are the derivatives of p, v, a and yaw at the times."""
    for t in times:
        before, here, after = (trajectory.sample(t + d).flat for d in (-h, 0.0, h))
        slope = (after - before) / (2.0 * h)
        np.testing.assert_allclose(slope[0:9], here[3:12], rtol=rtol, atol=1e-4)
        assert slope[12] == pytest.approx(here[13], abs=1e-4)


@given(states, states, st.floats(0.5, 8.0), st.floats(0.05, 0.95))
def test_a_polynomial_meets_both_ends_and_is_flat(start, goal, duration, part):
    plan = Polynomial7th(start, goal, duration)
    np.testing.assert_allclose(plan.sample(0.0).flat, start.flat, atol=1e-12)
    at_end = (
        Piecewise(plan.coefficients, plan.durations).sample(plan.duration).flat
    )  # from the coefficients
    np.testing.assert_allclose(at_end[0:12], goal.flat[0:12], atol=1e-8)
    assert math.cos(at_end[12] - goal.yaw) == pytest.approx(1.0)
    assert at_end[13] == pytest.approx(goal.flat[13], abs=1e-8)
    np.testing.assert_array_equal(plan.sample(duration).flat[0:12], goal.flat[0:12])
    assert abs(at_end[12] - start.yaw) <= math.pi + 1e-9
    assert_flat(plan, [part * duration], rtol=1e-4)


def test_jumps_are_those_of_the_derivatives_at_the_knots():
    rng = np.random.default_rng(3)
    durations = np.array([0.7, 1.3, 0.4])
    flight = Piecewise(rng.normal(size=(3, 4, 8)), durations)
    polynomials = [
        [np.polynomial.Polynomial(c) for c in piece] for piece in flight.coefficients
    ]
    for axis in range(4):
        for m in range(8):
            ends = [
                abs(
                    polynomials[i][axis].deriv(m)(durations[i])
                    - polynomials[i + 1][axis].deriv(m)(0.0)
                )
                if m
                else abs(
                    polynomials[i][axis](durations[i]) - polynomials[i + 1][axis](0.0)
                )
                for i in range(2)
            ]
            assert flight.jumps[axis, m] == pytest.approx(max(ends), rel=1e-9)


@pytest.mark.parametrize(("degree", "order"), [(3, 2), (5, 4), (7, 6)])
def test_a_spline_goes_through_its_places_and_has_the_ends_that_it_was_given(
    degree, order
):
    honoured = {3: (3, 6), 5: (3, 9), 7: (3, 12)}[degree]
    start = FullState.at(
        (9, 9, 9),
        (0.3, -0.1, 0.2),
        (0.2, 0.1, 0) if degree > 3 else (0, 0, 0),
        yaw_rate=0.4,
    )
    goal = FullState.at(
        (9, 9, 9),
        (-0.5, 0.1, 0),
        (0, 0.3, 0) if degree > 3 else (0, 0, 0),
        (0.5, 0, 0) if degree > 5 else (0, 0, 0),
    )
    flight = fit_spline(TIMES, WAYPOINTS, [0, 1, 2, 3, -3], start, goal, degree)
    for t, place in zip(TIMES, WAYPOINTS, strict=True):
        np.testing.assert_allclose(flight.sample(t).p, place, atol=1e-12)
    span = slice(*honoured)
    np.testing.assert_allclose(
        flight.sample(0.0).flat[span], start.flat[span], atol=1e-10
    )
    np.testing.assert_allclose(
        flight.sample(flight.duration).flat[span], goal.flat[span], atol=1e-9
    )
    assert flight.jumps[0:3, : order + 1].max() < 1e-9
    assert flight.jumps[0:3, order + 1].max() > 1e-3
    assert flight.jumps[3, 0:3].max() < 1e-9
    assert flight.sample(0.0).flat[13] == pytest.approx(0.4)
    yaws = [flight.sample(t).yaw for t in TIMES]
    np.testing.assert_allclose(yaws, [0, 1, 2, 3, 2 * math.pi - 3], atol=1e-12)
    assert_flat(flight, [0.4, 1.7, 3.0, 5.0])


def snap_by_quadratic_program(times, places, start, goal):
    """Coefficients (k - 1, 3, 8) of the least snap: the equality-constrained problem, solved by its KKT system."""
    durations, k = np.diff(times), len(times) - 1

    def row(t, m):
        return np.array(
            [
                math.factorial(n) / math.factorial(n - m) * t ** (n - m)
                if n >= m
                else 0.0
                for n in range(8)
            ]
        )

    cost = np.zeros((8 * k, 8 * k))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    for i, duration in enumerate(durations):
        for x, w in zip(nodes, weights, strict=True):
            r = row(0.5 * duration * (x + 1.0), 4)
            cost[8 * i : 8 * i + 8, 8 * i : 8 * i + 8] += (
                0.5 * duration * w * np.outer(r, r)
            )
    rows, values = [], []

    def constrain(parts, value):
        full = np.zeros(8 * k)
        for i, r in parts:
            full[8 * i : 8 * i + 8] += r
        rows.append(full)
        values.append(value)

    for i, duration in enumerate(durations):
        constrain([(i, row(0.0, 0))], places[i])
        constrain([(i, row(duration, 0))], places[i + 1])
    for m in (1, 2, 3):
        constrain([(0, row(0.0, m))], start.flat[3 * m : 3 * m + 3])
        constrain([(k - 1, row(durations[-1], m))], goal.flat[3 * m : 3 * m + 3])
        for i in range(k - 1):
            constrain([(i, row(durations[i], m)), (i + 1, -row(0.0, m))], np.zeros(3))
    a, b = np.array(rows), np.array(values)
    n = len(a)
    system = np.block([[cost, a.T], [a, np.zeros((n, n))]])
    solution = np.linalg.solve(system, np.vstack([np.zeros((8 * k, 3)), b]))
    return solution[: 8 * k].reshape(k, 8, 3).transpose(0, 2, 1)


def test_minimum_snap_is_the_minimum_of_its_quadratic_program():
    start = FullState.at((0, 0, 0), (0.3, 0, 0), (0.1, 0.2, 0), (0, 0.3, 0))
    goal = FullState.at((0, 0, 0), (0, -0.2, 0))
    flight = minimum_snap(WAYPOINTS, TIMES, start=start, goal=goal)
    wanted = snap_by_quadratic_program(TIMES, WAYPOINTS, start, goal)
    np.testing.assert_allclose(
        flight.coefficients[:, 0:3], wanted, rtol=1e-6, atol=1e-6
    )
    assert flight.jumps[0:3, 0:7].max() < 1e-8


def test_the_snap_is_its_integral():
    flight = minimum_snap(WAYPOINTS, TIMES)
    total = 0.0
    for c, duration in zip(flight.coefficients, flight.durations, strict=True):
        t = (np.arange(20000) + 0.5) / 20000 * duration
        total += (
            sum(
                np.sum(np.polynomial.Polynomial(row).deriv(4)(t) ** 2) for row in c[0:3]
            )
            * duration
            / 20000
        )
    assert compute_snap(flight) == pytest.approx(total, rel=1e-4)


def test_allocated_times_have_less_snap_than_any_near_them():
    times = allocate_times(WAYPOINTS)
    least = compute_snap(fit_spline(times, WAYPOINTS, degree=7))
    for i in range(1, len(times) - 1):
        for step in (-0.05, 0.05):
            other = times.copy()
            other[i] += step
            assert compute_snap(fit_spline(other, WAYPOINTS, degree=7)) > least


@pytest.mark.parametrize(
    "figure",
    [
        circle((0.5, 1, 1), 0.5, 4.0, laps=2, yaw="along"),
        circle((0, 0, 1), 0.8, 3.0, laps=1.25, ramp=1.0, yaw=0.3, yaw_rate=0.5),
        eight((0, 0, 1), (1.0, 0.5), 8.0, laps=2, yaw="along"),
        eight((0, 0, 1), (0.7, 0.6), 5.0, laps=0.5, ramp=2.5),
    ],
)
def test_a_figure_is_flat_and_smooth_from_rest_to_rest(figure):
    assert_flat(figure, np.linspace(0.01, figure.duration - 0.01, 60))
    _, x = sample_setpoints(figure, 2000.0)
    assert (
        np.abs(np.diff(x[:, 9:12], axis=0)).max() < 0.02 * np.abs(x[:, 9:12]).max()
    )  # no jump of the jerk
    np.testing.assert_allclose(x[[0, -1], 3:12], 0.0, atol=1e-9)


def test_the_speeds_of_circle_and_eight():
    w = 2.0 * math.pi / 4.0
    assert compute_peaks(circle((0, 0, 1), 0.5, 4.0, laps=2))["speed"] == pytest.approx(
        0.5 * w, rel=1e-4
    )
    assert compute_peaks(eight((0, 0, 1), (1.0, 0.4), 4.0, laps=2))[
        "speed"
    ] == pytest.approx(w * math.hypot(1, 0.8), rel=1e-4)


def test_a_figure_has_its_equation_and_takes_the_time_of_its_laps_and_a_ramp():
    figure = eight((1, 2, 3), (1.0, 0.4), 4.0, laps=2, ramp=1.0)
    assert figure.duration == pytest.approx(9.0)
    for t in (1.0, 3.3, 7.9):
        phi = 2.0 * math.pi / 4.0 * (t - 0.5)
        wanted = (1 + math.sin(phi), 2 + 0.4 * math.sin(2 * phi), 3)
        np.testing.assert_allclose(figure.sample(t).p, wanted, atol=1e-12)
    np.testing.assert_allclose(figure.sample(9.0).p, (1, 2, 3), atol=1e-12)


def test_yaw_along_a_figure_is_the_direction_of_its_velocity_and_never_jumps():
    for figure in (
        circle((0, 0, 1), 0.5, 4.0, laps=2, yaw="along"),
        eight((0, 0, 1), (1, 0.5), 8.0, 2, yaw="along"),
    ):
        _, x = sample_setpoints(figure, 50.0)
        moving = np.linalg.norm(x[:, 3:5], axis=1) > 1e-6
        heading = np.arctan2(x[moving, 4], x[moving, 3])
        np.testing.assert_allclose(np.cos(x[moving, 12] - heading), 1.0, atol=1e-9)
        assert np.abs(np.diff(x[:, 12])).max() < 0.2


@given(states)
def test_flatness_agrees_with_the_attitude_that_turns(state):
    h = 1e-5
    plan = Polynomial7th(state, FullState.at(state.p), 1.0)
    before, here, after = (
        Polynomial7th(state, FullState.at(state.p), 1.0).sample(0.3 + d)
        for d in (-h, 0, h)
    )
    asked = dict(
        zip(
            DEMAND_NAMES,
            compute_demands(plan.sample(0.3).flat[None], 0.03)[0].tolist(),
            strict=True,
        )
    )
    f = here.a + STANDARD_GRAVITY * UPWARD_AXIS
    if np.linalg.norm(f) < 1.0 or abs(f[2]) < 1.0:
        return
    r = rotation_from_flat(f, here.yaw)
    rates = (
        rotation_from_flat(after.a + STANDARD_GRAVITY * UPWARD_AXIS, after.yaw)
        - rotation_from_flat(before.a + STANDARD_GRAVITY * UPWARD_AXIS, before.yaw)
    ) / (2 * h)
    w = r.T @ rates
    scale = max(1.0, float(np.abs(w).max()))
    for name, value in (
        ("roll_rate", w[2, 1]),
        ("pitch_rate", w[0, 2]),
        ("body_yaw_rate", w[1, 0]),
    ):
        assert asked[name] == pytest.approx(abs(value), abs=1e-4 * scale)
    assert asked["thrust"] == pytest.approx(0.03 * np.linalg.norm(f))
    assert math.cos(asked["tilt"]) == pytest.approx(f[2] / np.linalg.norm(f))
    assert asked["speed"] == pytest.approx(np.linalg.norm(here.v))
    assert asked["jerk"] == pytest.approx(np.linalg.norm(here.flat[9:12]))


@given(st.floats(0.3, 4.0), st.floats(0.05, 0.95))
def test_slowed_derivatives_go_with_the_powers_of_the_factor(factor, part):
    flight = minimum_snap(WAYPOINTS, TIMES, yaws=[0, 1, 2, 1, 0])
    pieces, any_other = flight.slowed(factor), SlowedTrajectory(flight, factor)
    t = part * flight.duration * factor
    np.testing.assert_allclose(
        pieces.sample(t).flat, any_other.sample(t).flat, rtol=1e-9, atol=1e-9
    )
    x, y = flight.sample(t / factor).flat, any_other.sample(t).flat
    for n in range(4):
        np.testing.assert_allclose(
            y[3 * n : 3 * n + 3] * factor**n, x[3 * n : 3 * n + 3], atol=1e-9
        )
    assert y[13] * factor == pytest.approx(x[13])


@pytest.mark.parametrize(
    ("limits", "name", "most"),
    [
        (Limits(v_max=0.5), "speed", 0.5),
        (Limits(a_max=0.4), "acceleration", 0.4),
        (Limits(j_max=1.0), "jerk", 1.0),
        (Limits(tilt_max=0.1), "tilt", 0.1),
        (Limits(thrust_max=0.32, mass=0.03), "thrust", 0.32),
        (Limits(yaw_rate_max=0.3), "yaw_rate", 0.3),
        (Limits(rate_max=(0.2, 9.0, 9.0)), "roll_rate", 0.2),
    ],
)
def test_scaling_takes_no_more_time_than_the_limit_needs(limits, name, most):
    flight = minimum_snap(WAYPOINTS, TIMES, yaws=[0, 1, 2, 1, 0])
    assert compute_peaks(flight, limits.mass)[name] > most
    assert (
        0.995 * most
        <= compute_peaks(fit_to_limits(flight, limits), limits.mass)[name]
        <= most
    )
    k = compute_slowdown(flight, limits)
    assert compute_slowdown(flight.slowed(k), limits) == pytest.approx(1.0, abs=2e-3)


def test_joined_flights_follow_each_other():
    a = minimum_snap(WAYPOINTS, TIMES, yaws=[0, 2, 4, 6, 8])
    back = Polynomial7th(
        FullState.at(WAYPOINTS[-1], yaw=8 - 2 * math.pi),
        FullState.at(WAYPOINTS[0]),
        3.0,
    )
    both = join_pieces([a, back])
    assert both.duration == pytest.approx(a.duration + 3.0)
    assert both.jumps[:, 0:2].max() < 1e-9
    np.testing.assert_allclose(
        both.sample(a.duration + 1.0).flat[0:12], back.sample(1.0).flat[0:12], atol=1e-9
    )
    assert both.sample(a.duration + 1.0).yaw == pytest.approx(
        back.sample(1.0).yaw + 2 * math.pi
    )
