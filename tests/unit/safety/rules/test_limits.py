"""Limits of references: what is within them stays to the bit, what is beyond is cut, no harder than needed."""

import numpy as np
import pytest

from crazychoir.config.tables import FlightTable
from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.numerics.math3d import saturate
from crazychoir.safety.rules.limits import ReferenceLimits
from crazychoir.types import Acceleration, FullState, State

LIMITS = ReferenceLimits(
    FlightTable(speed_limit=1.0, acceleration_limit=2.0), STANDARD_GAINS
)
KP, KV = np.array(STANDARD_GAINS.kp), np.array(STANDARD_GAINS.kv)
HERE = State.at((1.0, -2.0, 1.5), (0.1, 0.0, -0.1))


def pull(reference, state):
    """kp (p_d - p) + kv (v_d - v): what the controller adds to the acceleration of the reference."""
    return KP * (reference.p - state.p) + KV * (reference.v - state.v)


def accelerated(reference, state=HERE):
    """What is left of an acceleration."""
    return LIMITS.acceleration(reference, state)


def test_what_keeps_the_limits_is_not_touched():
    reference = FullState.at(
        [1.1, -2.1, 1.5], [0.2, 0.1, 0.0], [1.0, 1.0, 1.0], [9.0, 0.0, 0.0], 2.0, 3.0
    )
    assert LIMITS.full_state(reference, HERE) is reference
    gentle = accelerated(Acceleration(np.array([1.0, 1.0, 1.0]), 0.7))
    assert gentle.a.tolist() == [1.0, 1.0, 1.0]
    assert gentle.yaw == 0.7


def test_an_acceleration_keeps_its_direction_and_its_yaw():
    cut = accelerated(
        Acceleration(np.array([3.0, 0.0, -4.0]), 0.7), State.at((0.0, 0.0, 1.0))
    )
    assert cut.a == pytest.approx([1.2, 0.0, -1.6])
    assert cut.yaw == 0.7


@pytest.mark.parametrize("seed", range(20))
def test_a_full_state_is_cut_to_the_limits_and_its_heading_is_not(seed):
    draw = np.random.default_rng(seed)
    state = State.at(draw.normal(size=3), 0.5 * draw.normal(size=3))
    reference = FullState(draw.normal(size=14) * 10.0 ** draw.uniform(-2.0, 6.0))
    cut = LIMITS.full_state(reference, state)
    assert np.linalg.norm(pull(cut, state)) <= 2.0 + 1e-9
    assert np.linalg.norm(cut.a) <= 2.0 + 1e-9
    assert np.linalg.norm(KP / KV * (cut.p - state.p)) <= 1.0 + 1e-9
    assert np.linalg.norm(cut.flat[9:12]) <= 16.0 + 1e-9
    assert cut.yaw == reference.yaw
    assert cut.flat[13] == np.clip(reference.flat[13], -4.0, 4.0)


def test_the_speed_asked_for_is_cut_too():
    still = State.at((0.0, 0.0, 1.0), (0.9, 0.0, 0.0))
    cut = LIMITS.full_state(
        FullState.at([0.0, 0.0, 1.0], [3.0, 0.0, 0.0], [1.0, 0.0, 0.0]), still
    )
    assert cut.v == pytest.approx([1.0, 0.0, 0.0])
    assert cut.a == pytest.approx(np.zeros(3)), "at its limit it does not grow"


def test_the_jerk_and_the_yaw_rate_are_cut_to_what_the_attitude_control_outweighs():
    """|j| <= kr a_max, |yaw'| <= kr_yaw (1 rad); the direction stays."""
    cut = LIMITS.full_state(
        FullState.at(HERE.p, HERE.v, j=[300.0, 0.0, -400.0], yaw_rate=-99.0), HERE
    )
    assert cut.flat[9:12] == pytest.approx([9.6, 0.0, -12.8])
    assert cut.flat[13] == -4.0
    assert (
        LIMITS.full_state(FullState.at(HERE.p, HERE.v, yaw_rate=4.1), HERE).flat[13]
        == 4.0
    )


@pytest.mark.parametrize(
    "bad",
    [np.zeros(2), np.array([np.nan, 0.0, 0.0]), [0.0, np.inf, 0.0], np.zeros((1, 3))],
)
def test_an_acceleration_that_is_none_is_not_flown(bad):
    assert accelerated(Acceleration(bad)) is None


@pytest.mark.parametrize("yaw", [np.nan, np.inf])
@pytest.mark.parametrize("a", [np.zeros(3), np.array([9.0, 0.0, 0.0])])
def test_an_acceleration_without_a_finite_heading_is_not_flown(a, yaw):
    assert accelerated(Acceleration(a, yaw)) is None


def test_an_acceleration_that_is_cut_has_no_jerk_left():
    cut = LIMITS.full_state(
        FullState.at(HERE.p, HERE.v, [4.0, 0.0, 0.0], [5.0, 0.0, 0.0]), HERE
    )
    assert cut.flat[6:12] == pytest.approx([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_at_the_speed_limit_a_far_place_pulls_no_more():
    """The steady flight to a place far away: kp e = kv v."""
    cruising = State.at((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    assert pull(
        LIMITS.full_state(FullState.at([0.0, 50.0, 1.0]), cruising), cruising
    ) == pytest.approx(np.zeros(3))


@pytest.mark.parametrize("far", [1e6, 1e150, 1e308])
def test_a_place_at_the_end_of_the_numbers_stays_a_number(far):
    cut = LIMITS.full_state(
        FullState.at([far, -far, far], [far, 0.0, 0.0], [0.0, far, 0.0]), HERE
    )
    assert np.isfinite(cut.flat).all()
    assert np.linalg.norm(pull(cut, HERE)) <= 2.0 + 1e-9


@pytest.mark.parametrize(
    "v", [(1.0, 0.0, 0.0), (0.0, -0.9, 0.0), (1.2, 0.9, -0.3), (-4.0, 0.0, 3.0)]
)
@pytest.mark.parametrize("a", [(2.0, 0.0, 0.0), (0.5, -1.5, 0.4), (0.0, 0.0, 9.0)])
def test_an_acceleration_leads_to_the_speed_limit_and_not_beyond(v, a):
    """a . v / |v| <= kv (v_max - |v|), |a| <= a_max; what is across the velocity is left."""
    state, speed = State.at((0.0, 0.0, 1.0), v), np.linalg.norm(v)
    cut, wanted = (
        accelerated(Acceleration(np.array(a)), state).a,
        saturate(np.array(a), 2.0),
    )
    along = min(wanted @ v / speed, min(STANDARD_GAINS.kv) * (1.0 - speed))
    expected = wanted + (along - wanted @ v / speed) * np.array(v) / speed
    np.testing.assert_allclose(cut, saturate(expected, 2.0), atol=1e-12)


def test_an_acceleration_at_the_end_of_the_numbers_stays_one():
    for v in ((0.0, 0.0, 0.0), (1.0, 0.5, 0.0)):
        cut = accelerated(
            Acceleration(np.array([1e308, -1e308, 0.0])), State.at((0.0, 0.0, 1.0), v)
        ).a
        assert np.linalg.norm(cut) <= 2.0


def test_an_acceleration_that_brakes_or_turns_is_left_at_any_speed():
    fast = State.at((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    for a in ([0.0, -2.0, 0.0], [1.2, 0.0, -1.6]):
        np.testing.assert_array_equal(accelerated(Acceleration(np.array(a)), fast).a, a)
