"""The budget of a team: one end for all robots, more is never worse, and Ctrl-C keeps the best plan."""

from itertools import count, islice, pairwise

import pytest

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.budget import Budget, BudgetSettings
from crazychoir.routing.distributed.clusters import list_anytime_passes
from crazychoir.routing.distributed.member import AnytimeSettings, RoutingSettings
from crazychoir.routing.distributed.plain_loop import make_team, solve_in_loop
from crazychoir.routing.instance.generate import InstanceShape, random_instance

INSTANCE = random_instance(5, 24, 3, InstanceShape(capacities=(3, 7)))
SMALL_PASSES = AnytimeSettings(first_steps=200, steps=400)


def settings(**budget):
    return RoutingSettings(budget=BudgetSettings(**budget), anytime=SMALL_PASSES)


def run_team(graph, number, budget, now=None, stop_round=None):
    """The solutions of all robots; the clock is asked by all, and one robot is interrupted."""
    agents = make_team(INSTANCE, graph("ring", 5), settings=budget)
    for agent in agents.values():
        agent.start_clock(now or (lambda: 0.0))
    for k in range(number):
        if k == stop_round:
            agents[2].interrupt()
        messages = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.step({j: messages[j] for j in graph("ring", 5)[i]})
        done = {agent.done for agent in agents.values()}
        if done == {True}:
            return [agent.solution for agent in agents.values()]
        assert done == {False}, "all robots end in the same round"
    raise AssertionError("no end")


def test_more_work_is_never_worse_and_begins_with_the_same_plans(graph):
    found = [
        solve_in_loop(INSTANCE, graph("ring", 5), settings=settings(work=work))
        for work in (0, 1500, 3000, 6000)
    ]
    costs = [solution.cost for solution in found]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[0]
    for less, more in pairwise(found):
        assert more.work_curve[: len(less.work_curve)] == less.work_curve
    assert [solution.ended_by for solution in found] == ["work"] * 4
    assert found[1].work <= 1500


def test_the_curve_of_costs_falls_and_ends_at_the_plan(graph):
    solution = solve_in_loop(INSTANCE, graph("ring", 5), settings=settings(work=4000))
    costs = [cost for _, cost in solution.work_curve]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == pytest.approx(solution.cost, abs=1e-9)


def test_robots_with_different_clocks_end_in_the_same_round_with_one_plan(graph):
    ticks = count()
    solutions = run_team(
        graph, 400, settings(seconds=300.0), now=lambda: float(next(ticks))
    )
    assert {solution.ended_by for solution in solutions} == {"seconds"}
    assert len({solution.plan_digest for solution in solutions}) == 1


def test_one_interrupted_robot_ends_the_search_of_all_with_a_plan(graph):
    solutions = run_team(graph, 400, settings(seconds=1e9), stop_round=40)
    assert {solution.ended_by for solution in solutions} == {"interrupted"}
    assert len({solution.plan_digest for solution in solutions}) == 1
    assert solutions[0].rounds < 60


def test_an_end_is_known_everywhere_before_its_round():
    far = Budget(BudgetSettings(seconds=1.0), diameter=2)
    near = Budget(BudgetSettings(seconds=1.0), diameter=2)
    far.start_clock(lambda: 0.0)
    near.start_clock(iter([0.0, 5.0, 5.0, 5.0, 5.0]).__next__)
    near.begin_round(3, [])
    far.begin_round(3, [])
    assert near.word() == [5, "seconds"]
    for k in (4, 5):
        far.begin_round(k, [near.word()])
        near.begin_round(k, [far.word()])
        assert far.is_over == near.is_over == (k == 5)


def test_seconds_without_a_clock_are_refused(graph):
    with pytest.raises(ConfigError, match=r"^seconds: found no clock"):
        solve_in_loop(INSTANCE, graph("ring", 5), settings=settings(seconds=1.0))


@pytest.mark.parametrize("budget", [{"seconds": -1.0}, {"work": -1}])
def test_a_negative_budget_is_refused(budget):
    with pytest.raises(ConfigError, match=r"allowed: 0 or more"):
        BudgetSettings(**budget)


def test_the_first_passes_of_a_budget_are_short_and_make_one_part():
    given = AnytimeSettings()
    passes = list(islice(list_anytime_passes(given), given.first_passes + 2))
    early = passes[: given.first_passes]
    assert {one.steps for one in early} == {given.first_steps}
    assert {one.options.rounds for one in early} == {1}
    assert {one.steps for one in passes[given.first_passes :]} == {given.steps}
    assert [one.number for one in passes] == list(range(len(passes)))
