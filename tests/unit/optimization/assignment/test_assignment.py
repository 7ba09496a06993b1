import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from teams import run_team

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.assignment.assignment import (
    Task,
    TaskAssignment,
    TaskTable,
)
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import GraphSequence, erdos_renyi_connected, path, ring


def table(ids, label=1, last=True):
    return TaskTable(label, tuple(Task(k, np.zeros(3)) for k in ids), last)


def team(costs, diameter, tables):
    """Return the assignment algorithm of each robot; each row of `costs` is a robot.

    Column k of `costs` is task k of any table.

    tables: by robot, its first table; a robot that has none here hears of it from others
    """
    return {
        i: TaskAssignment(
            i,
            lambda task, row=row: row[task.id],
            range(len(costs)),
            diameter,
            tables.get(i),
        )
        for i, row in enumerate(costs)
    }


def draw(seed):
    """Costs (N, M), every third table of integers, with many forbidden pairs in most."""
    chance = np.random.default_rng(seed)
    robots, tasks = chance.integers(1, 8), chance.integers(1, 8)
    if seed % 4 == 0:
        tasks = robots
    costs = (
        chance.integers(0, 4, (robots, tasks)).astype(float)
        if seed % 3
        else chance.random((robots, tasks))
    )
    costs[chance.random(costs.shape) < (0.0, 0.5, 0.7)[seed % 3]] = np.inf
    return costs


def served_at_best(costs):
    """How many pairs there can be, and their least cost."""
    rows, columns = linear_sum_assignment(np.where(np.isinf(costs), 1e6, costs))
    chosen = costs[rows, columns]
    return int(np.isfinite(chosen).sum()), float(chosen[np.isfinite(chosen)].sum())


def links(robots, seed):
    """A path, a directed ring, or graphs that are connected together only; with the longest time of a flood."""
    if seed % 5 == 0:
        return GraphSequence.draw(path(robots), 0.3, 3, seed), 3 * (robots - 1)
    graph = path(robots) if seed % 2 or robots == 1 else ring(robots, directed=True)
    return graph, graph.diameter()


SEEDS = [range(k, k + 20) for k in range(0, 200, 20)]


@pytest.mark.parametrize(
    "seeds",
    [*SEEDS[:3], *(pytest.param(seeds, marks=pytest.mark.slow) for seeds in SEEDS[3:])],
    ids=lambda seeds: f"{seeds[0]}-",
)
def test_the_assignment_is_the_central_one(seeds):
    infeasible = 0
    for seed in seeds:
        costs = draw(seed)
        robots, tasks = costs.shape
        graph, diameter = links(robots, seed)
        agents = team(costs, diameter, {seed % robots: table(range(tasks))})
        run_team(agents, graph)
        outcomes = [agent.outcome for agent in agents.values()]
        pairs = {
            i: outcome.task.id for i, outcome in enumerate(outcomes) if outcome.task
        }
        most, least = served_at_best(costs)
        assert len(pairs) == len(set(pairs.values())) == most
        assert sum(costs[i, k] for i, k in pairs.items()) == pytest.approx(least)
        for outcome in outcomes:
            assert outcome.cost == pytest.approx(least)
            assert outcome.unserved == tuple(
                k for k in range(tasks) if k not in pairs.values()
            )
            assert bool(outcome.infeasible) == (most < min(robots, tasks))
        infeasible += most < min(robots, tasks)
    assert infeasible > 1


def test_competing_tasks_are_named_with_the_robots_that_may_do_them():
    costs = np.ones((4, 4))
    costs[1:, 2:] = np.inf
    agents = team(costs, 2, {0: table(range(4))})
    run_team(agents, ring(4))
    why = r"task\(s\) 2, 3 may be done by 1 robot\(s\) only: 0"
    for agent in agents.values():
        assert len(agent.outcome.unserved) == 1
        with pytest.raises(
            SolverError, match=rf"task assignment: table 1.* infeasible: {why}"
        ):
            _ = agent.solution


@pytest.mark.parametrize(
    ("costs", "why"),
    [
        ([[1.0, np.inf], [1.0, np.inf]], "task(s) 1 may be done by no robot"),
        ([[1.0, 2.0, 3.0], [np.inf] * 3], "robot(s) 1 may do no task"),
        (
            [[np.inf, np.inf, 1.0], [np.inf, np.inf, 1.0]],
            "robot(s) 0, 1 may do 1 task(s) only: 2",
        ),
    ],
)
def test_robots_and_tasks_that_stay_unassigned_are_named(costs, why):
    agents = team(np.array(costs), 1, {0: table(range(len(costs[0])))})
    run_team(agents, ring(2))
    assert {agent.outcome.infeasible for agent in agents.values()} == {why}


def test_new_tables_reach_all_and_start_anew():
    """Six robots; a new generation comes while the one before is being worked on, to another robot."""
    chance = np.random.default_rng(5)
    costs, graph = chance.random((6, 30)), erdos_renyi_connected(6, 0.3, seed=3)
    agents = team(costs, graph.diameter(), {0: table(range(6), 1, last=False)})
    generations = {
        3: (4, 2, range(6, 12)),
        40: (2, 3, range(8, 14)),
        80: (5, 4, range(20, 26)),
    }
    agreed = {}
    for k in range(200):
        if k in generations:
            robot, label, ids = generations[k]
            agents[robot].post(table(ids, label, last=label == 4))
        messages = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.step({j: messages[j] for j in graph.in_neighbors(i)})
        settled = [agent.outcome.label for agent in agents.values() if agent.settled]
        if len(settled) == 6 and settled[0] not in agreed:
            assert len(set(settled)) == 1
            agreed[settled[0]] = [agent.outcome.task.id for agent in agents.values()]
        if agents[0].done:
            assert all(agent.done for agent in agents.values())
            break
    assert sorted(agreed) == [2, 3, 4]  # 1 was overtaken
    for label, first in ((2, 6), (3, 8), (4, 20)):
        _, columns = linear_sum_assignment(costs[:, first : first + 6])
        assert agreed[label] == [first + k for k in columns]


def test_an_old_table_is_nothing_new_and_a_second_one_with_a_label_is_refused():
    robot = TaskAssignment(0, lambda task: 1.0, [0], 0, table([1, 2], label=5))
    robot.post(table([7], label=4))
    assert robot.label == 5
    with pytest.raises(
        ConfigError,
        match=r"robot 0: task assignment: table 5: found \[7\]; allowed: tasks \[1, 2\]",
    ):
        robot.post(table([7], label=5))


def test_bad_tables_and_costs_are_refused():
    with pytest.raises(
        ConfigError, match="robot 3: task assignment: cost of task 8: found nan"
    ):
        TaskAssignment(3, lambda task: float("nan"), [3], 0, table([8]))
    with pytest.raises(
        ConfigError,
        match=r"robot 3: task table: found ids \[8, 8\]; allowed: each id once",
    ):
        TaskAssignment(3, lambda task: 1.0, [3], 0, table([8, 8]))
    with pytest.raises(
        ConfigError, match="robot 3: task assignment: found robot 3; allowed: 0 to 2"
    ):
        TaskAssignment(3, lambda task: 1.0, [0, 1, 2], 0)
    with pytest.raises(SolverError, match="not agreed upon yet"):
        _ = TaskAssignment(0, lambda task: 1.0, [0], 0).solution


def test_nothing_to_do_is_agreed_upon_too():
    agents = team(np.ones((3, 1)), 1, {1: table([])})
    run_team(agents, ring(3))
    assert all(
        agent.solution.task is None and agent.solution.cost == 0.0
        for agent in agents.values()
    )


def test_the_assignment_is_the_same_whatever_is_lost():
    costs, graph, outcomes = np.random.default_rng(8).random((5, 5)), ring(5), []
    for loss in (0.0, 0.4):
        agents = team(costs, 2, {3: table(range(5))})
        history = simulate(agents, graph, loss=loss, record=())
        outcomes.append(
            [
                (a.outcome.task.id, a.outcome.cost, a.outcome.rounds)
                for a in agents.values()
            ]
        )
    assert history.lost > 10
    assert outcomes[0] == outcomes[1]
