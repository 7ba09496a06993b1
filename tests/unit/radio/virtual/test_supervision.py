"""The supervisor by the clock: set-points end, a program stops the drone, or the drone may not fly."""

import math

import pytest
from virtual_drones import Hangar

from crazychoir.radio.virtual.fault_control import overturn

WEIGHT = 0.0319 * 9.81
LEVEL_OUT, LOCKED = "warning: level out", "locked"
LOW_LEVEL = {
    "rpyt": (0.0, 0.0, 0.0, round(WEIGHT * 136531)),
    "manual": (0.0, 0.0, 0.0, round(WEIGHT * 136531), 0),
    "altitude_hold": (0.0, 0.0, 0.0, 0.0),
    "velocity_world": (0.0, 0.0, 0.0, 0.0),
    "velocity_world_legacy": (0.0, 0.0, 0.0, 0.0),
    "z_distance": (0.0, 0.0, 0.0, 0.5),
    "z_distance_legacy": (0.0, 0.0, 0.0, 0.5),
    "hover": (0.0, 0.0, 0.0, 0.5),
    "hover_legacy": (0.0, 0.0, 0.0, 0.5),
    "position": (0.0, 0.0, 0.5, 0.0),
    "full_state": (0, 0, 500, 0, 0, 0, 0, 0, 0, 3 << 30, 0, 0, 0),
}
FLIES, CAN_ARM, ARMED, TUMBLED, IS_LOCKED, CRASHED, PLANNED = 4, 0, 1, 5, 6, 7, 8


def _bit(hangar, k):
    return bool(hangar.drone.flight.info >> k & 1)


@pytest.mark.parametrize("name", LOW_LEVEL)
def test_after_the_last_set_point_it_levels_out_at_500_ms_and_locks_at_2_s(name):
    hangar = Hangar().hovering()
    if name == "rpyt":
        hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
    hangar.run(0.3, name, *LOW_LEVEL[name])
    hangar.send(name, *LOW_LEVEL[name])
    hangar.run(0.45)
    assert hangar.supervisor == "flying"
    hangar.run(0.15)
    assert hangar.supervisor == LEVEL_OUT
    assert hangar.motors
    hangar.run(1.35)
    assert hangar.supervisor == LEVEL_OUT
    hangar.run(0.2)
    assert hangar.supervisor == LOCKED
    assert not hangar.motors
    assert _bit(hangar, IS_LOCKED)


def test_levelling_out_ends_with_the_next_set_point():
    hangar = Hangar().hovering()
    hangar.run(0.5, "velocity_world", 0.5, 0.0, 0.0, 0.0)
    hangar.run(1.0)
    assert hangar.supervisor == LEVEL_OUT
    hangar.run(0.2, "velocity_world", 0.0, 0.0, 0.0, 0.0)
    assert hangar.supervisor == "flying"


def test_under_the_planner_silence_means_nothing():
    hangar = Hangar().hovering()
    assert _bit(hangar, PLANNED)
    hangar.run(6.0)
    assert hangar.supervisor == "flying"
    assert hangar.state[2] == pytest.approx(0.5, abs=0.05)


def test_after_the_end_of_set_points_is_told_the_planner_holds_the_place():
    hangar = Hangar().hovering()
    hangar.run(0.5, "hover", 0.0, 0.0, 0.0, 0.5)
    hangar.send("notify_setpoint_stop", 0)
    hangar.send("go_to", 0, 0, 0, 0.0, 0.0, 0.5, 0.0, 1.0)
    hangar.run(4.0)
    assert hangar.supervisor == "flying"
    hangar.send("land", 0, 0.0, 0.0, True, 1.0)
    hangar.run(1.6)
    assert not hangar.motors
    assert hangar.state[2] == 0.0


@pytest.mark.parametrize("name", ["emergency_stop", "supervisor_stop"])
def test_an_emergency_stop_is_within_40_ms_and_for_good(name):
    hangar = Hangar().hovering()
    hangar.send(name)
    hangar.run(0.05)
    assert not hangar.motors
    hangar.run(0.1)
    assert hangar.supervisor == LOCKED
    (reply,) = hangar.send("take_off", 0, 0.5, 0.0, True, 1.0)
    assert reply.data[3] == 16
    hangar.run(2.0)
    assert not hangar.motors
    (reply,) = hangar.send("recover")
    assert reply.data == bytes([0x82, 1, 1]), "it is locked, it has not crashed"


def test_the_parameter_that_stops():
    hangar = Hangar().hovering()
    hangar.drone.parameters.set("stabilizer.stop", 1.0)
    hangar.run(0.12)
    assert hangar.supervisor == LOCKED


def test_arming_within_40_ms_of_a_disarm_is_refused():
    """The firmware: `81 00 00`, then `81 01 01`."""
    hangar = Hangar().run(0.5)
    (reply,) = hangar.send("arm", False)
    assert reply.data == bytes([0x81, 1, 0])
    (reply,) = hangar.send("arm", True)
    assert reply.data == bytes([0x81, 0, 0])
    hangar.run(0.2)
    (reply,) = hangar.send("arm", True)
    assert reply.data == bytes([0x81, 1, 1])


@pytest.mark.parametrize("name", ["emergency_stop_watchdog", "supervisor_watchdog"])
def test_the_watchdog_bites_a_second_after_it_was_fed_last_and_never_before_it_was_fed_once(
    name,
):
    hangar = Hangar().hovering()
    hangar.run(1.5)
    assert hangar.supervisor == "flying"
    hangar.run(2.0, name, every=0.9)
    assert hangar.supervisor == "flying"
    hangar.send(name)
    hangar.run(0.95)
    assert hangar.supervisor == "flying"
    hangar.run(0.15)
    assert hangar.supervisor == LOCKED


def test_a_self_arming_drone_may_take_off_and_another_must_be_armed_first():
    assert Hangar().run(0.5).onboard.info & 0b1000
    brushless = Hangar("cf21bl", device="Crazyflie 2.1 Brushless").run(0.5)
    (reply,) = brushless.send("take_off", 0, 0.5, 0.0, True, 1.0)
    assert reply.data[3] == 16
    assert (_bit(brushless, CAN_ARM), _bit(brushless, ARMED)) == (True, False)
    (reply,) = brushless.send("arm", True)
    assert reply.data == bytes([0x81, 1, 1])
    brushless.run(0.2)
    (reply,) = brushless.send("take_off", 0, 0.5, 0.0, True, 1.0)
    assert reply.data[3] == 0
    brushless.run(2.0)
    assert brushless.state[2] == pytest.approx(0.5, abs=0.06)
    brushless.send("arm", False)
    brushless.run(0.1)
    assert not brushless.motors


def test_a_refused_arming():
    hangar = Hangar().run(0.5)
    hangar.drone.refuse_arming(True)
    hangar.run(0.2)
    assert not _bit(hangar, CAN_ARM)
    (reply,) = hangar.send("arm", True)
    assert reply.data == bytes([0x81, 0, 0])
    (reply,) = hangar.send("take_off", 0, 0.5, 0.0, True, 1.0)
    assert reply.data[3] == 16
    hangar.drone.refuse_arming(False)
    assert hangar.hovering().state[2] == pytest.approx(0.5, abs=0.05)


def test_a_drone_on_its_back_has_crashed_and_recovers_upright():
    hangar = Hangar().hovering()
    for _ in range(150):
        overturn(hangar.world.states[0])
        hangar.run(0.01)
    assert (_bit(hangar, TUMBLED), _bit(hangar, CRASHED)) == (True, True)
    assert not hangar.motors
    (reply,) = hangar.send("recover")
    assert reply.data == bytes([0x82, 0, 0])
    hangar.world.states[0, 6:10] = (0.0, 0.0, 0.0, 1.0)
    hangar.run(0.5)
    (reply,) = hangar.send("recover")
    assert reply.data == bytes([0x82, 1, 1])
    assert hangar.hovering().state[2] == pytest.approx(0.5, abs=0.05)


def test_cflib_closing_a_link_cuts_the_motors_and_the_plan():
    hangar = Hangar().hovering()
    hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
    hangar.run(0.05)
    assert not hangar.motors
    assert hangar.drone.flight.zeros == 1
    assert not math.isclose(hangar.run(0.5).state[2], 0.5, abs_tol=0.1)


def test_a_plan_command_applies_to_all_drones_or_to_those_in_its_groups():
    hangar = Hangar().hovering()
    hangar.send("planner_stop", 0b01)
    hangar.send("group_mask", 0b10)
    hangar.run(0.1)
    assert hangar.motors
    hangar.send("planner_stop", 0b01)
    hangar.run(0.1)
    assert hangar.motors
    hangar.send("planner_stop", 0b11)
    hangar.run(0.1)
    assert not hangar.motors
