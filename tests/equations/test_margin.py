import math

import numpy as np
import pytest
from scipy.signal import tf2ss

from crazychoir.control import margin
from crazychoir.control.gains import HOLD_DELAY, SHIPPED_GAINS, STANDARD_GAINS
from crazychoir.control.margin import (
    REQUIRED_DELAY_MARGIN,
    InnerLoop,
    find_delay_margin,
    make_command_loop,
    make_guidance_loop,
)
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.platforms import PLATFORM_BY_NAME, rotor_speed


def closed_loop_with_delay(loop, delay, until=60.0):
    """Largest |y| in the last tenth of a run of the closed loop, delay by a line of samples, Euler steps of 0.2 ms."""
    a, b, c, _ = tf2ss(*loop)
    h = 0.0004
    x, late = np.zeros(len(a)), np.zeros(max(round(delay / h), 1))
    x[0] = 1e-3
    peak, steps = 0.0, round(until / h)
    for k in range(steps):
        y = (c @ x)[0]
        u, late[k % len(late)] = -late[k % len(late)], y
        x = x + h * (a @ x + b[:, 0] * u)
        if k > 0.9 * steps:
            peak = max(peak, abs(y))
    return peak


def test_delay_margin_of_an_integrator_is_known():
    assert find_delay_margin((np.array([4.0]), np.array([1.0, 0.0]))) == pytest.approx(
        math.pi / 8.0
    )


def test_an_unstable_loop_has_no_margin():
    assert find_delay_margin((np.array([1.0]), np.array([1.0, 0.0, 0.0, 0.0]))) == 0.0


def test_a_loop_of_gain_below_one_bears_any_delay():
    assert find_delay_margin((np.array([0.5]), np.array([1.0, 1.0]))) == math.inf


@pytest.mark.parametrize("kr", [8.0, 16.0])
def test_the_margin_is_where_a_run_in_time_loses_stability(kr):
    loop = make_command_loop(6.0, 4.0, InnerLoop(kr))
    limit = find_delay_margin(loop)
    assert closed_loop_with_delay(loop, 0.93 * limit, 12.0) < closed_loop_with_delay(
        loop, 0.93 * limit, 6.0
    )
    assert closed_loop_with_delay(loop, 1.07 * limit, 12.0) > closed_loop_with_delay(
        loop, 1.07 * limit, 6.0
    )


@pytest.mark.parametrize("name", SHIPPED_GAINS)
@pytest.mark.parametrize("axis", [0, 1])
def test_every_shipped_row_keeps_40_ms_horizontally(name, axis):
    gains = SHIPPED_GAINS[name]
    inner = InnerLoop(gains.kr[axis])
    for opened in (make_command_loop, make_guidance_loop):
        assert (
            find_delay_margin(opened(gains.kp[axis], gains.kv[axis], inner))
            - HOLD_DELAY
            >= REQUIRED_DELAY_MARGIN
        )


@pytest.mark.parametrize("name", SHIPPED_GAINS)
def test_every_shipped_row_keeps_40_ms_in_height_and_heading(name):
    gains = SHIPPED_GAINS[name]
    assert (
        find_delay_margin(margin.make_vertical_loop(gains.kp[2], gains.kv[2]))
        - HOLD_DELAY
        >= REQUIRED_DELAY_MARGIN
    )
    assert (
        find_delay_margin(
            margin.make_heading_loop(
                gains.kr[2], margin.make_lag_loop(margin.SLOWEST_RATE_LAG)
            )
        )
        - HOLD_DELAY
        >= REQUIRED_DELAY_MARGIN
    )


@pytest.mark.parametrize(
    ("kr", "enough"), [(8.0, True), (10.0, True), (12.0, True), (16.0, False)]
)
def test_the_attitude_gain_is_what_the_margin_depends_on(kr, enough):
    left = (
        find_delay_margin(
            make_command_loop(STANDARD_GAINS.kp[0], STANDARD_GAINS.kv[0], InnerLoop(kr))
        )
        - HOLD_DELAY
    )
    assert (left >= REQUIRED_DELAY_MARGIN) == enough


def test_the_margins_are_those_behind_the_filter_that_flies():
    assert (
        VelocityFilter().cutoff
        == InnerLoop(8.0).cutoff
        == margin.make_vertical_loop.__defaults__[1]
    )


def test_less_lag_leaves_more_margin():
    lags = [0.050, 0.086, 0.110, 0.145]
    left = [
        find_delay_margin(make_command_loop(6.0, 4.0, InnerLoop(8.0, lag)))
        for lag in lags
    ]
    assert left == sorted(left, reverse=True)


def test_without_lead_and_filter_the_loops_are_those_of_their_docstrings():
    s = 1j * np.array([0.5, 3.0, 20.0])
    outer = (4.0 * s + 6.0) / s**2
    num, den = make_command_loop(6.0, 4.0, InnerLoop(8.0, 0.086, math.inf))
    np.testing.assert_allclose(
        np.polyval(num, s) / np.polyval(den, s),
        8.0 * (1 + outer) / (s * (0.086 * s + 1)),
    )
    num, den = make_guidance_loop(6.0, 4.0, InnerLoop(8.0, 0.086, math.inf))
    np.testing.assert_allclose(
        np.polyval(num, s) / np.polyval(den, s), outer * 8.0 / (0.086 * s**2 + s + 8.0)
    )


def test_with_lead_and_filter_the_loops_are_those_of_their_docstrings():
    s = 1j * np.array([0.5, 3.0, 20.0])
    low, lead = 50.0 / (s + 50.0), 2.0 + 0.4 * s * 30.0 / (s + 30.0)
    outer = (4.0 * s * low + 6.0) / s**2
    inner = InnerLoop(2.0, 0.086, 50.0, 0.4, 30.0)
    num, den = make_command_loop(6.0, 4.0, inner)
    np.testing.assert_allclose(
        np.polyval(num, s) / np.polyval(den, s),
        (2.0 + lead * outer) / (s * (0.086 * s + 1)),
    )
    num, den = make_guidance_loop(6.0, 4.0, inner)
    np.testing.assert_allclose(
        np.polyval(num, s) / np.polyval(den, s), lead * outer / (0.086 * s**2 + s + 2.0)
    )


@pytest.mark.parametrize("plant", margin.STANDARD_GAIN_MARGINS)
@pytest.mark.parametrize("name", PLATFORM_BY_NAME)
def test_the_standard_gains_keep_the_margin_that_the_table_says_on_every_platform(
    plant, name
):
    left = margin.compute_delay_margin(STANDARD_GAINS, PLATFORM_BY_NAME[name], plant)
    assert left == pytest.approx(margin.STANDARD_GAIN_MARGINS[plant][name], abs=0.0006)
    assert left >= REQUIRED_DELAY_MARGIN


def test_the_rate_loop_is_the_firmwares_controller_around_rotors_and_body():
    platform, s = PLATFORM_BY_NAME["cf21"], 1j * np.array([0.5, 3.0, 20.0])
    for axis, (kp, ki, kd), arm in (
        (0, (250.0, 500.0, 2.5), 0.5 * platform.arm),
        (2, (120.0, 16.7, 0.0), None),
    ):
        if arm is None:
            h, b, c = 1e-9, *platform.rotor.torque
            f = platform.weight / 4.0
            speeds = np.array(
                [rotor_speed(platform.rotor, f - h), rotor_speed(platform.rotor, f + h)]
            )
            arm = np.diff(b * speeds + c * speeds**2)[0] / (2.0 * h)
        torque = (
            4.0 * arm * 0.12 / 65535.0 / (platform.rotor.lag * s + 1.0)
        )  # N m of one unit of command
        turn = (
            torque / platform.inertia[axis] / s * math.degrees(1.0)
        )  # deg/s of one unit, per s
        num, den = margin.make_rate_loop(platform, axis)
        expected = turn * (kp + ki / s) / (1.0 + turn * (kp + ki / s + kd * s))
        np.testing.assert_allclose(
            np.polyval(num, s) / np.polyval(den, s), expected, rtol=1e-6
        )


def test_an_integral_is_in_the_loop_and_too_much_of_it_unstable():
    s = 1j * np.array([0.5, 3.0, 20.0])
    num, den = make_command_loop(6.0, 4.0, InnerLoop(8.0, 0.086, math.inf), 3.0)
    outer = (4.0 * s + 6.0 + 3.0 / s) / s**2
    np.testing.assert_allclose(
        np.polyval(num, s) / np.polyval(den, s),
        8.0 * (1 + outer) / (s * (0.086 * s + 1)),
    )
    assert find_delay_margin(make_command_loop(6.0, 4.0, InnerLoop(8.0), 30.0)) == 0.0
    assert find_delay_margin(make_command_loop(6.0, 4.0, InnerLoop(8.0), 3.0)) > 0.0
