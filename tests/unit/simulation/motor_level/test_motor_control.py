"""The paper's motor controllers hand commands over, take over from one another, and cut."""

import numpy as np
import pytest

from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.motor_level import motor_control as mc
from crazychoir.simulation.onboard import loop
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.types import FPQR, FRPY, XYZ, FullState, Vel

HOVER = 0.32
COMMANDS = {
    mc.MotorCtrlFPQR: FPQR(np.array([HOVER, 0.1, 0.2, 0.3])),
    mc.MotorCtrlFRPY: FRPY(np.array([HOVER, 0.1, 0.2, 0.3])),
    mc.MotorCtrlVel: Vel(np.array([0.1, 0.2, 0.3, 0.0])),
    mc.MotorCtrlFullState: FullState.at((0, 0, 1)),
    mc.MotorCtrlXYZ: XYZ("take_off", np.array([0, 0, 1.0, 0.0, 2.0])),
}


def run(onboard, ms):
    loop.run(onboard.rows, float(ms), 0, 0, 0, 0, 0, 9.80665)
    return bool(np.any(onboard.record["motors"] > 0.0))


@pytest.fixture
def onboard():
    drone = Onboard(CRAZYFLIE_21)
    run(drone, 200)
    return drone


@pytest.mark.parametrize("kind", COMMANDS, ids=lambda kind: kind.__name__)
def test_a_command_turns_the_motors_and_cut_stops_them_for_good(onboard, kind):
    link = kind(onboard)
    assert link.send(COMMANDS[kind])
    assert run(onboard, 300)
    link.cut()
    assert not run(onboard, 41)  # the supervisor looks at 25 Hz
    link.send(COMMANDS[kind])
    assert not run(onboard, 300)


@pytest.mark.parametrize("kind", [mc.MotorCtrlFPQR, mc.MotorCtrlVel])
def test_places_take_over_from_streamed_set_points(onboard, kind):
    """The planner is not heard before notify_setpoint_stop: a stop would leave the motors on until the time-outs."""
    assert kind(onboard).send(COMMANDS[kind])
    assert run(onboard, 100)
    assert mc.MotorCtrlXYZ(onboard).send(XYZ("stop", np.zeros(5)))
    assert not run(onboard, 50)


@pytest.mark.parametrize("kind", [mc.MotorCtrlFPQR, mc.MotorCtrlFRPY])
def test_the_first_command_unlocks_the_thrust_and_has_it(onboard, kind):
    link = kind(onboard)
    assert onboard.record["locked_thrust"]
    for _ in range(2):
        link.send(COMMANDS[kind])
        assert not onboard.record["locked_thrust"]
        assert onboard.record["wanted"]["thrust"] == pytest.approx(HOVER * 65535 / 0.48)


def test_the_flight_mode_follows_the_kind(onboard):
    mc.MotorCtrlFPQR(onboard)
    assert [
        onboard.get(f"flightmode.stabMode{axis}") for axis in ("Roll", "Pitch", "Yaw")
    ] == [0, 0, 0]
    mc.MotorCtrlFRPY(onboard)
    assert [
        onboard.get(f"flightmode.stabMode{axis}") for axis in ("Roll", "Pitch", "Yaw")
    ] == [1, 1, 0]


def test_the_planner_stops_the_motors_by_its_verb(onboard):
    link = mc.MotorCtrlXYZ(onboard)
    link.send(COMMANDS[mc.MotorCtrlXYZ])
    assert run(onboard, 500)
    assert link.send(XYZ("stop", np.zeros(5)))
    assert not run(onboard, 20)
    assert link.send(XYZ("land", np.array([0.0, 0.0, 0.0, 0.0, 1.0])))
    assert not link.send(XYZ("land", np.zeros(5))), "it lands"


def test_a_level_full_state_asks_for_the_attitude_of_its_acceleration(onboard):
    mc.MotorCtrlFullState(onboard).send(
        FullState.at((0, 0, 1), a=(9.80665, 0, 0), yaw=0.0)
    )
    sp = onboard.record["wanted"]
    assert [sp["qx"], sp["qy"], sp["qz"], sp["qw"]] == pytest.approx(
        [0, np.sin(np.pi / 8), 0, np.cos(np.pi / 8)]
    )


def test_a_plan_with_a_number_that_is_not_finite_is_refused(onboard):
    link = mc.MotorCtrlXYZ(onboard)
    assert not link.send(XYZ("go_to", np.array([np.nan, 0.0, 1.0, 0.0, 1.0])))
    assert link.send(XYZ("take_off", np.array([0.0, 0.0, 1.0, 0.0, 1.0])))
