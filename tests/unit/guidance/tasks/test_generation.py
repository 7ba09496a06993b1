"""One generation of a table, in rounds without a network."""

from itertools import permutations
from math import dist, inf

import numpy as np
import pytest
from teams import run_team

from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.tasks.assignment_report import compute_optimum
from crazychoir.guidance.tasks.generation import (
    NextGeneration,
    TableProgress,
    list_open_tasks,
)
from crazychoir.guidance.tasks.task_book import Deed, Record, Task, TaskBook
from crazychoir.optimization.assignment.assignment import AssignmentOutcome
from crazychoir.team.graph import Graph

MISSION = load_mission("task_assignment")
CONFIG = MISSION.swarm(None)
GRAPH = CONFIG.graph()


def away(i, p, task):
    return dist(p, task.pickup)


def generation(
    books=None, number=None, filled=0, most=8, graph=GRAPH, seed=4, cost=away
):
    """The next generation of robots at their homes; books, number: {robot: value}."""
    config = CONFIG.replace(seed=seed)
    at = {i: config.drone(i).home[:2] for i in config.ids}
    programs = {
        i: NextGeneration(
            i,
            graph,
            (books or {}).get(i, TaskBook()),
            TableProgress((number or {}).get(i, 0), filled),
            lambda count: MISSION.hooks.drawn(config, count),
            most,
            lambda task, i=i: cost(i, at[i], task),
        )
        for i in graph.ids
    }
    run_team(programs, graph)
    return {i: program.result for i, program in programs.items()}


def cheapest(rows):
    """m, over all permutations."""
    rows = np.array(rows)
    return min(
        sum(rows[i, k] for i, k in enumerate(order))
        for order in permutations(range(len(rows)))
    )


def test_the_first_table_of_the_original_has_its_optimum():
    """The table has the six tasks that numpy's legacy generator draws with seed 4."""
    found = generation()
    first = found[0]
    assert [np.round(task.pickup, 3).tolist() for task in first.tasks] == [
        [2.802, 0.283],
        [-1.482, -0.391],
        [-2.946, -0.681],
        [-1.961, -2.55],
        [0.13, -2.351],
        [-0.619, 0.743],
    ]
    assert {i: one.mine for i, one in found.items()} == {
        0: 2,
        1: 1,
        2: 5,
        3: 3,
        4: 4,
        5: 0,
    }
    assert first.outcome.cost == pytest.approx(12.049, abs=1e-3)
    assert first.outcome.cost == pytest.approx(
        cheapest([one.costs for one in found.values()])
    )
    assert {
        (one.number, one.filled, one.outcome.infeasible) for one in found.values()
    } == {(1, 1, "")}
    assert all(
        one.costs[task.id] == inf
        for i, one in found.items()
        for task in one.tasks
        if i not in task.robots
    )


@pytest.mark.parametrize("seed", range(6))
def test_all_have_the_same_generation_and_it_is_the_cheapest(seed):
    found = generation(seed=seed)
    first = found[0].outcome
    assert {
        (one.outcome.cost, one.outcome.unserved, one.outcome.infeasible)
        for one in found.values()
    } == {(first.cost, first.unserved, first.infeasible)}
    mine = [one.mine for one in found.values() if one.mine is not None]
    assert len(dict.fromkeys(mine)) == len(mine) == 6 - len(first.unserved)
    optimum = compute_optimum(np.array([one.costs for one in found.values()]))
    assert first.cost == pytest.approx(optimum)


def test_what_one_robot_knows_counts_for_all():
    """Robot 2 has done task 5, robot 0 was part of generation 7: the table is filled up with a seventh task."""
    tasks = MISSION.hooks.drawn(CONFIG, 6)
    done = TaskBook(
        tasks, [Record(2, 1, 3, (0.0, 0.0), deeds=(Deed(5, "delivery", 1),))]
    )
    books = {i: TaskBook(tasks) for i in GRAPH.ids} | {2: done}
    found = generation(books, number={0: 7}, filled=1)
    for one in found.values():
        assert (one.number, one.filled) == (8, 2)
        assert [task.id for task in one.tasks] == [0, 1, 2, 3, 4, 6]
        assert one.tasks[-1] == MISSION.hooks.drawn(CONFIG, 7)[6]
        assert one.dropped == {}


def test_a_table_is_filled_up_only_so_often():
    tasks = MISSION.hooks.drawn(CONFIG, 6)
    done = [
        Record(i, 1, 3, (0.0, 0.0), deeds=(Deed(i, "delivery", 1),)) for i in range(4)
    ]
    found = generation({i: TaskBook(tasks, done) for i in GRAPH.ids}, filled=8)
    assert {tuple(task.id for task in one.tasks) for one in found.values()} == {(4, 5)}
    assert sum(one.mine is not None for one in found.values()) == 2
    done = [
        Record(i, 1, 3, (0.0, 0.0), deeds=(Deed(i, "delivery", 1),)) for i in range(6)
    ]
    found = generation({i: TaskBook(tasks, done) for i in GRAPH.ids}, filled=8)
    assert all(
        one.idle and one.outcome == AssignmentOutcome(1, None, 0.0, (), "", 0)
        for one in found.values()
    )


def test_robots_that_compete_for_tasks_are_named_and_the_others_are_served():
    def only(j, *robots):
        return Task(j, 0, False, (float(j), 0.0), (float(j), 0.0), robots=robots)

    rows = [
        only(0, 0),
        only(1, 0),
        only(2, 1, 2),
        only(3, 1, 2, 3),
        only(4, 4, 5),
        only(5, 1 << 62),
    ]
    found = generation({0: TaskBook(rows)}, filled=8)
    first = found[0].outcome
    assert first.infeasible.startswith(
        "task(s) 0, 1, 5 may be done by 1 robot(s) only: 0"
    )
    assert len(first.unserved) == 2
    assert 5 in first.unserved
    assert sum(one.mine is not None for one in found.values()) == 4


def test_any_cost_is_accepted_and_an_infinite_one_excludes_the_robot():
    """Robot 0 can do no task. A task costs each other robot the number of the task."""
    tasks = [Task(j, 0, False, (0.0, 0.0), (0.0, 0.0)) for j in range(4)]
    found = generation(
        {1: TaskBook(tasks)},
        filled=8,
        cost=lambda i, p, task: float(task.id) if i else inf,
    )
    assert found[0].mine is None
    assert sorted(one.mine for one in found.values() if one.mine is not None) == [
        0,
        1,
        2,
        3,
    ]
    assert (found[0].outcome.cost, found[0].outcome.infeasible) == (6.0, "")


def test_a_generation_says_how_far_its_robot_has_followed_the_table():
    found = generation(number={2: 4}, filled=3)[0]
    assert found.progress == TableProgress(number=5, filled=4)


def test_a_robot_alone_goes_on():
    alone = Graph.from_edges((3,), [])
    found = generation(
        {3: TaskBook(MISSION.hooks.drawn(CONFIG, 6))}, filled=8, graph=alone
    )[3]
    costs = {task.id: cost for task, cost in zip(found.tasks, found.costs, strict=True)}
    assert found.mine == min(costs, key=costs.get)
    assert len(found.outcome.unserved) == 5


def test_what_is_no_book_is_dropped_by_all():
    program = NextGeneration(
        0,
        Graph.from_edges((0, 1), [[0, 1]]),
        TaskBook(),
        TableProgress(0, 8),
        list,
        8,
        lambda task: 0.0,
    )
    for said in (
        None,
        [b"", 1],
        [b"\x93", 1, 1],
        [b"\x92\x90\x90", -1, 0],
        [b"\x92\x90\x90", 1, "x"],
    ):
        program = NextGeneration(
            0,
            Graph.from_edges((0, 1), [[0, 1]]),
            TaskBook(),
            TableProgress(3, 8),
            lambda count: [],
            8,
            lambda task: 0.0,
        )
        program.step({1: [[1, said]]})
        assert program.done, "no tasks"
        assert list(program.result.dropped) == [1]
        assert program.result.number == 4


def test_open_are_tasks_that_are_neither_done_nor_cancelled():
    tasks = MISSION.hooks.drawn(CONFIG, 3)
    book = TaskBook(
        tasks, [Record(0, 1, 1, (0.0, 0.0), deeds=(Deed(1, "delivery", 1),))]
    )
    book.cancel(2)
    assert [task.id for task in list_open_tasks(book, (0, 1))] == [0]
