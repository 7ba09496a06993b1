"""Euler-angle rates that are sent for body rates turn the drone at these body rates."""

import numpy as np
import pytest

from crazychoir.numerics.math3d import quaternion
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.simulation.common.links import EulerRatesLink
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.types import FPQR

DT = 1e-7


def attitude(phi, theta, psi):
    """R = R_z(psi) R_y(theta) R_x(phi)."""
    (cf, ct, cp), (sf, st, sp) = np.cos([phi, theta, psi]), np.sin([phi, theta, psi])
    about_x = np.array([[1, 0, 0], [0, cf, -sf], [0, sf, cf]])
    about_y = np.array([[ct, 0, st], [0, 1, 0], [-st, 0, ct]])
    about_z = np.array([[cp, -sp, 0], [sp, cp, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def world_at(eta):
    """A world that is steered by Euler-angle rates, with drone 4 at this attitude in the air."""
    world = CFIntegrator([4], np.array([[0.0, 0.0, 5.0]]), dt=DT, inputs="euler")
    world.states[0, 6:10] = quaternion(attitude(*eta))
    return world


@pytest.mark.parametrize("seed", range(20))
def test_the_drone_turns_at_the_body_rates_that_were_commanded(seed):
    draw = np.random.default_rng(seed)
    eta = draw.uniform([-3.0, -1.2, -3.0], [3.0, 1.2, 3.0])
    rates = draw.uniform(-1.0, 1.0, 3)
    world = world_at(eta)
    EulerRatesLink(world, 4).send(FPQR(np.array([PAPER_PLATFORM.weight, *rates])))
    world.step()
    assert world.limited[0] == 0.0
    assert world.state(4).w == pytest.approx(rates, abs=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_what_it_sends_are_the_rates_of_the_angles(seed):
    """d/dt R(eta) = R skew(w), by finite differences of the angles."""
    draw = np.random.default_rng(seed)
    eta = draw.uniform([-3.0, -1.2, -3.0], [3.0, 1.2, 3.0])
    p, q, r = draw.uniform(-1.0, 1.0, 3)
    world, h = world_at(eta), 1e-6
    EulerRatesLink(world, 4).send(FPQR(np.array([PAPER_PLATFORM.weight, p, q, r])))
    eta_rates = world.commands[0, 1:]
    slope = (attitude(*(eta + h * eta_rates)) - attitude(*(eta - h * eta_rates))) / (
        2.0 * h
    )
    turn = attitude(*eta).T @ slope
    assert turn == pytest.approx(
        np.array([[0.0, -r, q], [r, 0.0, -p], [-q, p, 0.0]]), abs=1e-8
    )


def test_nose_down_it_stays_finite_and_the_world_clips_it():
    world = world_at((0.0, 0.0, 0.0))
    world.states[0, 6:10] = [0.5, 0.5, -0.5, 0.5]  # theta = 90 degrees, exactly
    EulerRatesLink(world, 4).send(
        FPQR(np.array([PAPER_PLATFORM.weight, 0.5, 0.5, 0.5]))
    )
    world.step()
    assert np.isfinite(world.states).all()
    assert world.limited[0] == 1.0
