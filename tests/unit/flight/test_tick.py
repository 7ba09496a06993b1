"""The tick of a process: its stages in their order, for the drones that are due."""

import math

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.flight.batch import Course
from crazychoir.flight.setup import FlightSetup
from crazychoir.flight.tick import FlightTick
from crazychoir.types import Pose, State

PERIOD = 0.01
POSE = Pose(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]))
STAGES = ("estimate", "publish_state", "judge", "avoid", "command")


class Noting:
    """The Python parts of a drone that write their calls into a diary.

    row: of the drone
    diary: receives (stage, index)
    fails_in: the stage that raises, if any
    """

    def __init__(self, row, diary, fails_in=""):
        FlightSetup().make_guard(row)
        self.row = row
        self.diary = diary
        self.fails_in = fails_in
        self.is_running = True
        self.errors = []
        row.drone["is_by_hand"] = 1
        row.drone["avoids"] = 1

    def note(self, stage):
        self.diary.append((stage, self.row.index))
        if stage == self.fails_in:
            raise ValueError(stage)

    def estimate(self, pose, now):
        self.note("estimate")
        return None if pose is None else State.at(pose.p)

    def publish_state(self):
        self.note("publish_state")

    def judge(self, now):
        self.note("judge")
        self.row.drone["course"] = Course.FOLLOW

    def avoid(self, now):
        self.note("avoid")

    def command(self, now):
        self.note("command")

    def fail(self, error):
        self.errors.append(str(error))


def make_tick(clock, count=2, fails_in=""):
    """Return a tick, its drones and their diary; drone 0 fails in a stage."""
    tick = FlightTick(clock, count)
    diary = []
    drones = []
    for k in range(count):
        row = tick.batch.add()
        drones.append(Noting(row, diary, fails_in if k == 0 else ""))
        tick.add(drones[k], k, PERIOD)
    return tick, drones, diary


@virtual
async def test_each_stage_ends_for_all_drones_before_the_next_one_begins(clock):
    tick, _, diary = make_tick(clock)
    tick.deciders.append(lambda: diary.append(("decide", -1)))
    for k in (1, 0):
        tick.see(k, POSE)
    await clock.sleep(0.0)
    assert diary == [
        ("estimate", 1),
        ("estimate", 0),
        ("publish_state", 1),
        ("publish_state", 0),
        ("decide", -1),
        ("judge", 0),
        ("judge", 1),
        ("avoid", 1),
        ("avoid", 0),
        ("command", 1),
        ("command", 0),
    ]


@virtual
async def test_only_the_drones_that_are_due_tick(clock):
    tick, _, diary = make_tick(clock, count=3)
    tick.see(1, POSE)
    await clock.sleep(0.0)
    assert {index for _, index in diary} == {1}
    assert tick.batch.drones["ticks"].tolist() == [0, 1, 0]


@virtual
async def test_a_pose_is_not_lost_for_a_tick_without_one_in_the_same_pass(clock):
    tick, _, diary = make_tick(clock, count=1)
    tick.see(0, None)
    tick.see(0, POSE)
    tick.see(0, None)
    await clock.sleep(0.0)
    assert diary.count(("estimate", 0)) == 1
    assert tick.batch.drones["is_known"][0] == 1


@virtual
async def test_a_drone_that_was_never_seen_is_neither_judged_nor_commanded(clock):
    tick, _, diary = make_tick(clock, count=1)
    tick.see(0, None)
    await clock.sleep(0.0)
    assert [stage for stage, _ in diary] == ["estimate"]


@virtual
async def test_the_state_of_a_tick_is_in_the_record_with_the_last_command(clock):
    tick, _, _ = make_tick(clock, count=1)
    tick.batch.drones["commanded"][0] = (1.0, 2.0, 3.0)
    tick.see(0, POSE)
    await clock.sleep(0.0)
    record = tick.batch.drones[0]
    assert record["state"][:3].tolist() == [0.0, 0.0, 1.0]
    assert record["acceleration"].tolist() == [1.0, 2.0, 3.0]
    assert record["ticked_ns"] == clock.now_ns()


@pytest.mark.parametrize("stage", STAGES)
def test_an_error_of_one_drone_ends_its_tick_and_no_other(stage):
    @virtual
    async def check(clock):
        tick, drones, diary = make_tick(clock, fails_in=stage)
        for k in range(2):
            tick.see(k, POSE)
        await clock.sleep(0.0)
        assert drones[0].errors == [stage]
        assert drones[1].errors == []
        for k, done in ((0, STAGES[: STAGES.index(stage) + 1]), (1, STAGES)):
            assert tuple(name for name, index in diary if index == k) == done

    check()


@virtual
async def test_a_drone_ticks_by_the_clock_after_one_and_a_half_periods(clock):
    tick, drones, diary = make_tick(clock)
    for k in range(2):
        tick.see(k, POSE)
    await clock.sleep(0.0)
    diary.clear()
    await clock.sleep(1.4 * PERIOD)
    tick.tick_late_drones()
    await clock.sleep(0.0)
    assert diary == []
    tick.see(0, POSE)
    drones[1].is_running = False
    await clock.sleep(0.2 * PERIOD)
    diary.clear()
    tick.tick_late_drones()
    await clock.sleep(0.0)
    assert diary == [], "drone 0 has ticked, and drone 1 does not run"
    drones[1].is_running = True
    tick.tick_late_drones()
    await clock.sleep(0.0)
    assert {index for _, index in diary} == {1}


@virtual
async def test_a_drone_that_is_cut_off_on_the_ground_is_judged_anew_in_its_next_flight(
    clock,
):
    tick, drones, _ = make_tick(clock, count=1)
    drones[0].row.drone["is_by_hand"] = 0
    drones[0].row.drone["cut_off_since"] = 0.0
    tick.see(0, POSE)
    await clock.sleep(0.0)
    assert drones[0].row.drone["cut_off_since"] == math.inf
