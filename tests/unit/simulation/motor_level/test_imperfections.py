"""What a typical drone has: uneven motors, moments of speed, a worn battery."""

from dataclasses import replace

import numpy as np
import pytest

from crazychoir.platforms import CRAZYFLIE_21, EVEN_MOTORS, BodyEffects
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.motor_level.imperfections import Imperfections

P = CRAZYFLIE_21


def test_the_defaults_are_a_perfect_drone():
    perfect = BodyEffects((0.0, 0.0), EVEN_MOTORS, (0.0, 0.0, 0.0))
    assert Imperfections().apply(P, 0, 3) == replace(P, effects=perfect)


def test_motors_differ_by_the_imbalance_at_most_and_from_drone_to_drone():
    bodies = [Imperfections(imbalance=0.1).apply(P, 5, i) for i in range(200)]
    factors = np.array([body.effects.motor_factors for body in bodies])
    assert np.abs(factors - 1.0).max() <= 0.15
    np.testing.assert_allclose(factors.mean(axis=1), 1.0)
    spread = 0.1 / np.sqrt(3.0) * np.sqrt(3.0 / 4.0)
    np.testing.assert_allclose(factors.std(axis=0), spread, rtol=0.15)
    assert Imperfections(imbalance=0.1).apply(P, 5, 7) == bodies[7]
    assert Imperfections(imbalance=0.1).apply(P, 6, 7) != bodies[7]


def test_moments_and_damping_are_given_as_angular_accelerations():
    effects = Imperfections(speed_moment=34.0, rate_damping=3.0).apply(P, 0, 0).effects
    assert effects.speed_moment == pytest.approx((34.0 * 16.8e-6, 34.0 * 16.8e-6))
    assert effects.rate_damping == pytest.approx((3.0 * 16.8e-6, 3.0 * 16.8e-6, 0.0))


def test_a_drone_keeps_what_was_identified_and_has_typical_values_for_the_rest():
    known = replace(
        P, effects=BodyEffects(speed_moment=(1e-4, 2e-4), motor_factors=EVEN_MOTORS)
    )
    effects = Imperfections(34.0, 3.0, 0.1).apply(known, 0, 0).effects
    assert effects.speed_moment == (1e-4, 2e-4)
    assert effects.motor_factors == EVEN_MOTORS
    assert effects.rate_damping == pytest.approx((3.0 * 16.8e-6, 3.0 * 16.8e-6, 0.0))


def test_a_worn_battery_sags_and_is_empty_after_two_minutes():
    """Measured on the recorded drone: 0.6 V, and 110 s until 3.0 V, with tolerances of 0.1 V and a quarter."""
    body = replace(P, battery=P.battery.worn)
    world = CrazyflieWorld([0], np.array([[0.0, 0.0, 1.0]]), bodies=[body])
    world.link(0, "fpqr").onboard.arm()
    seconds = 0.0
    while world.vbat(0) > 3.0:
        if round(100.0 * seconds) % 40 == 0:
            thrust = P.weight if seconds > 0.0 else 0.0
            world.command(0, [thrust, 0.0, 0.0, 0.0])
        world.states[0, :6] = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
        world.step()
        seconds = world.time
        if seconds == pytest.approx(3.0):
            assert P.battery.full - world.vbat(0) == pytest.approx(0.6, abs=0.1)
    assert seconds == pytest.approx(110.0, rel=0.25)
