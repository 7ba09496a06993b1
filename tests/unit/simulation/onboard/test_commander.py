"""Set-points: priorities, the thrust lock, limits, signs, time stamps."""

import math

import numpy as np
import pytest

from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.motor_level.motor_control import MotorCtrlFPQR, MotorCtrlFRPY
from crazychoir.simulation.onboard import loop
from crazychoir.simulation.onboard.commander import SETPOINT_PRIORITIES
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.types import FPQR, FRPY


@pytest.fixture
def onboard():
    drone = Onboard(CRAZYFLIE_21)
    run(drone, 200)
    return drone


def run(onboard, ms):
    loop.run(onboard.rows, float(ms), 0.0, 0.0, 0.0, 0.0, 0.0, 9.80665)


def wanted(onboard, *names):
    return tuple(float(onboard.record["wanted"][name]) for name in names)


def test_thrust_is_locked_until_a_packet_without_thrust(onboard):
    assert onboard.setpoints.rpyt_raw(0, 0, 0, 30000)
    assert wanted(onboard, "thrust") == (0,)
    onboard.setpoints.rpyt_raw(0, 0, 0, 0)
    onboard.setpoints.rpyt_raw(0, 0, 0, 30000)
    assert wanted(onboard, "thrust") == (30000,)


def test_thrust_is_locked_again_when_no_sender_has_control(onboard):
    onboard.setpoints.rpyt_raw(0, 0, 0, 0)
    onboard.record["priority"] = 0
    onboard.setpoints.rpyt_raw(0, 0, 0, 30000)
    assert wanted(onboard, "thrust") == (0,)


@pytest.mark.parametrize(
    ("sent", "taken"), [(999, 0), (1000, 1000), (60000, 60000), (65000, 60000)]
)
def test_limits_of_the_thrust(onboard, sent, taken):
    onboard.setpoints.rpyt_raw(0, 0, 0, 0)
    onboard.setpoints.rpyt_raw(0, 0, 0, sent)
    assert wanted(onboard, "thrust") == (taken,)


@pytest.mark.parametrize("rates", [(0, 0, 0), (1, 1, 0), (0, 1, 1), (1, 0, 1)])
def test_modes_of_an_rpyt_packet(onboard, rates):
    for axis, value in zip(("Roll", "Pitch", "Yaw"), rates, strict=True):
        onboard.set(f"flightmode.stabMode{axis}", value)
    onboard.setpoints.rpyt_raw(1.0, 2.0, 3.0, 0)
    names = ("roll", "pitch", "yaw")
    assert wanted(onboard, *(f"mode_{n}" for n in names)) == tuple(
        1 if r else 2 for r in rates
    )
    taken = [
        wanted(onboard, n if r else f"{n}_rate")[0]
        for n, r in zip(names, rates, strict=True)
    ]
    assert taken == [1.0, 2.0, 3.0 if rates[2] else -3.0]


def test_fpqr_and_frpy_unlock_and_arrive_in_the_firmwares_signs(onboard):
    MotorCtrlFPQR(onboard).send(FPQR(vector(0.3, 0.1, 0.2, 0.3)))
    assert wanted(onboard, "thrust")[0] == pytest.approx(0.3 * 65535 / 0.48)
    # pitch nose up in the firmware; the yaw rate's two signs cancel
    assert wanted(onboard, "roll_rate", "pitch_rate", "yaw_rate") == pytest.approx(
        degrees(0.1, -0.2, 0.3)
    )
    MotorCtrlFRPY(onboard).send(FRPY(vector(0.3, 0.1, 0.2, 0.3)))
    assert wanted(onboard, "roll", "pitch", "yaw_rate") == pytest.approx(
        degrees(0.1, -0.2, 0.3)
    )


def vector(*numbers):
    return np.array(numbers, dtype=float)


def degrees(*radians):
    return tuple(math.degrees(r) for r in radians)


def test_only_rpyt_turns_the_yaw_rates_sign(onboard):
    onboard.setpoints.velocity((0, 0, 0), 0.5)
    assert wanted(onboard, "yaw_rate") == pytest.approx(degrees(0.5))
    onboard.setpoints.hover(0, 0, 0.5, 1.0)
    assert wanted(onboard, "yaw_rate") == pytest.approx(degrees(0.5))
    onboard.setpoints.z_distance(0, 0, 0.5, 1.0)
    assert wanted(onboard, "yaw_rate") == pytest.approx(degrees(0.5))
    onboard.setpoints.manual(0.3, 0, 0, 0.5)
    assert wanted(onboard, "yaw_rate") == pytest.approx(degrees(0.5))


def test_full_state_keeps_rates_and_takes_the_heading(onboard):
    q = [0, 0, math.sin(0.4), math.cos(0.4)]
    assert onboard.setpoints.full_state(
        vector(1, 2, 3, 4, 5, 6, 7, 8, 9, *q, 0.1, 0.2, 0.3)
    )
    assert wanted(onboard, "x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az") == (
        1,
        2,
        3,
        4,
        5,
        6,
        7,
        8,
        9,
    )
    assert wanted(
        onboard, "roll_rate", "pitch_rate", "yaw_rate", "yaw"
    ) == pytest.approx(degrees(0.1, 0.2, 0.3, 0.8))
    assert wanted(onboard, "mode_x", "mode_y", "mode_z", "mode_quat", "mode_yaw") == (
        1,
        1,
        1,
        1,
        0,
    )


def test_a_lower_priority_is_refused_until_the_higher_has_ended(onboard):
    assert onboard.setpoints.position((1, 0, 1), 0.0, SETPOINT_PRIORITIES.external)
    assert not onboard.setpoints.position((2, 0, 1), 0.0, SETPOINT_PRIORITIES.crtp)
    assert wanted(onboard, "x") == (1,)
    onboard.notify_setpoint_stop()
    assert onboard.setpoints.position((2, 0, 1), 0.0, SETPOINT_PRIORITIES.crtp)


def test_a_set_point_stops_the_planner_until_it_is_told(onboard):
    onboard.planner.take_off(1.0, 2.0)
    run(onboard, 500)
    assert onboard.info >> 8 & 0b111 == 0b001
    onboard.setpoints.velocity((0, 0, 0.1), 0.0)
    run(onboard, 40)  # the bits are those of the last pass of the supervisor
    assert onboard.info >> 8 & 0b111 == 0b010
    assert (
        onboard.planner.go_to((0, 0, 1), 0.0, 1.0) == 0
    )  # runs, but its set-points are not used
    run(onboard, 60)
    assert wanted(onboard, "mode_z") == (2,)
    onboard.notify_setpoint_stop()
    run(onboard, 20)
    assert wanted(onboard, "mode_z") == (1,)


def test_a_planner_that_is_in_control_again_without_a_plan_switches_the_motors_off(
    onboard,
):
    onboard.planner.take_off(1.0, 2.0)
    run(onboard, 500)
    onboard.setpoints.velocity((0, 0, 0.1), 0.0)
    run(onboard, 20)
    assert wanted(onboard, "mode_z") == (2,)
    onboard.notify_setpoint_stop()
    run(onboard, 20)
    assert wanted(onboard, "mode_z") == (0,)


def test_the_idle_planner_gives_null_set_points_and_their_age_stays_fresh(onboard):
    run(onboard, 5000)
    fw = onboard.record
    assert fw["tick"] - fw["stamp"] <= 10
    assert wanted(onboard, "mode_x", "mode_z", "thrust") == (0, 0, 0)


def test_a_set_point_is_stamped_with_its_ms(onboard):
    run(onboard, 7)
    onboard.setpoints.velocity((0, 0, 0), 0.0)
    assert onboard.record["stamp"] == 207


@pytest.mark.parametrize("nan", [math.nan, math.inf])
def test_what_is_not_a_number_is_not_taken(onboard, nan):
    onboard.setpoints.position((0, 0, 1), 0.0)
    assert not onboard.setpoints.position((nan, 0, 1), 0.0)
    assert not onboard.setpoints.velocity((0, nan, 0), 0.0)
    assert not onboard.setpoints.fpqr(nan, 0, 0, 0)
    assert not onboard.setpoints.manual(0.3, nan, 0, 0)
    assert not onboard.setpoints.hover(0, 0, 0, nan)
    assert not onboard.setpoints.z_distance(0, nan, 0, 1)
    assert not onboard.setpoints.full_state(vector(*[0.0] * 15, nan))
    assert wanted(onboard, "z") == (1,)
