"""The motion of a drone that is not seen, beside the world that flies it."""

import math

import numpy as np
import pytest

from crazychoir.filters.motion import RATE_LAG, CommandedMotion, coast
from crazychoir.numerics.math3d import (
    quaternion_conjugate,
    quaternion_product,
    rotation,
    rotation_exponential,
    rotation_logarithm,
)
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.simulation.lightweight.integrator import CFIntegrator, InputLags
from crazychoir.types import State

NOWHERE = -math.inf
TILTED = State(
    np.array(
        [
            0.3,
            -0.2,
            2.0,
            0.8,
            -0.5,
            0.3,
            *rotation_exponential(0.3, -0.2, 1.0),
            0.5,
            -1.0,
            0.2,
        ]
    )
)


def beside(start, commands, dt=0.01):
    """The truth after these commands, a tick each, and what Commanded makes of them: two states (13,)."""
    world = CFIntegrator(
        (0,), start.flat[None, 0:3], np.zeros(1), lags=InputLags(rates=RATE_LAG), dt=dt
    )
    world.states[0], world._actual[0] = start.flat, [commands[0][0], *start.w]
    motion, x = CommandedMotion(PAPER_PLATFORM.flat, 0.0), start.flat
    for command in commands:
        world.command(0, command)
        world.step()
        x = motion.after(x, np.asarray(command, dtype=float), dt)
    return world.state(0).flat, x


def test_it_goes_where_the_world_goes():
    commands = [
        (0.27 + 0.05 * math.sin(0.1 * k), math.cos(0.05 * k), -1.0 + 0.01 * k, 0.3)
        for k in range(100)
    ]
    truth, predicted = beside(TILTED, commands)
    np.testing.assert_allclose(predicted[0:6], truth[0:6], rtol=3e-3)
    off = rotation_logarithm(
        quaternion_product(
            quaternion_conjugate(tuple(truth[6:10])), tuple(predicted[6:10])
        )
    )
    assert np.linalg.norm(off) < 2e-3
    np.testing.assert_allclose(predicted[10:13], truth[10:13], atol=1e-9)


def test_it_obeys_the_equations():
    """p' = v,  v' = -g e3 + (u_1 / m) R e3 - (1/m) R A R^T v,  w' = (u_2..4 - w) / RATE_LAG, at one instant."""
    h, u, x = 1e-6, np.array([0.3, 1.0, -2.0, 0.5]), TILTED.flat
    slope = (CommandedMotion(PAPER_PLATFORM.flat, NOWHERE).after(x, u, h) - x) / h
    r = rotation(TILTED.q)
    drag = r @ np.diag(PAPER_PLATFORM.drag) @ r.T @ TILTED.v
    np.testing.assert_allclose(slope[0:3], TILTED.v, atol=1e-4)
    np.testing.assert_allclose(
        slope[3:6],
        (u[0] * r[:, 2] - drag) / PAPER_PLATFORM.mass - [0.0, 0.0, 9.80665],
        atol=1e-4,
    )
    np.testing.assert_allclose(slope[10:13], (u[1:4] - TILTED.w) / RATE_LAG, rtol=1e-4)
    turned = quaternion_product(
        tuple(x[6:10]),
        (0.5 * h * TILTED.w[0], 0.5 * h * TILTED.w[1], 0.5 * h * TILTED.w[2], 1.0),
    )
    np.testing.assert_allclose(slope[6:10], (np.array(turned) - x[6:10]) / h, atol=1e-4)


def test_one_long_prediction_is_many_short_ones():
    motion, u, x = (
        CommandedMotion(PAPER_PLATFORM.flat, NOWHERE),
        np.array([0.25, 0.3, -0.2, 0.1]),
        TILTED.flat,
    )
    for _ in range(50):
        x = motion.after(x, u, 0.01)
    np.testing.assert_allclose(motion.after(TILTED.flat, u, 0.5), x, atol=1e-9)
    np.testing.assert_array_equal(motion.after(TILTED.flat, u, 0.0), TILTED.flat)


def test_on_the_floor_it_stands_until_its_thrust_outweighs_it():
    motion = CommandedMotion(PAPER_PLATFORM.flat, 0.4)
    noisy = State(
        np.array([1.0, 2.0, 0.402, 0.05, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0, 0.1, 0.0, 0.0])
    )
    for thrust in (0.0, 0.99 * PAPER_PLATFORM.weight):
        stands = motion.after(noisy.flat, np.array([thrust, 0.0, 0.0, 0.0]), 2.0)
        np.testing.assert_allclose(stands[0:6], [1.0, 2.0, 0.402, 0.0, 0.0, 0.0])
    rises = motion.after(
        State.at((1.0, 2.0, 0.4)).flat,
        np.array([1.1 * PAPER_PLATFORM.weight, 0.0, 0.0, 0.0]),
        0.5,
    )
    assert rises[2] == pytest.approx(0.4 + 0.5 * 0.98 * 0.5**2, abs=0.01)


def test_what_falls_stops_at_the_floor():
    fallen = CommandedMotion(PAPER_PLATFORM.flat, 0.4).after(
        State.at((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)).flat, np.zeros(4), 2.0
    )
    assert fallen[2] == pytest.approx(0.4)
    np.testing.assert_array_equal(fallen[3:6], 0.0)


def test_a_drone_below_the_floor_neither_jumps_onto_it_nor_falls_deeper():
    low, motion = State.at((0.0, 0.0, 0.35)), CommandedMotion(PAPER_PLATFORM.flat, 0.4)
    for thrust, height in (
        (0.0, 0.35),
        (1.1 * PAPER_PLATFORM.weight, 0.35 + 0.5 * 0.98 * 0.1**2),
    ):
        after = motion.after(low.flat, np.array([thrust, 0.0, 0.0, 0.0]), 0.1)
        assert after[2] == pytest.approx(height, abs=1e-3)


def test_a_drone_that_coasts_keeps_its_velocity_and_body_rates():
    on = TILTED.flat.copy()
    coast(on, 0.5)
    np.testing.assert_allclose(on[0:3], TILTED.p + 0.5 * TILTED.v)
    np.testing.assert_array_equal(on[3:6], TILTED.v)
    np.testing.assert_array_equal(on[10:13], TILTED.w)
    turn = rotation_logarithm(
        quaternion_product(quaternion_conjugate(tuple(TILTED.q)), tuple(on[6:10]))
    )
    np.testing.assert_allclose(turn, 0.5 * TILTED.w)
