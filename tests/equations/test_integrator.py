import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    quaternion,
    rotation,
    rotation_exponential,
)
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.simulation.lightweight.integrator import CFIntegrator, InputLags

U = np.array([1.1 * PAPER_PLATFORM.weight, 2.0, -1.5, 1.0])
START = np.array(
    [0.3, -0.2, 5.0, 0.8, -0.5, 0.3, *rotation_exponential(0.2, -0.3, 0.5)]
)


def body_rate_slope(t, y, inputs):
    u = inputs(t)
    r = rotation(y[6:10] / np.linalg.norm(y[6:10]))
    x, yy, z, w = y[6:10]
    p, q, s = u[1:]
    dq = 0.5 * np.array(
        [
            w * p + yy * s - z * q,
            w * q + z * p - x * s,
            w * s + x * q - yy * p,
            -x * p - yy * q - z * s,
        ]
    )
    drag = r @ np.diag(PAPER_PLATFORM.drag) @ r.T @ y[3:6]
    return [
        *y[3:6],
        *(
            r[:, 2] * u[0] / PAPER_PLATFORM.mass
            - drag / PAPER_PLATFORM.mass
            - [0, 0, STANDARD_GRAVITY]
        ),
        *dq,
    ]


def exact(inputs, start=START, until=1.0, slope=body_rate_slope, breaks=()):
    y, t = np.array(start), 0.0
    for end in (*breaks, until):
        y = solve_ivp(
            slope, (t, end), y, method="DOP853", rtol=1e-13, atol=1e-13, args=(inputs,)
        ).y[:, -1]
        t = end
    return y


def flown(dt, until=1.0, start=START, u=U, **options):
    world = CFIntegrator([0], np.array([start[:3]]), dt=dt, **options)
    world.states[0, :10] = start
    world.command(0, u)
    for _ in range(round(until / dt)):
        world.step()
    return world.states[0]


def test_held_inputs_give_ten_nanometres_after_a_second_at_100_hz():
    assert np.linalg.norm(flown(0.01)[:3] - exact(lambda t: U)[:3]) < 1e-8


def test_the_order_is_four():
    truth = exact(lambda t: U)[:3]
    steps = np.array([0.04, 0.02, 0.01])
    errors = [np.linalg.norm(flown(h)[:3] - truth) for h in steps]
    orders = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert np.all(orders > 3.9)
    assert np.all(orders < 4.1)


def test_the_order_is_four_behind_a_lag():
    def lagged(t):
        return U + (np.array([PAPER_PLATFORM.weight, 0.0, 0.0, 0.0]) - U) * np.exp(
            -t / np.array([0.05, 0.086, 0.086, 0.086])
        )

    truth = exact(lagged)
    steps = np.array([0.04, 0.02, 0.01])
    errors = [
        np.linalg.norm(flown(h, lags=InputLags(rates=0.086, thrust=0.05))[:10] - truth)
        for h in steps
    ]
    orders = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert np.all(orders > 3.8)
    assert errors[-1] < 2e-7


def test_a_delay_is_exact_although_it_is_no_multiple_of_the_step():
    delay = 0.0237
    hover = np.array([PAPER_PLATFORM.weight, 0.0, 0.0, 0.0])
    truth = exact(lambda t: hover if t < delay else U, breaks=(delay - 1e-15,))
    early = exact(
        lambda t: U, start=exact(lambda t: hover, until=delay), until=1.0 - delay
    )
    np.testing.assert_allclose(truth, early, atol=1e-9)
    np.testing.assert_allclose(
        flown(0.01, lags=InputLags(delay=delay))[:10], early, atol=1e-8
    )


def test_euler_rates_are_the_papers_model():
    eta0 = np.array([0.2, -0.3, 0.5])

    def attitude(eta):
        (cf, ct, cp), (sf, s, sp) = np.cos(eta), np.sin(eta)
        about_x = np.array([[1, 0, 0], [0, cf, -sf], [0, sf, cf]])
        about_y = np.array([[ct, 0, s], [0, 1, 0], [-s, 0, ct]])
        about_z = np.array([[cp, -sp, 0], [sp, cp, 0], [0, 0, 1]])
        return about_z @ about_y @ about_x

    def slope(t, y, inputs):
        u, r = inputs(t), attitude(y[6:9])
        drag = r @ np.diag(PAPER_PLATFORM.drag) @ r.T @ y[3:6]
        return [
            *y[3:6],
            *(
                r[:, 2] * u[0] / PAPER_PLATFORM.mass
                - drag / PAPER_PLATFORM.mass
                - [0, 0, STANDARD_GRAVITY]
            ),
            *u[1:],
        ]

    u = np.array([1.1 * PAPER_PLATFORM.weight, 0.8, -0.6, 1.0])
    truth = exact(lambda t: u, start=[*START[:6], *eta0], slope=slope)
    x = flown(
        0.005,
        start=np.array([*START[:6], *quaternion(attitude(eta0))]),
        u=u,
        inputs="euler",
    )
    assert np.linalg.norm(x[:3] - truth[:3]) < 1e-8
    np.testing.assert_allclose(rotation(x[6:10]), attitude(truth[6:9]), atol=1e-8)


def test_the_fall_ends_at_the_speed_where_drag_is_weight():
    world = CFIntegrator([0], np.array([[0.0, 0.0, 2000.0]]))
    world.command(0, [0.0, 0.0, 0.0, 0.0])
    tau = PAPER_PLATFORM.mass / PAPER_PLATFORM.drag[2]
    for _ in range(1000):
        world.step()
    expected = -STANDARD_GRAVITY * tau * (1.0 - math.exp(-10.0 / tau))
    assert world.states[0, 5] == pytest.approx(expected, rel=1e-9)


def test_without_drag_a_tumbling_fall_keeps_its_energy():
    platform = replace(PAPER_PLATFORM, drag=(0.0, 0.0, 0.0))
    world = CFIntegrator([0], np.array([[0.0, 0.0, 20.0]]), platform=platform)
    world.states[0, 3:6] = [1.0, 0.5, 2.0]
    world.command(0, [0.0, 5.0, 3.0, 1.0])
    energy = 0.5 * 5.25 + STANDARD_GRAVITY * 20.0
    for _ in range(100):
        world.step()
    v = world.states[0, 3:6]
    assert 0.5 * v @ v + STANDARD_GRAVITY * world.states[0, 2] == pytest.approx(
        energy, rel=1e-12
    )
    assert np.linalg.norm(world.states[0, 6:10]) == pytest.approx(1.0, abs=1e-15)


def test_each_drone_has_the_figures_of_its_own_platform():
    rows = [PAPER_PLATFORM, replace(PAPER_PLATFORM, mass=0.04, drag=(0.03, 0.02, 0.01))]
    together = CFIntegrator([0, 1], np.array([START[:3], START[:3]]), platform=rows)
    together.states[:, :10] = START
    for i in (0, 1):
        together.command(i, U)
    for _ in range(100):
        together.step()
    for i in (0, 1):
        np.testing.assert_array_equal(together.states[i], flown(0.01, platform=rows[i]))
    assert abs(together.states[0, 2] - together.states[1, 2]) > 0.3
