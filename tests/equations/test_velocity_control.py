"""Velocities and waypoints: the laws as written, and that they leave no lag behind the firmware's cascade."""

import math

import numpy as np
import pytest

from crazychoir.control.firmware import (
    FullStateController,
    VelocityController,
    WaypointController,
)
from crazychoir.control.handlers import FullStateTraj
from crazychoir.control.senders import FullStateSender, VelSender, XYZSender
from crazychoir.control.velocity import FIRMWARE_GAINS, VelocityCtrlStrategy
from crazychoir.numerics.math3d import rotation_exponential, wrap_angle, yaw_of
from crazychoir.types import FullState, State

H = 0.001
LEARNT_HEIGHT, LEARNT_YAW = (
    0.5,
    1.0,
)  # 1/s2, the firmware's ki of the height and of the yaw
A = np.array([0.3, -0.2, 0.4])  # m/s2
V = np.array([0.5, 0.1, 0.3])  # m/s


def moving(t, p0=(0.1, 0.2, 0.3), a=A, yaw=3.0, rate=0.8):
    return FullState.at(
        np.array(p0) + V * t + 0.5 * a * t * t,
        V + a * t,
        a,
        np.zeros(3),
        yaw + rate * t,
        rate,
    )


def test_the_velocity_strategy_is_its_equation():
    x = np.zeros(13)
    x[0:6] = [0.2, 0.1, 0.5, 0.3, 0.3, 0.1]
    x[6:10] = rotation_exponential(0.0, 0.0, -3.0)
    reference = moving(0.0)
    kp, kd, k_yaw = 1.2, 0.3, 1.7
    u = VelocityCtrlStrategy(kp, kd, k_yaw).velocity(State(x), reference.flat)
    wanted = (
        V
        + [*A[:2] / FIRMWARE_GAINS.velocity, 0.0]
        + kp * (reference.p - x[0:3])
        + kd * (V - x[3:6])
    )
    np.testing.assert_allclose(u[:3], wanted, rtol=1e-12)
    assert u[3] == pytest.approx(0.8 + k_yaw * wrap_angle(3.0 - yaw_of(x[6:10])))
    assert u[3] < 0.8  # 3.0 is 0.28 rad to the right of -3.0


def test_a_velocity_is_not_longer_than_its_limit():
    x = State.at((0.0, 0.0, 0.0))
    u = VelocityCtrlStrategy(kp=10.0, v_max=0.5).velocity(
        x, FullState.at((3.0, -4.0, 0.0)).flat
    )
    np.testing.assert_allclose(u[:3], [0.3, -0.4, 0.0], atol=1e-12)
    controller = VelocityController(
        VelocityCtrlStrategy(), VelSender(), FullStateTraj()
    )
    assert (
        controller.law(
            State.at((math.nan, 0.0, 0.0)), FullState.at((0.0, 0.0, 0.0)).flat, 0.0
        )
        is None
    )


def test_a_line_ends_where_the_set_point_must_be():
    """At first nothing is learnt; after k / k_i s of the same climb and turn all but 1/e of it."""
    every, ahead, late = 0.1, 0.2, 0.05
    controller = WaypointController(XYZSender(), FullStateTraj(), every, ahead, late)
    steady = FullState.at(
        (0.1, 0.2, 0.3), V, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 3.0, 0.8
    )
    t = ahead + late
    line = controller.law(State.at((0.0, 0.0, 0.0)), moving(0.0).flat, 5.0)
    then = moving(t)
    lead = (
        np.add(then.v, [*A[:2] / FIRMWARE_GAINS.velocity, 0.0])
        / FIRMWARE_GAINS.position
    )
    np.testing.assert_allclose(line[:3], then.p + lead, rtol=1e-12)
    assert (line[3], line[4]) == (
        pytest.approx(3.0 + 0.8 * t + 0.8 / FIRMWARE_GAINS.yaw),
        ahead,
    )
    for seconds, axis, speed, kp in (
        (FIRMWARE_GAINS.position / LEARNT_HEIGHT, 2, V[2], FIRMWARE_GAINS.position),
        (FIRMWARE_GAINS.yaw / LEARNT_YAW, 3, 0.8, FIRMWARE_GAINS.yaw),
    ):
        controller = WaypointController(
            XYZSender(), FullStateTraj(), every, ahead, late
        )
        for now in np.linspace(5.0, 5.0 + seconds, round(seconds / every) + 1):
            line = controller.law(State.at((0.0, 0.0, 0.0)), steady.flat, now)
        start = (*steady.p, steady.yaw)[axis]
        assert line[axis] - start - speed * t == pytest.approx(
            speed / math.e / kp, rel=1e-9
        )
        line = controller.law(
            State.at((0.0, 0.0, 0.0)), steady.flat, 60.0
        )  # another flight
        assert line[axis] - start - speed * t == pytest.approx(speed / kp, rel=1e-9)


def test_a_full_state_is_as_far_ahead_as_a_line():
    """The place and the yaw are those of a line that ends at once; velocity, acceleration and jerk those of then."""
    here, late = State.at((0.0, 0.0, 0.0)), 0.05
    full = FullStateController(FullStateSender(), FullStateTraj(), late)
    line = WaypointController(XYZSender(), FullStateTraj(), 0.0, ahead=0.0, late=late)
    for now in np.linspace(0.0, 3.0, 31):
        u, w = (
            controller.law(here, moving(now).flat, now) for controller in (full, line)
        )
        np.testing.assert_allclose([*u[0:3], u[12]], w[0:4], rtol=1e-12)
        np.testing.assert_allclose(
            u[3:12], [*moving(now + late).v, *A, 0.0, 0.0, 0.0], atol=1e-12
        )
        assert u[13] == 0.8
    assert full.law(here, FullState.at((math.nan, 0.0, 0.0)).flat, 3.1) is None


def cascade(controller, reference, seconds):
    """The firmware's laws as differential equations behind the set-points of a controller: errors (4,) at the end.

    Places: v_set = k_p e, v' = k_v (v_set - v);  height: v = k_p e + k_i int e;  yaw: its rate likewise.
    """
    p, v, yaw, learnt = (
        reference(0.0).p.copy(),
        reference(0.0).v[:2].copy(),
        reference(0.0).yaw,
        np.zeros(2),
    )
    for k in range(round(seconds / H)):
        line = controller.law(State.at((0.0, 0.0, 0.0)), reference(k * H).flat, k * H)
        e, turn = line[0:3] - p, line[3] - yaw
        learnt += H * np.array([LEARNT_HEIGHT * e[2], LEARNT_YAW * turn])
        p[:2] += H * v
        v += H * FIRMWARE_GAINS.velocity * (FIRMWARE_GAINS.position * e[:2] - v)
        p[2] += H * (FIRMWARE_GAINS.position * e[2] + learnt[0])
        yaw += H * (FIRMWARE_GAINS.yaw * turn + learnt[1])
    end = reference(seconds)
    return np.array([*(p - end.p), yaw - end.yaw])


def test_behind_the_cascade_of_the_firmware_the_lead_leaves_no_lag():
    """Places of constant acceleration, a height and a yaw of constant rates: in the beginning, and when they last."""

    def reference(t):
        return moving(t, a=np.array([0.1, -0.05, 0.0]))

    for seconds in (1.0, 8.0):
        controller = WaypointController(
            XYZSender(), FullStateTraj(), 0.0, ahead=0.0, late=0.0
        )
        assert np.max(np.abs(cascade(controller, reference, seconds))) < 2e-3
