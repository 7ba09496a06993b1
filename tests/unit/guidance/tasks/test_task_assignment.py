"""The task-assignment mission: where tasks may be, and when a task is completed."""

from types import SimpleNamespace

import numpy as np
import pytest
from pilots import make_stand_in

from crazychoir.guidance.member import Interrupted
from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.tasks.task_assignment import (
    TaskAssignmentGuidance,
    TaskRoom,
    TeamAssignment,
)
from crazychoir.guidance.tasks.task_book import Deed, Record, Task, TaskBook
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import State

MISSION = load_mission("task_assignment")
CONFIG = MISSION.swarm(None)


def test_operators_may_add_only_tasks_inside_the_fence_for_known_drones():
    room = TaskRoom(CONFIG)
    inside, outside = (3.9, -3.9), (0.0, 4.0)
    assert room.explain_bad_place(Task(0, 0, False, inside, inside), inside) == ""
    assert "outside the fence" in room.explain_bad_place(
        Task(0, 0, False, outside, outside), outside
    )
    assert "there is no drone 7" in room.explain_unservable(
        Task(0, 0, False, inside, inside, robots=(1, 7))
    )
    assert (
        room.explain_wait(Task(0, 0, False, inside, inside, robots=(1, 2)), (2, 3))
        == ""
    )
    assert "drone 1 " in room.explain_wait(
        Task(0, 0, False, inside, inside, robots=(1,)), (2, 3)
    ).replace(",", " ")


def test_while_the_team_plans_nothing_is_completed():
    """The task may belong to another robot after the planning."""
    said = []
    guidance = TaskAssignmentGuidance(TeamAssignment(lambda count: [], 1))
    pilot = make_stand_in(
        {
            "mode": Mode.HOVER,
            "state": State.at((1.0, 1.02, 0.5)),
            "follow": lambda reference: True,
            "notes.text": "",
        }
    )
    guidance.member = SimpleNamespace(pilot=pilot, config=CONFIG, id=0, ended="")
    book, record = (
        TaskBook([Task(3, 0, False, (1.0, 1.0), (1.0, 1.0))]),
        Record(0, 1, 1, (0.0, 0.0)),
    )
    guidance.news = SimpleNamespace(
        book=book,
        members=CONFIG.ids,
        record=record,
        ended=False,
        say=lambda **changes: said.append(changes),
    )
    guidance.generation, guidance._turns = (
        SimpleNamespace(mine=3, number=7),
        SimpleNamespace(to=lambda p: p),
    )
    guidance._shares = True
    guidance._pursue()
    assert (guidance.done, said) == ([], [])
    assert np.allclose(guidance.route(), [guidance.above((1.0, 1.0))])
    guidance._shares = False
    guidance._pursue()
    assert guidance.done == [(3, 7)]
    assert said == [{"deeds": (Deed(3, "delivery", 1),)}]
    guidance.news.ended = True
    assert np.allclose(guidance.route(), [guidance.above(CONFIG.drone(0).home)])
    pilot.mode = Mode.LAND
    assert guidance.route() == []
    pilot.notes.text = "landing on command"
    with pytest.raises(Interrupted, match="landing on command"):
        guidance._pursue()
