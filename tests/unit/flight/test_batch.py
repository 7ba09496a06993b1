"""The records of the drones of a process, and how the Python parts of a drone read and write them."""

import math

import numpy as np
import pytest

from crazychoir.flight.batch import (
    MODE_NUMBERS,
    NUMBERED_MODES,
    Batch,
    Course,
    FlightControllerKind,
    FlightReferenceKind,
)
from crazychoir.safety.rules.guard import Action
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Acceleration, FullState, State, Velocity

FLAT = np.arange(1.0, 15.0)


def make_row(size=3, index=1):
    batch = Batch(size)
    return [batch.add(k) for k in range(size)][index]


def test_each_drone_gets_the_next_record():
    batch = Batch(3)
    rows = [batch.add(k + 7) for k in range(3)]
    assert batch.count == 3
    rows[1].drone["age"] = 0.25
    rows[1].plan["duration"] = 2.0
    rows[1].guard["reach"] = 3.0
    assert batch.drones["age"].tolist() == [0.0, 0.25, 0.0]
    assert batch.plans["duration"].tolist() == [0.0, 2.0, 0.0]
    assert batch.guards["reach"].tolist() == [0.0, 3.0, 0.0]


def test_a_new_drone_is_on_the_ground_has_never_evaded_and_hears_enough():
    row = make_row()
    assert row.mode is Mode.GROUND
    assert row.obeyed is Action.NOMINAL
    assert row.state is None
    assert row.reference is None
    assert row.flown is None
    assert row.fence_ticks == 0
    assert row.drone["gave_way"] == -math.inf
    assert row.drone["cut_off_since"] == math.inf


@pytest.mark.parametrize("mode", Mode)
def test_a_mode_is_a_number_in_the_record(mode):
    row = make_row()
    row.mode = mode
    assert row.mode is mode
    assert NUMBERED_MODES[row.drone["mode"]] is mode
    assert MODE_NUMBERS[mode] == row.drone["mode"]


@pytest.mark.parametrize("action", Action)
def test_an_action_is_a_number_in_the_record(action):
    row = make_row()
    row.obeyed = action
    assert row.obeyed is action


def test_the_state_of_a_tick_is_read_once_and_keeps_its_numbers():
    row = make_row()
    row.drone["is_known"] = 1
    row.drone["number"] = 1
    row.drone["state"] = FLAT[:13]
    row.drone["age"] = 0.5
    row.drone["acceleration"] = (7.0, 8.0, 9.0)
    first = row.state
    assert isinstance(first, State)
    assert first.flat.tolist() == FLAT[:13].tolist()
    assert first.age == 0.5
    assert first.a.tolist() == [7.0, 8.0, 9.0]
    assert row.state is first, "the tick is the same"
    row.drone["state"] = 0.0
    row.drone["number"] = 2
    assert row.state.flat.tolist() == 13 * [0.0]
    assert first.flat.tolist() == FLAT[:13].tolist(), "a law may keep it"
    with pytest.raises(ValueError, match="read-only"):
        first.flat[0] = 1.0


def test_an_acceleration_is_kept_with_its_yaw():
    row = make_row()
    row.set_reference(Acceleration(FLAT[:3], 0.5), 7)
    found = row.reference
    assert isinstance(found, Acceleration)
    assert found.a.tolist() == [1.0, 2.0, 3.0]
    assert found.yaw == 0.5
    assert row.drone["reference_ns"] == 7


def test_a_velocity_is_kept_with_its_yaw():
    row = make_row()
    row.set_reference(Velocity(FLAT[:3], 0.5), 7)
    found = row.reference
    assert isinstance(found, Velocity)
    assert found.v.tolist() == [1.0, 2.0, 3.0]
    assert found.yaw == 0.5


def test_a_full_state_is_kept_with_all_its_numbers():
    row = make_row()
    row.set_reference(FullState(FLAT), 7)
    found = row.reference
    assert isinstance(found, FullState)
    assert found.flat.tolist() == FLAT.tolist()


def test_without_a_reference_the_drone_flies_its_plan_and_the_time_of_the_last_one_stays():
    row = make_row()
    row.set_reference(FullState(FLAT), 7)
    row.set_reference(None)
    assert row.reference is None
    assert row.drone["reference_kind"] == FlightReferenceKind.NONE
    assert row.drone["reference_ns"] == 7


def test_what_is_read_from_a_record_is_a_copy():
    row = make_row()
    row.set_reference(FullState(FLAT), 7)
    row.flown = FullState(FLAT)
    found = [row.reference, row.flown]
    row.drone["reference"] = 0.0
    row.drone["flown"] = 0.0
    for full in found:
        assert full.flat.tolist() == FLAT.tolist()


def test_a_flown_full_state_can_be_forgotten():
    row = make_row()
    row.flown = FullState(FLAT)
    row.flown = None
    assert row.flown is None


@pytest.mark.parametrize("learns", [True, False])
def test_the_judge_lets_the_tracker_fly_a_full_state(learns):
    row = make_row()
    row.fly(FullState(FLAT), learns_trim=learns)
    assert row.drone["course"] == Course.READY
    assert row.drone["controller"] == FlightControllerKind.TRACKER
    assert row.drone["wanted"].tolist() == FLAT.tolist()
    assert bool(row.drone["learns_trim"]) is learns
    assert row.flown.flat.tolist() == FLAT.tolist()
