"""Log variables of the controllers and the estimator of a drone that flies."""

import math

import numpy as np
import pytest
from virtual_drones import Hangar

TERMS = ("P", "I", "D", "FF")


@pytest.fixture(scope="module")
def moving():
    """A drone in the middle of a fast move with a turn."""
    hangar = Hangar().hovering()
    for gain in ("pid_rate.roll_kff", "pid_attitude.roll_kff", "pid_attitude.roll_kd"):
        hangar.onboard.set(gain, 0.1)
    hangar.send("go_to", 0, False, False, 1.0, 0.5, 1.0, 1.0, 1.0)
    return hangar.run(0.5)


def add_terms(log, prefix):
    return sum(log(prefix + term) for term in TERMS)


@pytest.mark.parametrize("axis", ["roll", "pitch", "yaw"])
def test_the_terms_of_the_attitude_pids_add_to_the_wanted_rates(moving, axis):
    total = add_terms(moving.log, f"pid_attitude.{axis}_out")
    assert abs(total) > 1.0
    assert moving.log(f"controller.{axis}Rate") == pytest.approx(total, rel=1e-9)


@pytest.mark.parametrize(("axis", "sign"), [("roll", 1), ("pitch", 1), ("yaw", -1)])
def test_the_terms_of_the_rate_pids_add_to_the_commands(moving, axis, sign):
    total = sign * add_terms(moving.log, f"pid_rate.{axis}_out")
    assert abs(total) > 1.0
    # the command is truncated to a whole number
    assert moving.log(f"controller.cmd_{axis}") == pytest.approx(total, abs=1.0)


def test_the_terms_of_the_position_pids_add_to_their_targets(moving):
    def total(prefix):
        return sum(moving.log(prefix + term.lower()) for term in TERMS)

    for axis in "XYZ":
        assert total(f"posCtl.{axis}") == pytest.approx(
            moving.log(f"posCtl.targetV{axis}"), rel=1e-9
        )
    assert -total("posCtl.VX") == pytest.approx(moving.log("controller.pitch"))
    assert -total("posCtl.VY") == pytest.approx(moving.log("controller.roll"))


def test_positions_of_the_controller_are_turned_by_the_yaw(moving):
    yaw = math.radians(moving.log("stateEstimate.yaw"))
    assert abs(yaw) > 0.1
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    for prefix, names in (("body", "xy"), ("bodyV", ("vx", "vy"))):
        world = [moving.log(f"stateEstimate.{name}") for name in names]
        found = [moving.log(f"posCtl.{prefix}{axis}") for axis in "XY"]
        assert found == pytest.approx(turn @ world)
    wanted = [moving.log(f"ctrltarget.{axis}") for axis in "xy"]
    # the position PIDs ran up to 10 ms ago
    assert [moving.log(f"posCtl.target{axis}") for axis in "XY"] == pytest.approx(
        turn @ wanted, abs=0.03
    )


def test_the_state_of_the_kalman_filter_has_the_velocity_in_body_axes(moving):
    speed = math.dist((0, 0, 0), [moving.log(f"stateEstimate.v{a}") for a in "xyz"])
    found = [moving.log(f"kalman.stateP{axis}") for axis in "XYZ"]
    assert speed > 0.2
    assert math.dist((0, 0, 0), found) == pytest.approx(speed)
    assert found[0] == pytest.approx(
        moving.log("posCtl.bodyVX"), abs=0.2
    )  # nearly level
    assert 0.0 < moving.log("kalman.varD0") < 1e-2
    assert 0.0 < moving.log("kalman.varD2") < 1e-2


def test_the_rates_of_a_pitch_are_positive_nose_up(moving):
    nose_up = -math.radians(moving.log("gyro.y"))
    assert abs(nose_up) > 0.01
    assert moving.log("controller.r_pitch") == pytest.approx(nose_up)
    assert moving.log("stateEstimateZ.ratePitch") == pytest.approx(1000.0 * nose_up)
    assert moving.log("gyro.yRaw") == pytest.approx(
        moving.log("gyro.y") * 65536.0 / 4000.0
    )


def test_each_controller_logs_while_it_flies():
    hangar = Hangar().hovering()
    hangar.send("go_to", 0, False, False, 1.0, 0.0, 0.5, 0.0, 1.0)
    hangar.run(0.2)
    assert hangar.log("ctrlMel.cmd_thrust") == hangar.log("ctrlLee.thrustSi") == 0.0
    hangar.onboard.set("stabilizer.controller", 2)
    hangar.run(0.1)
    axis = [hangar.log(f"ctrlMel.zd{axis}") for axis in "xyz"]
    assert math.dist((0, 0, 0), axis) == pytest.approx(1.0)
    assert axis[0] > 0.05  # it tilts ahead to accelerate
    assert hangar.log("ctrlMel.cmd_thrust") == hangar.log("controller.cmd_thrust") > 0.0
    assert hangar.log("ctrlMel.i_err_x") > 0.0
    hangar.onboard.set("stabilizer.controller", 5)
    hangar.run(0.1)
    assert hangar.log("ctrlMel.cmd_thrust") == 0.0
    assert hangar.log("ctrlLee.thrustSi") == hangar.onboard.record["force"] > 0.1
    assert hangar.log("ctrlLee.error_posx") > 0.0
    wanted = [hangar.log(f"ctrlLee.rpyd{axis}") for axis in "xyz"]
    found = [hangar.log(f"ctrlLee.rpy{axis}") for axis in "xyz"]
    assert found == pytest.approx(wanted, abs=0.15)
    assert wanted[1] > 0.02  # positive nose down, to accelerate ahead
    assert hangar.log("ctrlLee.KR_x") == pytest.approx(0.007)
