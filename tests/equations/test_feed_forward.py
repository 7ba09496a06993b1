"""The rates that are asked for: behind the controls on board a drone turns as was desired."""

from dataclasses import replace

import numpy as np
import pytest

from crazychoir.control.attitude import (
    FIRMWARE_ATTITUDE_GAIN,
    FIRMWARE_ATTITUDE_INTEGRAL,
    AttitudeKind,
)
from crazychoir.control.feed_forward import (
    ANGLE_CORNER,
    FEED_FORWARD_ROW,
    LARGEST_OPPOSED_RATE,
    RateFeedForward,
)
from crazychoir.control.gains import SHIPPED_GAINS, STANDARD_GAINS
from crazychoir.control.margin import (
    REQUIRED_DELAY_MARGIN,
    InnerLoop,
    compute_rate_authority,
    find_delay_margin,
    make_command_loop,
    make_rate_loop,
)
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    rotation,
    rotation_exponential,
)
from crazychoir.platforms import CRAZYFLIE_21, BodyEffects
from crazychoir.types import State

MOMENT = 34.0
"""rad/s2 per m/s."""
SHARES = (0.9, 1.1)
"""Of MOMENT, about x and y."""
INERTIA = CRAZYFLIE_21.inertia
PLATFORM = replace(
    CRAZYFLIE_21,
    drag=(0.0, 0.0, 0.0),
    effects=BodyEffects(
        speed_moment=tuple(
            MOMENT * s * j for s, j in zip(SHARES, INERTIA, strict=False)
        )
    ),
)
LAG = PLATFORM.rotor.lag
H = 0.01
SPEED = 0.8
"""m/s: amplitude of the speed."""


def level(rates=(0.0, 0.0, 0.0)):
    """The desired result of a position control for a level drone."""
    return np.array([0.3, 1, 0, 0, 0, 1, 0, 0, 0, 1, *rates], dtype=float)


def flying(v, turn=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0)):
    return State(np.array([0, 0, 1, *v, *rotation_exponential(*turn), *w], dtype=float))


def make(platform=PLATFORM, ahead=LAG):
    law = RateFeedForward(np.zeros(1, FEED_FORWARD_ROW))
    law.know_moment(platform, ahead)
    return law


def turn_behind_rate_control(rates, moments):
    """Return the rate (n,) of one axis: the firmware's PID at 500 Hz, rotors that lag, and a moment."""
    kp, ki, kd = PLATFORM.firmware.rate_pid
    b = compute_rate_authority(PLATFORM, 1)
    w = before = integral = torque = 0.0
    steps = 5
    h = H / steps
    turned = []
    for wanted, moment in zip(rates, moments, strict=True):
        for _ in range(steps):
            integral += h * (wanted - w)
            u = kp * (wanted - w) + ki * integral - kd * (w - before) / h
            before = w
            torque += (1.0 - np.exp(-h / LAG)) * (b * u - torque)
            w += h * (torque + moment)
        turned.append(w)
    return np.array(turned)


@pytest.mark.parametrize("frequency", [0.7, 1.4, 3.0])
def test_a_drone_turns_as_without_the_moment_of_its_speed(frequency):
    """Forwards and back: behind the rate control on board a tenth of the turns is left."""
    times = H * np.arange(1500)
    speeds = SPEED * np.sin(frequency * times)
    rises = SPEED * frequency * np.cos(frequency * times)
    moments = -MOMENT * SHARES[1] * speeds
    law = make()
    rates = []
    for t, v, a in zip(times, speeds, rises, strict=True):
        pitch = np.arcsin(a / STANDARD_GRAVITY)
        state = flying(
            rotation(np.array(rotation_exponential(0, pitch, 0))) @ [v, 0, 0],
            (0, pitch, 0),
        )
        rates.append(law.lead(AttitudeKind.RATES, state, level(), t)[11])
    settled = times > 5.0
    left = turn_behind_rate_control(rates, moments)[settled]
    alone = turn_behind_rate_control(0.0 * times, moments)[settled]
    assert np.abs(left).max() < 0.1 * np.abs(alone).max()
    assert np.abs(alone).max() > 0.05


def test_the_rates_are_those_of_the_equation():
    """At once after a rest the integrals have found nothing yet."""
    law = make(ahead=0.1)
    turn = (0.2, -0.1, 0.4)
    r = rotation(np.array(rotation_exponential(*turn)))
    w = np.array([0.3, -0.2, 0.5])
    v = np.array([0.4, -0.3, 0.2])
    law.lead(AttitudeKind.RATES, flying((0, 0, 0)), level(), 0.0)
    found = law.lead(AttitudeKind.RATES, flying(v, turn, w), level(), H)[10:13]

    a = r.T @ v
    rise = -STANDARD_GRAVITY * r.T[:, 2] - np.cross(w, a)
    early = a + 0.1 * rise
    kp, ki, _ = PLATFORM.firmware.rate_pid
    k = kp * compute_rate_authority(PLATFORM, 0)
    wanted = MOMENT / k * np.array([-SHARES[0] * early[1], SHARES[1] * early[0], 0.0])
    expected = r @ wanted * np.exp(-ki / kp * H)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_what_lasts_is_left_to_the_integral_on_board():
    law = make()
    law.lead(AttitudeKind.RATES, flying((0, 0, 0)), level(), 0.0)
    found = [
        law.lead(AttitudeKind.RATES, flying((0.5, 0, 0)), level(), H * n)[11]
        for n in range(1, 400)
    ]
    assert found[0] > 0.1
    assert abs(found[-1]) < 1e-3


def test_after_a_gap_the_integral_is_taken_to_know_the_moment():
    law = make()
    state = flying((0.5, 0, 0))
    for t in (0.0, 1.0, 1.2):
        assert law.lead(AttitudeKind.RATES, state, level(), t)[11] == 0.0


def test_the_rates_against_the_moment_are_bounded():
    law = make()
    law.lead(AttitudeKind.RATES, flying((-20, 0, 0)), level(), 0.0)
    found = law.lead(AttitudeKind.RATES, flying((20, 0, 0)), level(), H)
    assert found[11] == LARGEST_OPPOSED_RATE


@pytest.mark.parametrize("effects", [BodyEffects(), BodyEffects(speed_moment=(0, 0))])
def test_without_a_moment_the_rates_are_the_desired_ones(effects):
    law = make(replace(PLATFORM, effects=effects))
    desired = level((0.1, -0.2, 0.3))
    for n in range(20):
        state = flying((0.1 * n, 0.3, 0.1), (0.1, 0.2, 0.3))
        found = law.lead(AttitudeKind.RATES, state, desired, H * n)
        assert found.tobytes() == desired.tobytes()


def turn_behind_attitude_control(angles, rates):
    """Return the errors (n,) of an angle behind the PI control on board, which gets angles + rates / ka."""
    angle = integral = 0.0
    errors = []
    for wanted, rate in zip(angles, rates, strict=True):
        errors.append(angle - wanted)
        asked = wanted + rate / FIRMWARE_ATTITUDE_GAIN
        integral += H * (asked - angle)
        angle += H * (
            FIRMWARE_ATTITUDE_GAIN * (asked - angle)
            + FIRMWARE_ATTITUDE_INTEGRAL * integral
        )
    return np.array(errors)


@pytest.mark.parametrize("frequency", [0.5, 1.4, 2.0])
def test_an_attitude_control_with_an_integral_turns_as_desired(frequency):
    times = H * np.arange(2000)
    angles = 0.3 * np.sin(frequency * times)
    rates = 0.3 * frequency * np.cos(frequency * times)
    law = RateFeedForward(np.zeros(1, FEED_FORWARD_ROW))
    still = flying((0, 0, 0))
    led = [
        law.lead(AttitudeKind.ANGLES, still, level((0, rate, 0)), t)[11]
        for t, rate in zip(times, rates, strict=True)
    ]
    settled = times > 15.0
    left = np.abs(turn_behind_attitude_control(angles, led)[settled]).max()
    alone = np.abs(turn_behind_attitude_control(angles, rates)[settled]).max()
    assert left < 0.1 * alone
    assert alone > 0.01


def test_a_steady_turn_is_left_to_the_integral_of_the_attitude_control():
    law = RateFeedForward(np.zeros(1, FEED_FORWARD_ROW))
    still = flying((0, 0, 0))
    for n in range(1000):
        led = law.lead(AttitudeKind.ANGLES, still, level((0.5, 0, 0.4)), H * n)
    assert abs(led[10]) < np.exp(-ANGLE_CORNER * 9.0)
    assert led[12] == 0.4, "the yaw rate is asked for as a rate"


def make_loop_with_moment(gains, true, known):
    """Return the loop opened at the rate command, of a drone with one moment and controllers for another.

        x'' = g theta,   w = W w_c + W_d d,   d = -m x',   W_d = s (lag s + 1) / (denominator of W)
        w_c = -KR theta - (KR + lead s G) (kv s F + kp + ki / s) theta / s^2 + r

    F and G are those of `make_command_loop`. true and known: m, rad/s2 per m/s
    """
    over, under = make_rate_loop(PLATFORM, 1)
    kp, ki, _ = PLATFORM.firmware.rate_pid
    share = known / (kp * compute_rate_authority(PLATFORM, 1))
    opposed = share * STANDARD_GRAVITY * np.array([0.025 + LAG, 1.0])
    high_pass = np.array([1.0, ki / kp])
    c = gains.lead_cutoff
    lead = np.array([gains.kr[1] + gains.lead * c, gains.kr[1] * c])
    low = np.array([1.0 / InnerLoop(gains.kr[1]).cutoff, 1.0])
    integral = [gains.ki_trim] if gains.ki_trim else []
    outer = np.polyadd(
        np.polymul([gains.kp[1], *integral], low),
        [gains.kv[1], 0.0, *(0.0 for _ in integral)],
    )
    bottom = np.polymul([1.0, 0.0, 0.0, *(0.0 for _ in integral)], low)
    bottom = np.polymul(bottom, [1.0, c])
    tracked = np.polyadd(gains.kr[1] * bottom, np.polymul(lead, outer))
    command = np.polysub(np.polymul(tracked, high_pass), np.polymul(opposed, bottom))
    # theta = W w_c / (s + W_d m g / s)
    turned = np.polyadd(
        np.polymul(under, [1.0, 0.0]), true * STANDARD_GRAVITY * np.array([LAG, 1.0])
    )
    return (
        np.polymul(command, over),
        np.polymul(np.polymul(bottom, high_pass), turned),
    )


def test_the_loop_without_moments_is_the_command_loop():
    s = 1j * np.array([0.5, 3.0, 20.0])
    inner = InnerLoop(STANDARD_GAINS.kr[1], rates=make_rate_loop(PLATFORM, 1))
    plain = make_command_loop(6.0, 4.0, inner, 3.0)
    num, den = make_loop_with_moment(STANDARD_GAINS, 0.0, 0.0)
    np.testing.assert_allclose(
        np.polyval(num, s) / np.polyval(den, s),
        np.polyval(plain[0], s) / np.polyval(plain[1], s),
    )


@pytest.mark.parametrize("name", SHIPPED_GAINS)
@pytest.mark.parametrize("true", [0.0, 0.5 * MOMENT, MOMENT, 2.0 * MOMENT])
def test_a_wrong_moment_leaves_the_delay_margin(name, true):
    loop = make_loop_with_moment(SHIPPED_GAINS[name], true, MOMENT)
    assert find_delay_margin(loop) > REQUIRED_DELAY_MARGIN + 0.03
