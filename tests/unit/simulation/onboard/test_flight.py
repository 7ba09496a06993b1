"""The firmware on board flies a body: signs of every command, in every frame, and how well it holds."""

import math

import numpy as np
import pytest
from rigid_body import Body

from crazychoir.platforms import (
    CRAZYFLIE_21,
    CRAZYFLIE_21_BRUSHLESS,
    CRAZYFLIE_21_PLUS,
    CRAZYFLIE_21_THRUST,
)
from crazychoir.simulation.motor_level import motor_control as mc
from crazychoir.types import FPQR, FRPY, XYZ, FullState, Vel

CONTROLLERS = ("pid", "mellinger", "lee")


def ready(body):
    """Powered on and standing until the supervisor lets it fly."""
    body.fly(0.2)
    if body.platform.firmware.needs_arming:
        assert body.onboard.arm()
        body.fly(0.2)
    assert body.onboard.state == "ready to fly"
    return body


def hovering(controller="pid", yaw=0.0, platform=CRAZYFLIE_21, height=1.0):
    body = ready(Body(platform, yaw=yaw))
    body.onboard.set("stabilizer.controller", controller)
    body.onboard.set("ctrlMel.mass", platform.mass)
    body.onboard.set("ctrlLee.mass", platform.mass)
    return body.hovering(height)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_body_rate_is_turned_about_its_axis(axis, sign):
    body = hovering()
    link = mc.MotorCtrlFPQR(body.onboard)
    rate = np.zeros(3)
    rate[axis] = 0.5 * sign
    body.fly(0.4, lambda: link.send(FPQR(np.array([body.platform.weight, *rate]))))
    assert sign * body.w[axis] > 0.3
    assert np.all(np.abs(np.delete(body.w, axis)) < 0.1)
    assert np.sign(body.angles[axis]) == sign


@pytest.mark.parametrize("yaw", [0.0, 2.0, -3.1])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_attitude_commands_tilt_the_right_way(controller, yaw):
    body = hovering(controller, yaw)
    link = mc.MotorCtrlFRPY(body.onboard)
    body.fly(
        0.8, lambda: link.send(FRPY(np.array([body.platform.weight, 0.1, 0.15, 0.0])))
    )
    assert body.angles[0] == pytest.approx(0.1, abs=0.03)
    assert body.angles[1] == pytest.approx(0.15, abs=0.03)
    ahead = body.v[0] * math.cos(yaw) + body.v[1] * math.sin(yaw)
    left = body.v[1] * math.cos(yaw) - body.v[0] * math.sin(yaw)
    assert ahead > 0.3  # nose down flies forward
    assert left < -0.2  # left side up flies to the right


@pytest.mark.parametrize("yaw", [0.0, 1.2, 3.1])
def test_velocity_is_in_the_world_and_the_yaw_rate_turns_left(yaw):
    body = hovering(yaw=yaw)
    link = mc.MotorCtrlVel(body.onboard)
    body.fly(2.0, lambda: link.send(Vel(np.array([0.4, -0.3, 0.2, 0.3]))))
    assert body.v == pytest.approx([0.4, -0.3, 0.2], abs=0.12)
    turned = (body.angles[2] - yaw + math.pi) % (2 * math.pi) - math.pi
    assert turned == pytest.approx(0.6, abs=0.2)


def placed(controller, send):
    """2 s of set-points from (0.49, 0.3, 0.77), as measured on the firmware."""
    body = ready(Body(p=(0.49, 0.3, 0.0)))
    body.onboard.set("stabilizer.controller", controller)
    return body.hovering(0.77).fly(2.0, lambda: send(body.onboard.setpoints))


def test_mellingers_controller_stays_level_in_modes_that_it_has_not():
    """Measured on the firmware: down to the floor, (0.52, 0.3), and without the roll."""
    body = placed("mellinger", lambda to: to.velocity((0.3, 0.0, 0.0), 0.0))
    assert body.p[2] < 0.02
    assert body.p[:2] == pytest.approx([0.49, 0.3], abs=0.05)
    body = placed("mellinger", lambda to: to.hover(0.3, 0.0, 0.0, 0.77))
    assert body.p[:2] == pytest.approx([0.52, 0.3], abs=0.05)
    body = placed("mellinger", lambda to: to.z_distance(0.05, 0.0, 0.0, 0.77))
    assert body.p[:2] == pytest.approx([0.49, 0.3], abs=0.05)


def test_mellingers_controller_stays_level_at_commanded_rates():
    """Near the floor: higher up its law wants a force downwards, and the drone turns over."""
    body = hovering("mellinger", height=0.2)
    link = mc.MotorCtrlFPQR(body.onboard)
    body.fly(0.6, lambda: link.send(FPQR(np.array([body.platform.weight, 0.5, 0, 0]))))
    assert 0.0 < body.angles[0] < 0.15  # at 0.5 rad/s it would be 0.3 rad


def test_lees_controller_has_no_thrust_for_velocities_and_flies_hover_to_the_origin():
    """Measured on the firmware: it falls at 3.4 m/s; it is at (0.18, 0.01) and (0.02, 0.01)."""
    body = placed("lee", lambda to: to.velocity((0.3, 0.0, 0.0), 0.0))
    assert body.p[2] == 0.0
    assert body.onboard.record["force"] == 0.0
    body = placed("lee", lambda to: to.hover(0.3, 0.0, 0.0, 0.77))
    assert body.p[:2] == pytest.approx([0.18, 0.01], abs=0.05)
    body = placed("lee", lambda to: to.z_distance(0.05, 0.0, 0.0, 0.77))
    assert body.p[:2] == pytest.approx([0.02, 0.01], abs=0.05)


@pytest.mark.parametrize("yaw", [0.0, 2.5])
def test_hover_set_points_are_along_the_heading(yaw):
    body = hovering(yaw=yaw)
    body.fly(2.0, lambda: body.onboard.setpoints.hover(0.4, 0.2, 0.0, 1.3))
    c, s = math.cos(yaw), math.sin(yaw)
    assert body.v[0] * c + body.v[1] * s == pytest.approx(0.4, abs=0.1)
    assert body.v[1] * c - body.v[0] * s == pytest.approx(0.2, abs=0.1)
    assert body.p[2] == pytest.approx(1.3, abs=0.05)


def test_z_distance_and_manual_tilt_as_frpy_does():
    body = hovering()
    body.fly(0.6, lambda: body.onboard.setpoints.z_distance(0.0, 0.1, 0.4, 1.0))
    assert body.v[0] > 0.2
    assert body.angles[2] > 0.1
    body = hovering()
    body.fly(
        0.6, lambda: body.onboard.setpoints.manual(body.platform.weight, -0.1, 0.0, 0.4)
    )
    assert body.v[1] > 0.2
    assert body.angles[2] > 0.1


@pytest.mark.parametrize(
    "platform",
    [CRAZYFLIE_21, CRAZYFLIE_21_PLUS, CRAZYFLIE_21_THRUST, CRAZYFLIE_21_BRUSHLESS],
)
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_position_is_held(controller, platform):
    body = hovering(controller, 0.1, platform)
    # the firmware's constant is that of the Crazyflie: on another platform it hovers at another height
    body.onboard.set("ctrlMel.massThrust", 65535 / (4 * platform.firmware.thrust_max))
    body.fly(6.0, lambda: body.onboard.setpoints.position((0.3, -0.2, 1.2), -0.2))
    assert body.p[2] == pytest.approx(1.2, abs=0.06)
    assert body.p[:2] == pytest.approx([0.3, -0.2], abs=0.02)
    # Mellinger's yaw rings for long on the slow motors of the 2.1: 217 s^-2 and 22 s^-1 with a lag of 86 ms
    assert body.angles[2] == pytest.approx(
        -0.2, abs=0.15 if controller == "mellinger" else 0.03
    )


@pytest.mark.parametrize("controller", ["mellinger", "lee"])
def test_a_circle_is_followed_by_full_states(controller):
    body = hovering(controller)
    link, r, w = mc.MotorCtrlFullState(body.onboard), 0.5, 1.5
    time = [0.0]

    def send():
        c, s = math.cos(w * time[0]), math.sin(w * time[0])
        time[0] += 0.02
        p, v, a = (
            (r * c - r, r * s, 1.0),
            (-r * w * s, r * w * c, 0),
            (-r * w * w * c, -r * w * w * s, 0),
        )
        link.send(
            FullState.at(p, v, a, (r * w**3 * s, -r * w**3 * c, 0), 0.3 * time[0], 0.3)
        )

    body.fly(6.0, send)
    x, y, z = body.p
    assert math.hypot(x + r, y) == pytest.approx(r, abs=0.06)
    assert z == pytest.approx(1.0, abs=0.05)
    assert body.angles[2] == pytest.approx(0.3 * 6.0, abs=0.1)


def test_take_off_go_to_and_land_stop_the_motors():
    body = ready(Body())
    link = mc.MotorCtrlXYZ(body.onboard)
    assert link.send(XYZ("take_off", np.array([0, 0, 0.5, 0.0, 2.0])))
    body.fly(3.0)
    assert body.p == pytest.approx([0, 0, 0.5], abs=0.06)
    assert not link.send(XYZ("take_off", np.array([0, 0, 0.5, 0.0, 2.0])))
    assert link.send(XYZ("go_to", np.array([0.5, 0.3, 0.8, 1.0, 2.0])))
    body.fly(5.0)
    assert body.p == pytest.approx([0.5, 0.3, 0.8], abs=0.06)
    assert body.angles[2] == pytest.approx(1.0, abs=0.05)
    assert link.send(XYZ("land", np.array([0, 0, 0.0, 1.0, 2.0])))
    body.fly(2.1)
    assert np.all(body.onboard.record["motors"] == 0.0)
    body.fly(2.2)
    assert body.onboard.state == "landed"
    assert body.p[2] < 0.03


def test_streamed_set_points_end_and_the_planner_lands():
    body = hovering()
    body.fly(1.0, lambda: body.onboard.setpoints.velocity((0.2, 0.0, 0.0), 0.0))
    assert body.onboard.planner.land(0.0, 2.0) == 0
    body.fly(0.3, lambda: body.onboard.setpoints.velocity((0.2, 0.0, 0.0), 0.0))
    assert body.v[0] > 0.1  # ignored: set-points have the higher priority
    link = mc.MotorCtrlXYZ(body.onboard)
    assert link.send(XYZ("land", np.array([0, 0, 0.0, 0.0, 2.0])))
    body.fly(3.0)
    assert body.p[2] < 0.05


def test_with_little_battery_hover_needs_the_same_thrust():
    body = hovering()
    body.onboard.record["vbat"] = 3.6
    body.fly(3.0, lambda: body.onboard.setpoints.position((0.0, 0.0, 1.0), 0.0))
    assert body.p[2] == pytest.approx(1.0, abs=0.1)
    assert body.onboard.log("pm.vbat") == pytest.approx(3.6)
