"""The tick of a process: its stages in their order, for the drones that are due."""

import asyncio
import contextlib

import numpy as np
import pytest
from pilots import make_pilot
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.tables import CollisionTable, FlightTable
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.flight.batch import Course
from crazychoir.flight.tick import FlightTick
from crazychoir.runtime.mailbox import DropOldest
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.rules.guard import Fence
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Pose

PERIOD = 0.01  # s, of the poses of a pilot in these tests
FENCE = Fence.box((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5))
POSE = Pose(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]))
PAUSE = 1e-4
"""Seconds in which the passes of the loop are over."""


class FailingFilter(VelocityFilter):
    """A filter of a user that raises."""

    def update(self, pose, now):
        raise ValueError("estimate")


class Process:
    """Drones that hover in one process, and a diary of what happens: (what, index of the drone).

    clock: of the process
    count: number of drones
    fails_in: where drone 0 fails; empty for nowhere
    """

    def __init__(self, clock, count=2, fails_in=""):
        self.diary = []
        self.fails_in = fails_in
        bus = Bus(clock)
        self.tick = FlightTick(bus, count)
        self.tick.deciders.append(lambda now_ns: self.note("decide", -1))
        self.pilots = [self.add(bus.port(k), k) for k in range(count)]

    def add(self, port, k):
        """Return the pilot of drone k; an observer reads the states of the drone."""
        observer = DropOldest(port.bus.clock, "observer", 8)
        port.bus.subscribe(DRONE_TOPICS.state, k, k, observer)
        publish = port.publish

        def publish_and_note(topic, value, *age):
            if topic is DRONE_TOPICS.state:
                self.note("publish", k)
            publish(topic, value, *age)

        port.publish = publish_and_note
        fails = k == 0 and self.fails_in == "estimate"
        pilot = make_pilot(
            port,
            Link(self, k),
            FlightTable(),
            FENCE,
            state_filter=FailingFilter() if fails else VelocityFilter(),
            shared=self.tick,
        )
        pilot.row.mode = Mode.HOVER
        decide = pilot.judge.decide

        def decide_and_note(state, now):
            self.note("judge", k)
            decide(state, now)

        pilot.judge.decide = decide_and_note
        return pilot

    def note(self, what, k):
        """Write into the diary; drone 0 may fail here."""
        self.diary.append((what, k))
        if k == 0 and what == self.fails_in:
            raise ValueError(what)

    def list_events(self, k):
        """Return what has happened to drone k."""
        return [what for what, index in self.diary if index == k]

    @contextlib.asynccontextmanager
    async def running(self):
        """Let the actors of the pilots run."""
        runs = [asyncio.create_task(pilot.run()) for pilot in self.pilots]
        await asyncio.sleep(0.0)
        yield runs
        for run in runs:
            run.cancel()
        await asyncio.gather(*runs, return_exceptions=True)


class Link:
    """A link that writes commands into the diary of a process."""

    def __init__(self, process, k):
        self.process = process
        self.k = k
        self.commands = 0

    def send(self, command):
        """Note the first command of a tick; later ones steady a failed drone."""
        self.commands += 1
        self.process.note("command", self.k)

    def cut(self):
        """Do nothing."""


@virtual
async def test_each_stage_ends_for_all_drones_before_the_next_one_begins(clock):
    process = Process(clock)
    async with process.running():
        for k in (1, 0):
            process.tick.see(k, POSE)
        await clock.sleep(PAUSE)
    assert process.diary == [
        ("publish", 0),
        ("publish", 1),
        ("decide", -1),
        ("judge", 0),
        ("judge", 1),
        ("command", 0),
        ("command", 1),
    ]


@virtual
async def test_only_the_drones_that_are_due_tick(clock):
    process = Process(clock, count=3)
    async with process.running():
        process.tick.see(1, POSE)
        await clock.sleep(PAUSE)
    assert {index for _, index in process.diary} == {-1, 1}


@virtual
async def test_a_drone_asks_for_states_in_a_pass_in_which_others_tick(clock):
    """The distances of all drones are checked in the pass of any of them."""
    process = Process(clock)
    tick = process.tick
    tick.airspace = Airspace(
        process.pilots[0].port.bus, range(2), AirspaceRules(CollisionTable(), 1.0, 0.0)
    )
    for pilot in process.pilots:
        pilot.stages.seek = lambda k=pilot.row.index: process.note("seek", k)
    tick.batch.drones["ticks"] = (1, 0)
    tick.batch.drones["is_running"] = 1
    tick.batch.drones["course"] = Course.FOLLOW
    tick._avoid(np.array([1]), 0.0)
    tick.batch.drones["course"] = Course.NOTHING
    tick._avoid(np.array([1]), 0.0)
    tick.batch.drones["course"] = Course.FOLLOW
    tick.batch.drones["is_running"] = 0
    tick._avoid(np.array([1]), 0.0)
    assert process.diary == [("seek", 1)]


@virtual
async def test_the_state_of_a_drone_that_ticks_no_more_grows_old(clock):
    process = Process(clock, 1)
    latched = process.pilots[0].port.latched
    async with process.running():
        process.pilots[0].see(POSE)
        await clock.sleep(PAUSE)
    _, young = latched.find(DRONE_TOPICS.state, clock.now_ns())
    await clock.sleep(5.0)
    _, old = latched.find(DRONE_TOPICS.state, clock.now_ns())
    assert young < PERIOD
    assert old == pytest.approx(young + 5.0)


@virtual
async def test_a_quiet_drone_is_commanded_without_its_judge(clock):
    process = Process(clock, count=1)
    async with process.running():
        for _ in range(2):
            process.diary.clear()
            process.tick.see(0, POSE)
            await clock.sleep(PERIOD)
    assert process.list_events(0) == ["publish", "command"]


@virtual
async def test_a_pose_is_not_lost_for_a_tick_without_one_in_the_same_pass(clock):
    process = Process(clock, count=1)
    async with process.running():
        for pose in (None, POSE, None):
            process.tick.see(0, pose)
        await clock.sleep(PAUSE)
    assert process.list_events(0) == ["publish", "judge", "command"]


@virtual
async def test_a_drone_that_was_never_seen_does_nothing(clock):
    process = Process(clock, count=1)
    async with process.running():
        process.tick.see(0, None)
        await clock.sleep(PAUSE)
    assert process.list_events(0) == []


@pytest.mark.parametrize(
    ("stage", "done"),
    [
        ("estimate", []),
        ("publish", ["publish"]),
        ("judge", ["publish", "judge"]),
        ("command", ["publish", "judge", "command"]),
    ],
)
def test_an_error_of_one_drone_ends_its_tick_and_no_other(stage, done):
    @virtual
    async def check(clock):
        process = Process(clock, fails_in=stage)
        async with process.running() as runs:
            for k in range(2):
                process.tick.see(k, POSE)
            await clock.sleep(PAUSE)
            steadying = ["command"]
            assert process.list_events(0) == done + steadying
            assert process.list_events(1) == ["publish", "judge", "command"]
            assert str(runs[0].exception()) == stage
            assert not runs[1].done()

    check()


@pytest.mark.parametrize("stage", ["estimate", "publish", "judge", "command"])
def test_an_error_after_the_end_of_a_run_is_logged_and_the_others_tick(stage, caplog):
    @virtual
    async def check(clock):
        process = Process(clock, fails_in=stage)
        async with process.running() as runs:
            runs[0].cancel()
            await asyncio.sleep(0.0)
            for k in range(2):
                process.tick.see(k, POSE)
            await clock.sleep(PAUSE)
            assert process.list_events(1) == ["publish", "judge", "command"]
            assert process.tick.batch.drones["ticks"].tolist() == [0, 0]

    check()
    assert f"ValueError: {stage}, after its run has ended" in caplog.text


@virtual
async def test_a_drone_does_not_tick_after_its_run_was_cancelled(clock):
    process = Process(clock)
    async with process.running() as runs:
        process.tick.batch.drones["ticks"] = 1
        runs[0].cancel()
        await asyncio.wait([runs[0]])
        assert process.tick.batch.drones["ticks"].tolist() == [0, 1]


@virtual
async def test_an_error_in_a_stage_for_all_leaves_no_pose_for_the_next_tick(clock):
    process = Process(clock)

    def fail(now_ns):
        raise ValueError("decide")

    process.tick.deciders.append(fail)
    async with process.running():
        process.tick.batch.drones["ticks"] = 1
        process.tick.batch.filters.rows["has_pose"] = 1
        with pytest.raises(ValueError, match="decide"):
            process.tick.run()
    assert process.tick.batch.drones["ticks"].tolist() == [0, 0]
    assert process.tick.batch.filters.rows["has_pose"].tolist() == [0, 0]


@virtual
async def test_a_drone_ticks_by_the_clock_after_one_and_a_half_periods(clock):
    process = Process(clock)
    diary = process.diary
    async with process.running() as runs:
        for k in range(2):
            process.tick.see(k, POSE)
        await clock.sleep(1.4 * PERIOD)
        diary.clear()
        process.tick.tick_late_drones()
        await clock.sleep(PAUSE)
        assert diary == []
        process.tick.see(0, POSE)
        await clock.sleep(0.2 * PERIOD)
        diary.clear()
        process.tick.tick_late_drones()
        await clock.sleep(PAUSE)
        assert process.list_events(1) == ["publish", "command"]
        assert process.list_events(0) == [], "it has ticked in time"
        runs[1].cancel()
        await clock.sleep(2.0 * PERIOD)
        diary.clear()
        process.tick.tick_late_drones()
        await clock.sleep(PAUSE)
        assert process.list_events(1) == [], "it does not run"
        assert process.list_events(0) == ["publish", "command"]
