"""The laws of a process step together, and one that fails ends alone."""

from contextlib import nullcontext
from typing import ClassVar

import numpy as np
import pytest
from crazychoir.runtime.tick_stages import TickStages
from virtual_time import virtual

from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import LAW_ROW, LawPermission, start_row
from crazychoir.guidance.decision.law_stage import LawStage
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.runtime.clock import run_virtual
from crazychoir.types import Acceleration, State

TICK = 0.01


class ByHand(CFDistributedFeedback):
    """A law that pushes along x."""

    def __init__(self, push=1.0):
        self.push = push

    def step(self, me, heard):
        return Acceleration(np.array([self.push, 0.0, 0.0]))


class OfTeam(ByHand):
    """The same law for a team; it keeps how often it was prepared."""

    prepared: ClassVar = []

    @classmethod
    def for_team(cls, laws, neighbors):
        cls.prepared.append([law.push for law in laws])
        pushes = np.array([[law.push, 0.0, 0.0] for law in laws])

        def step(team):
            if np.isnan(pushes).any():
                raise ValueError("not a number")
            team.accelerate(pushes)

        return step


class Staged:
    """A law in the stage, without a pilot: it keeps what it was told to fly."""

    def __init__(self, drone, law, permission=LawPermission.STEPS):
        self.drone, self.law, self.permission = drone, law, permission
        self.ids = ()
        self.rows, self.edges = np.zeros(1, LAW_ROW), np.zeros(0, HEARING_ROW)
        self.rows["period_ns"] = 10_000_000
        self.rows["early_ns"] = 5_000_000
        self.rows["sum"]["h"] = TICK
        self.flown, self.errors, self.stopped = [], [], 0
        start_row(self.rows, self.edges, 0)

    def move_to(self, rows, edges):
        rows[:] = self.rows
        self.rows, self.edges = rows, edges

    def look(self, me):
        self.rows["state"] = me.flat
        self.rows["permission"] = self.permission
        self.rows["has_state"] = 1

    def guard(self):
        return nullcontext()

    def step(self, me, heard):
        self.fly(self.law.step(me, heard))

    def fly(self, reference):
        self.flown.append(float(reference.a[0]))

    def stop(self):
        self.stopped += 1

    def fail(self, error):
        self.errors.append(error)
        self.rows["is_running"] = 0
        return True


async def fly(clock, stage, stages, laws, ticks):
    """Let the laws have a new state in each tick."""
    for _ in range(ticks):
        await clock.sleep(TICK)
        for law in laws:
            stage.move(law, State.at((0.0, 0.0, 1.0)))
        stages.run()


@virtual
async def test_laws_of_a_team_and_laws_by_hand_step_once_a_tick(clock):
    stages = TickStages(clock)
    stage = LawStage(stages)
    laws = [
        Staged(5, OfTeam(5.0)),
        Staged(1, ByHand(1.0)),
        Staged(3, OfTeam(3.0)),
        Staged(2, ByHand(2.0)),
    ]
    for law in laws:
        stage.enter(law)
    OfTeam.prepared.clear()
    await fly(clock, stage, stages, laws, 10)
    assert OfTeam.prepared == [[3.0, 5.0]], "once, in the order of the drones"
    for law in laws:
        assert law.flown == 10 * [float(law.drone)]


@virtual
async def test_a_law_that_has_left_does_not_step_and_one_that_enters_does(clock):
    stages = TickStages(clock)
    stage = LawStage(stages)
    first, second = Staged(0, OfTeam(1.0)), Staged(1, OfTeam(2.0))
    stage.enter(first)
    await fly(clock, stage, stages, [first], 2)
    first.rows["is_running"] = 0
    stage.leave(first)
    stage.enter(second)
    await fly(clock, stage, stages, [first, second], 3)
    assert (len(first.flown), len(second.flown)) == (2, 3)


@virtual
async def test_numbers_that_have_changed_are_prepared_again(clock):
    stages = TickStages(clock)
    stage = LawStage(stages)
    law = Staged(0, OfTeam(1.0))
    stage.enter(law)
    await fly(clock, stage, stages, [law], 1)
    law.law.push = 2.0
    stage.renew()
    await fly(clock, stage, stages, [law], 1)
    assert law.flown == [1.0, 2.0]
    assert law.rows["tally"]["steps"] == 2, "its counts have moved with it"


@pytest.mark.parametrize(
    ("permission", "flown", "stopped"),
    [
        (LawPermission.STEPS, 3, 0),
        (LawPermission.WAITS, 0, 0),
        (LawPermission.ENDS, 0, 3),
    ],
)
def test_the_pilot_decides_whether_a_law_steps(permission, flown, stopped):
    async def steps(clock):
        stages = TickStages(clock)
        stage = LawStage(stages)
        law = Staged(0, OfTeam(1.0), permission)
        stage.enter(law)
        await fly(clock, stage, stages, [law], 3)
        assert (len(law.flown), law.stopped) == (flown, stopped)

    run_virtual(steps)


@virtual
async def test_an_error_of_a_team_ends_its_laws_and_no_others(clock):
    stages = TickStages(clock)
    stage = LawStage(stages)
    laws = [
        Staged(0, OfTeam(1.0)),
        Staged(1, OfTeam(float("nan"))),
        Staged(2, ByHand(1.0)),
    ]
    for law in laws:
        stage.enter(law)
    await fly(clock, stage, stages, laws, 3)
    assert [len(law.errors) for law in laws] == [1, 1, 0]
    assert [len(law.flown) for law in laws] == [0, 0, 3]


@virtual
async def test_a_team_that_cannot_be_prepared_ends_its_laws(clock):
    class Broken(OfTeam):
        """A law whose team fails at once."""

        @classmethod
        def for_team(cls, laws, neighbors):
            raise ValueError("no numbers")

    stages = TickStages(clock)
    stage = LawStage(stages)
    laws = [Staged(0, Broken()), Staged(1, ByHand())]
    for law in laws:
        stage.enter(law)
    await fly(clock, stage, stages, laws, 2)
    assert [len(law.errors) for law in laws] == [1, 0]
    assert [len(law.flown) for law in laws] == [0, 2]
