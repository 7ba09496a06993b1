"""The task assignment: its tasks, what is refused before the flight, and what its report sees."""

import copy

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.tasks.assignment_report import compute_gap

MISSION = load_mission("task_assignment")
CONFIG = MISSION.swarm(None)


def test_tasks_are_those_of_the_seed_however_many_are_drawn():
    many = MISSION.hooks.drawn(CONFIG, 40)
    assert MISSION.hooks.drawn(CONFIG, 7) == many[:7]
    assert [task.id for task in many] == list(range(40))
    assert all(abs(x) <= 3.0 for task in many for x in task.pickup)
    assert MISSION.hooks.drawn(CONFIG.replace(seed=5), 1) != many[:1]
    may = np.mean([i in task.robots for task in many for i in CONFIG.ids])
    assert 0.4 < may < 0.6
    unservable = MISSION.hooks.drawn(
        CONFIG.replace(mission_options={"chance": 0.0}), 1
    )[0]
    assert not any(i in unservable.robots for i in CONFIG.ids)
    assert unservable.robots, "an empty list would mean all"
    assert not MISSION.hooks.may_be_done(
        CONFIG.replace(mission_options={"chance": 0.0}), 0
    )


def test_the_missions_own_swarms_may_fly():
    assert MISSION.check(CONFIG, False) == []
    assert MISSION.check(MISSION.swarm(9), False) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"mission_options": {"generation": 3}}, "generation.*generations"),
        ({"mission_options": {"chance": 1.5}}, r"chance.*0 to 1"),
        ({"fence": {"min": [-2.0, -4.0, 0.0]}}, "square from -3 to 3 m"),
        (
            {
                "edges": [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 0]],
                "directed": True,
            },
            "undirected",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused(changes, said):
    with pytest.raises(ConfigError, match=said):
        MISSION.check(CONFIG.replace(**changes), False)


def results():
    """Two robots that have done two of three tasks in one generation; no robot may do the third."""
    table = {
        "number": 1,
        "filled": 1,
        "team": [0, 1],
        "tasks": [0, 1, 2],
        "places": [[0.0, 0.0]] * 3,
        "cost": 3.0,
        "infeasible": "task(s) 2 may be done by no robot",
        "unserved": [2],
        "rounds": 9,
        "seconds": 0,
    }
    return {
        i: {
            "success": True,
            "done": [[i, 1]],
            "open": [2],
            "tables": [
                {**table, "costs": [[1.0, 5.0, None], [4.0, 2.0, None]][i], "mine": i}
            ],
        }
        for i in (0, 1)
    }


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: None, ""),
        (lambda r: r[1]["done"].append([0, 1]), "task 0: done twice"),
        (
            lambda r: r[0]["tables"][0].update(cost=3.001),
            "generation 1: 3.001 m, 3.0 m is possible",
        ),
        (lambda r: r[0]["tables"][0]["costs"].__setitem__(0, 0.1), "m is possible"),
    ],
)
def test_a_report_finds_what_is_wrong(change, said):
    config = CONFIG.replace(mission_options={"chance": 0.0})  # no robot may do task 2
    found = copy.deepcopy(results())
    change(found)
    report = MISSION.report(config, found)
    assert said in report["reasons"].get(0, "")
    assert bool(report["reasons"]) == bool(said)
    assert report["success"] == (said == "")
    if not said:
        assert report["tables"][0]["optimum"] == 3.0
        assert report["served_by_generation"] == [2]
        assert report["left"] == {2: "task(s) 2 may be done by no robot"}
        assert not MISSION.report(CONFIG, found)["success"], "a robot may do it"


def test_costs_that_left_with_a_lost_robot_are_not_compared():
    found = results()
    del found[1]
    table = MISSION.report(CONFIG.replace(mission_options={"chance": 0.0}), found)[
        "tables"
    ][0]
    assert (table["optimum"], compute_gap(table)) == (None, 0.0)
