from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crazychoir.control.attitude import GeometryAttitudeCtrl
from crazychoir.control.gains import FORMATION_GAINS, STANDARD_GAINS
from crazychoir.control.position import (
    FLATNESS_LIMITS,
    FlatnessAccelerationCtrl,
    FlatnessPositionCtrl,
)
from crazychoir.control.trim import Trim
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    quaternion,
    rotation,
    rotation_exponential,
    rotation_from_flat,
)
from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import FullState, State

small = arrays(float, 3, elements=st.floats(-0.5, 0.5))
DRAGLESS = replace(PAPER_PLATFORM, drag=(0.0, 0.0, 0.0))


def state(p=(0, 0, 1), v=(0, 0, 0), turn=(0, 0, 0)):
    return State(
        np.array([*p, *v, *rotation_exponential(*turn), 0.0, 0.0, 0.0], dtype=float)
    )


def desired(at, rate=(0.0, 0.0, 0.0)):
    r = rotation(at.q)
    return np.array([0.25, *r[:, 0], *r[:, 1], *r[:, 2], *rate])


@given(small)
def test_the_attitude_error_is_zero_at_the_desired_attitude(turn):
    here = state(turn=turn)
    u = GeometryAttitudeCtrl().command(here, desired(here))
    np.testing.assert_allclose(u, [0.25, 0.0, 0.0, 0.0], atol=1e-12)


@given(small, small)
def test_the_rates_are_lees_error_in_matrices(turn, target):
    r, rd = rotation(state(turn=turn).q), rotation(state(turn=target).q)
    e = 0.5 * (rd.T @ r - r.T @ rd)
    rate = np.array([0.1, -0.2, 0.3])
    expected = (
        -np.array(STANDARD_GAINS.kr) * [e[2, 1], e[0, 2], e[1, 0]] + r.T @ rd @ rate
    )
    u = GeometryAttitudeCtrl().command(
        state(turn=turn), desired(state(turn=target), rate)
    )
    np.testing.assert_allclose(u[1:], expected, atol=1e-9)


@given(arrays(float, 3, elements=st.floats(-1.5, 1.5)))
def test_the_attitude_converges_from_afar(turn):
    q, goal, law = (
        np.array(rotation_exponential(*turn)),
        desired(state()),
        GeometryAttitudeCtrl(),
    )
    for _ in range(400):
        w = law.command(
            State(np.array([0, 0, 1, 0, 0, 0, *q, 0, 0, 0], dtype=float)), goal
        )[1:]
        r = rotation(q) @ rotation(np.array(rotation_exponential(*(0.01 * w))))
        q = quaternion(r)
    np.testing.assert_allclose(rotation(q), np.eye(3), atol=1e-5)


@given(small, small, small, small, st.floats(-3.0, 3.0))
def test_thrust_and_attitude_follow_from_the_force(p, v, a, turn, yaw):
    here = state(p, v, turn)
    ref = FullState.at((0, 0, 0), (0, 0, 0), a, yaw=yaw)
    out = FlatnessPositionCtrl(platform=DRAGLESS).desired(here, ref.flat, 0.0)
    f = (
        a
        - np.array(STANDARD_GAINS.kp) * p
        - np.array(STANDARD_GAINS.kv) * v
        + [0, 0, STANDARD_GRAVITY]
    )
    if 2.5 < f[2] < 15.0 and np.hypot(f[0], f[1]) < f[2] and np.linalg.norm(f) < 16.0:
        np.testing.assert_allclose(
            out[1:10].reshape(3, 3).T, rotation_from_flat(f, yaw), atol=1e-9
        )
        assert out[0] == pytest.approx(
            PAPER_PLATFORM.mass * f @ rotation(here.q)[:, 2], abs=1e-9
        )


@given(small, small, small, arrays(float, 3, elements=st.floats(-20.0, 20.0)))
def test_the_commanded_acceleration_is_the_force_after_its_limits_without_gravity_drag_and_trim(
    p, v, turn, a
):
    here, trim = state(p, v, turn), Trim()
    trim.flat[:] = trim.sure[:] = 0.1, 0.3, -0.2
    r = rotation(here.q)
    bx = r[:2, 0] / np.linalg.norm(r[:2, 0])
    rest = np.array(
        [bx[0] * 0.3 + bx[1] * 0.2, bx[1] * 0.3 - bx[0] * 0.2, STANDARD_GRAVITY]
    )
    rest += r @ np.diag(PAPER_PLATFORM.drag) @ r.T @ v / PAPER_PLATFORM.mass
    law = FlatnessAccelerationCtrl(trim=trim)
    out = law.desired(here, FullState.at((0, 0, 0), a=a).flat, 0.0)
    wish, force = a + rest, law.acceleration + rest
    np.testing.assert_allclose(np.cross(force, out[7:10]), 0.0, atol=1e-9)
    most = (
        FLATNESS_LIMITS.acceleration_share
        * PAPER_PLATFORM.max_thrust
        / PAPER_PLATFORM.mass
    )
    tilt = np.hypot(*wish[:2]) / np.tan(FORMATION_GAINS.max_tilt)
    if (
        FLATNESS_LIMITS.least_lift < wish[2] < FLATNESS_LIMITS.height_share * most
        and tilt < wish[2]
        and np.linalg.norm(wish) < most
    ):
        np.testing.assert_allclose(law.acceleration, a, atol=1e-12)
    else:
        assert np.linalg.norm(law.acceleration - a) > 1e-6, "some of it was cut"
        assert (
            np.hypot(*force[:2]) <= force[2] * np.tan(FORMATION_GAINS.max_tilt) + 1e-9
        )
    assert not law.acceleration.flags.writeable


@given(small, small)
def test_the_drag_of_the_reference_is_given_as_thrust(v, turn):
    r = rotation(state(turn=turn).q)
    out = FlatnessPositionCtrl().desired(
        state(v=v, turn=turn), FullState.at((0, 0, 1), v).flat, 0.0
    )
    f = r @ np.diag(PAPER_PLATFORM.drag) @ r.T @ v / PAPER_PLATFORM.mass + [
        0,
        0,
        STANDARD_GRAVITY,
    ]
    np.testing.assert_allclose(out[7:10], f / np.linalg.norm(f), atol=1e-12)


def test_the_feed_forward_is_the_rate_at_which_the_desired_attitude_turns():
    start = FullState.at((0, 0, 1), (0.5, 0, 0), (0, 1, 0), (1, 1, 1), 0.3, 0.5)
    plan, law, h = (
        PointToPoint(start, np.array([1.0, 1.0, 1.5]), 2.0, 2.0),
        FlatnessPositionCtrl(platform=DRAGLESS),
        1e-6,
    )

    def attitude(t):
        ref = plan.sample(t)
        return law.desired(
            State(np.array([*ref.flat[:6], 0, 0, 0, 1, 0, 0, 0])), ref.flat, 0.0
        ).copy()

    for t in (0.3, 0.9, 1.4):
        r, later = (attitude(s)[1:10].reshape(3, 3).T for s in (t - h, t + h))
        turning = (r.T @ later - later.T @ r) / (4.0 * h)
        np.testing.assert_allclose(
            attitude(t)[10:13], [turning[2, 1], turning[0, 2], turning[1, 0]], atol=1e-5
        )


def test_the_lead_is_its_part_of_the_rate_of_the_desired_attitude():
    law, rate, h = (
        FlatnessAccelerationCtrl(replace(FORMATION_GAINS, lead=0.5)),
        0.2,
        0.01,
    )
    for k in range(60):
        tilt = rate * h * k
        ref = np.zeros(14)
        ref[6:9] = STANDARD_GRAVITY * np.array([np.tan(tilt), 0.0, 0.0])
        out = law.desired(state(), ref, k * h)
    np.testing.assert_allclose(out[10:12], [0.0, 0.5 * rate], atol=1e-4)


def test_however_the_ticks_come_the_lead_that_was_held_is_its_part_of_the_turn():
    law, draw = (
        FlatnessAccelerationCtrl(replace(FORMATION_GAINS, lead=0.5)),
        np.random.default_rng(1),
    )
    held = now = 0.0
    tilts = [0.0, *0.02 * draw.standard_normal(300), *[0.1] * 100]
    for tilt in tilts:
        h = draw.choice([0.0002, 0.005, 0.01, 0.02, 0.035])
        ref = np.zeros(14)
        ref[6:9] = STANDARD_GRAVITY * np.array([np.tan(tilt), 0.0, 0.0])
        rate = law.desired(state(), ref, now)[11]
        held, now = held + rate * h, now + h
    assert held == pytest.approx(0.5 * (tilts[-1] - tilts[0]), abs=0.002)


def test_the_lead_goes_on_while_nothing_new_is_measured():
    law, ref = FlatnessAccelerationCtrl(), np.zeros(14)
    law.desired(state(), ref, 0.0)
    ref[6] = 0.1
    rate = law.desired(state(), ref, 0.01)[11]
    assert rate > 0.0
    predicted = State(state().flat, 0.005)
    assert law.desired(predicted, ref, 0.015)[11] == rate


def test_the_lead_starts_anew_after_a_gap():
    law = FlatnessAccelerationCtrl()
    ref = np.zeros(14)
    law.desired(state(), ref, 0.0)
    ref[6] = 3.0
    np.testing.assert_array_equal(law.desired(state(), ref, 1.0)[10:12], 0.0)
