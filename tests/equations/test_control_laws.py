"""The equations of what control/ adds to flatness: delays, trim, angles, velocities, waypoints, rates."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crazychoir.control.attitude import FIRMWARE_ATTITUDE_GAIN, AngleAttitudeCtrl
from crazychoir.control.controller import HierarchicalController
from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.control.handlers import FullStateTraj
from crazychoir.control.position import FlatnessAccelerationCtrl, FlatnessPositionCtrl
from crazychoir.control.senders import FPQRSender
from crazychoir.control.trim import TRIM_LIMITS, Trim
from crazychoir.control.velocity import VelocityCtrlStrategy
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    quaternion,
    quaternion_of_yaw,
    rotation,
    rotation_exponential,
    rotation_from_flat,
)
from crazychoir.planning.figure import eight
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import FullState, State

DRAGLESS = replace(PAPER_PLATFORM, drag=(0.0, 0.0, 0.0))
small = arrays(float, 3, elements=st.floats(-0.4, 0.4))
headings = st.floats(-3.1, 3.1)
FIGURE = eight((0.0, 0.0, 1.0), (1.0, 0.5), 6.0, 3.0)
H = 0.01


def on_path(t):
    """The state that the reference at t describes, without drag."""
    ref = FIGURE.sample(t)
    f = np.array([*ref.a[:2], ref.a[2] + STANDARD_GRAVITY])
    q = quaternion(rotation_from_flat(f, ref.yaw))
    return State(np.array([*ref.p, *ref.v, *q, 0.0, 0.0, 0.0])), ref


def fed_forward(gains, times):
    law = FlatnessPositionCtrl(gains, DRAGLESS)
    return [
        law.desired(*(lambda s, r: (s, r.flat))(*on_path(t)), t).copy() for t in times
    ]


def test_late_rates_are_asked_for_earlier_by_their_derivative():
    times, late = 4.0 + H * np.arange(5), 0.06
    plain = np.array(fed_forward(replace(STANDARD_GAINS, rate_delay=0.0), times))[
        :, 10:13
    ]
    early = np.array(fed_forward(replace(STANDARD_GAINS, rate_delay=late), times))[
        :, 10:13
    ]
    np.testing.assert_allclose(
        early[1:], plain[1:] + late * np.diff(plain, axis=0) / H, atol=1e-9
    )
    np.testing.assert_array_equal(
        early[0], plain[0], "nothing is known of the change yet"
    )
    [ahead] = np.array(
        fed_forward(replace(STANDARD_GAINS, rate_delay=0.0), [times[-1] + late])
    )[:, 10:13]
    assert np.linalg.norm(early[-1] - ahead) < 0.2 * np.linalg.norm(plain[-1] - ahead)


def test_a_late_thrust_is_asked_for_earlier_by_the_jerk():
    late, t = 0.1, 4.3
    [plain] = fed_forward(replace(STANDARD_GAINS, thrust_delay=0.0), [t])
    [early] = fed_forward(replace(STANDARD_GAINS, thrust_delay=late), [t])
    state, ref = on_path(t)
    jerk = ref.flat[9:12] @ rotation(state.q)[:, 2]
    assert early[0] - plain[0] == pytest.approx(
        late * PAPER_PLATFORM.mass * jerk, rel=1e-9
    )
    assert jerk != 0.0


def test_the_drag_of_a_changing_velocity_is_fed_forward_too():
    """F'/m = j_d + (1/m) R A R^T a_d."""
    late, platform = 0.1, replace(PAPER_PLATFORM, drag=(0.02, 0.03, 0.05))
    state, ref = on_path(4.3)
    r = rotation(state.q)
    rise = (
        platform.mass * ref.flat[9:12] + r @ np.diag(platform.drag) @ r.T @ ref.a
    ) @ r[:, 2]
    laws = [
        FlatnessPositionCtrl(replace(STANDARD_GAINS, thrust_delay=t), platform)
        for t in (0.0, late)
    ]
    plain, early = [law.desired(state, ref.flat, 0.0)[0] for law in laws]
    assert early - plain == pytest.approx(late * rise, rel=1e-9)
    assert abs(rise - platform.mass * ref.flat[9:12] @ r[:, 2]) > 1e-4


def test_a_reference_that_jumps_does_not_shake_the_drone():
    law = FlatnessPositionCtrl(replace(STANDARD_GAINS, rate_delay=0.1), DRAGLESS)
    state = State.at((0.0, 0.0, 1.0))
    law.desired(state, FullState.at((0, 0, 1)).flat, 0.0)
    jumped = law.desired(state, FullState.at((0, 0, 1), j=(0.0, 50.0, 0.0)).flat, H)
    plain = 50.0 / STANDARD_GRAVITY
    assert abs(jumped[10] + plain) <= 1.0 + 1e-9


@given(small, headings, st.floats(-0.2, 0.2))
def test_trim_learns_what_its_equations_say(error, heading, tilt):
    trim = Trim()
    trim.frozen = False
    error = 0.25 * error
    q = np.array(rotation_exponential(tilt, -0.5 * tilt, 0.0))
    x = np.array(
        [0, 0, 1, 0, 0, 0, *_turned(quaternion_of_yaw(heading), q), 0, 0, 0],
        dtype=float,
    )
    ref = FullState.at(x[0:3] + error)
    trim.learn(x, ref.flat, np.array([4.0, 3.0]), H)
    forward = rotation(x[6:10])[:, 0]
    c, s = forward[:2] / np.hypot(*forward[:2])
    assert trim.flat[0] == pytest.approx(
        H * 4.0 * error[2] / STANDARD_GRAVITY, abs=1e-12
    )
    ahead, left = c * error[0] + s * error[1], c * error[1] - s * error[0]
    assert trim.flat[1:] == pytest.approx([H * 3.0 * ahead, H * 3.0 * left])


def _turned(a, b):
    return quaternion(rotation(a) @ rotation(b))


def test_trim_is_bounded_and_learns_nothing_frozen_or_from_large_or_fast_errors():
    trim, rates, x = Trim(), np.array([1e6, 1e6]), State.at((0.0, 0.0, 1.0)).flat
    near = FullState.at((0.05, -0.05, 1.05))
    trim.learn(x, near.flat, rates, H)
    np.testing.assert_array_equal(trim.flat, 0.0, "it is frozen at first")
    trim.frozen = False
    for other in (
        FullState.at((0.2, 0, 1)),
        FullState.at((0, 0, 1.5)),
        FullState.at((0, 0, 1.05), (0, 0.2, 0)),
    ):
        trim.learn(x, other.flat, rates, H)
    np.testing.assert_array_equal(trim.flat, 0.0)
    trim.learn(x, near.flat, rates, H)
    np.testing.assert_array_equal(
        trim.flat,
        [
            TRIM_LIMITS.largest_thrust_error,
            TRIM_LIMITS.largest_attitude_error,
            -TRIM_LIMITS.largest_attitude_error,
        ],
    )
    np.testing.assert_array_equal(trim.sure, trim.flat)


def test_what_may_be_noise_is_not_sure_and_an_acceleration_law_flies_what_is():
    trim, here = Trim(), State.at((0.0, 0.0, 1.0))
    trim.frozen = False
    law = FlatnessAccelerationCtrl(platform=DRAGLESS, trim=trim)
    still = np.zeros(14)
    trim.learn(here.flat, FullState.at((0.01, 0, 1.001)).flat, np.array([4.0, 4.0]), H)
    assert 0.0 < trim.flat[1] < TRIM_LIMITS.noise_level
    np.testing.assert_array_equal(law.desired(here, still, 0.0)[7:10], [0.0, 0.0, 1.0])
    for _ in range(30):
        trim.learn(
            here.flat, FullState.at((0.01, 0, 1.001)).flat, np.array([4.0, 4.0]), H
        )
    out = law.desired(here, still, H)
    assert out[7] / out[9] == pytest.approx(trim.flat[1] / STANDARD_GRAVITY)
    assert out[0] == pytest.approx(
        (1.0 + trim.sure[0]) * PAPER_PLATFORM.mass * STANDARD_GRAVITY
    )


@given(headings)
def test_what_is_learnt_acts_on_thrust_and_on_the_force_in_heading_axes(heading):
    trim = Trim()
    trim.flat[:] = 0.1, 0.3, -0.2
    law = FlatnessPositionCtrl(STANDARD_GAINS, DRAGLESS, trim)
    here = State(
        np.array([0, 0, 1, 0, 0, 0, *quaternion_of_yaw(heading), 0, 0, 0], dtype=float)
    )
    out = law.desired(here, FullState.at((0, 0, 1), yaw=heading).flat, 0.0)
    c, s = np.cos(heading), np.sin(heading)
    f = np.array([c * 0.3 + s * 0.2, s * 0.3 - c * 0.2, STANDARD_GRAVITY])
    np.testing.assert_allclose(out[7:10], f / np.linalg.norm(f), atol=1e-9)
    assert out[0] == pytest.approx(
        1.1 * PAPER_PLATFORM.mass * STANDARD_GRAVITY, rel=1e-9
    )


@given(small, small, headings, small)
def test_angles_lead_to_the_attitude_that_is_desired(turn, target, heading, rate):
    r = rotation(quaternion_of_yaw(heading)) @ rotation(
        np.array(rotation_exponential(*turn))
    )
    rd = rotation(quaternion_of_yaw(heading)) @ rotation(
        np.array(rotation_exponential(*target))
    )
    here = State(np.array([0, 0, 1, 0, 0, 0, *quaternion(r), 0, 0, 0], dtype=float))
    desired = np.array([0.3, *rd[:, 0], *rd[:, 1], *rd[:, 2], 0.0, 0.0, rate[2]])
    thrust, roll, pitch, yaw_rate = AngleAttitudeCtrl().command(here, desired)
    own = np.arctan2(r[1, 0], r[0, 0])
    cz, sz, cp, sp, cr, sr = (
        f(a) for a in (own, pitch, roll) for f in (np.cos, np.sin)
    )
    up = np.array([cz * sp * cr + sz * sr, sz * sp * cr - cz * sr, cp * cr])
    np.testing.assert_allclose(up, rd[:, 2], atol=1e-9)
    missing = np.arctan2(rd[1, 0], rd[0, 0]) - own
    assert yaw_rate == pytest.approx(
        rate[2] + STANDARD_GAINS.kr[2] * np.arctan2(np.sin(missing), np.cos(missing)),
        abs=1e-9,
    )
    assert thrust == 0.3


def test_angles_are_early_by_what_the_attitude_control_on_board_lags():
    level = np.array([0.3, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0.6, -0.9, 0.0])
    _, roll, pitch, _ = AngleAttitudeCtrl().command(State.at((0, 0, 1)), level)
    assert (roll, pitch) == pytest.approx(
        (0.6 / FIRMWARE_ATTITUDE_GAIN, -0.9 / FIRMWARE_ATTITUDE_GAIN)
    )


@given(small, small, headings, st.floats(-3.0, 3.0))
def test_velocities_are_proportional_and_derivative_and_turn_the_short_way(
    p, v, heading, yaw
):
    here = State(np.array([*p, *v, *quaternion_of_yaw(heading), 0, 0, 0], dtype=float))
    ref = FullState.at((0.1, 0.2, 0.3), (0.5, -0.5, 0.1), yaw=yaw, yaw_rate=0.2)
    u = VelocityCtrlStrategy(1.5, 0.1, 2.0, 9.0).velocity(here, ref.flat)
    np.testing.assert_allclose(
        u[:3], ref.v + 1.5 * (ref.p - p) + 0.1 * (ref.v - v), atol=1e-12
    )
    turn = yaw - heading
    assert u[3] == pytest.approx(
        0.2 + 2.0 * np.arctan2(np.sin(turn), np.cos(turn)), abs=1e-9
    )


def test_a_velocity_is_no_longer_than_it_may_be():
    u = VelocityCtrlStrategy(v_max=0.5).velocity(
        State.at((0, 0, 0)), FullState.at((3.0, 4.0, 0.0)).flat
    )
    np.testing.assert_allclose(u[:3], [0.3, 0.4, 0.0])


def test_the_desired_attitude_turns_on_between_two_looks_at_the_position():
    rates = {}
    for rate in (0.0, 25.0):
        law = HierarchicalController(
            FlatnessPositionCtrl(STANDARD_GAINS, DRAGLESS),
            _Recorder(),
            FPQRSender(),
            FullStateTraj(),
            position_rate=rate,
        )
        for k in range(40):
            state, ref = on_path(4.0 + k * H)
            law.command(state, ref, 4.0 + k * H)
        rates[rate] = law.attitude_strategy
    assert rates[25.0].asked == 40
    seen, exact = np.array(rates[25.0].seen), np.array(rates[0.0].seen)
    np.testing.assert_array_equal(
        seen[::4, 1:10], exact[::4, 1:10], "every fourth tick looks"
    )
    gap = np.abs(seen[:, 1:10] - exact[:, 1:10]).max()
    held = np.abs(np.repeat(exact[::4, 1:10], 4, axis=0) - exact[:, 1:10]).max()
    assert 0.0 < gap < 0.1 * held


class _Recorder:
    """An attitude strategy that remembers what was desired."""

    def __init__(self):
        self.asked, self.seen, self.gains = 0, [], STANDARD_GAINS

    def command(self, state, desired):
        self.asked += 1
        self.seen.append(desired.copy())
        return np.zeros(4)
