from itertools import product
from types import SimpleNamespace

import highspy
import numpy as np
import pytest

from crazychoir.errors import SolverError
from crazychoir.routing.distributed import master
from crazychoir.routing.distributed.master import (
    ColumnPool,
    Master,
    PartitionProblem,
    PartitionResult,
    find_partition,
)
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.pricing.route_table import RouteColumn, RouteTable


@pytest.fixture
def columns():
    """All columns of three robots."""
    instance = random_instance(
        3, 4, seed=8, shape=InstanceShape(capable=0.7, route_length_limit=40.0)
    )
    tables = [RouteTable(instance.local(i).vehicle) for i in range(3)]
    return [
        (i, tables[i].column(c)) for i in range(3) for c in range(1, len(tables[i]))
    ]


def cheapest_exact_cover(columns):
    own = [[None] + [c for i, c in columns if i == robot] for robot in range(3)]
    covers = (
        choice
        for choice in product(*own)
        if sorted(j for c in choice if c for j in c.tasks) == [0, 1, 2, 3]
    )
    return min(sum(c.length for c in choice if c) for choice in covers)


def test_the_partition_is_the_cheapest_exact_cover(columns):
    found = find_partition(PartitionProblem(columns, 4), seed=0, nodes=1000)
    assert found.cost == pytest.approx(cheapest_exact_cover(columns))
    assert found.bound == pytest.approx(found.cost)
    assert sorted(j for tasks in found.routes.values() for j in tasks) == [0, 1, 2, 3]


@pytest.mark.parametrize("nodes", [0, 1, 1000])
def test_a_plan_that_is_not_the_cheapest_is_not_said_to_be_proven(nodes):
    random = np.random.default_rng(6)
    alone = [(j, RouteColumn(3.0, (j,))) for j in range(18)]
    together = [
        (
            int(random.integers(18)),
            RouteColumn(
                float(random.uniform(3.0, 4.0)),
                tuple(sorted(random.choice(18, 3, replace=False).tolist())),
            ),
        )
        for _ in range(200)
    ]
    problem = PartitionProblem(alone + together, 18)
    best = find_partition(problem, seed=0, nodes=100_000)
    assert best.bound == pytest.approx(best.cost)
    found = find_partition(
        problem, seed=0, nodes=nodes, known={j: (j,) for j in range(18)}
    )
    assert found.bound <= best.cost + 1e-6
    assert best.cost <= found.cost + 1e-6
    if nodes == 0:
        assert found.cost == pytest.approx(54.0)
        assert found.bound < found.cost - 1.0


def test_the_relaxation_is_below_and_its_prices_are_dual_feasible(columns):
    pool = ColumnPool(4)
    for robot, column in columns:
        pool.add(robot, [column])
    relaxed = pool.relax(np.full(4, 100.0))
    assert relaxed.value <= cheapest_exact_cover(columns) + 1e-6
    least = [
        min(
            0.0,
            *(
                c.length - relaxed.prices[list(c.tasks)].sum()
                for i, c in columns
                if i == r
            ),
        )
        for r in range(3)
    ]
    assert relaxed.prices.sum() + sum(least) == pytest.approx(relaxed.value)


def test_robots_that_are_the_same_share_a_row(columns):
    """As if each had the columns of the first, and the relaxation too."""
    own, penalty = [c for i, c in columns if i == 1], np.full(4, 100.0)
    apart = [(i, c) for i in (1, 5, 6) for c in own]
    together = [(1, c) for c in own]
    each, all_ = (
        find_partition(PartitionProblem(apart, 4), 0, 1000),
        find_partition(PartitionProblem(together, 4, {1: (1, 5, 6)}), 0, 1000),
    )
    assert all_.cost == pytest.approx(each.cost)
    assert all_.bound == pytest.approx(each.cost)
    assert set(all_.routes) <= {1, 5, 6}
    assert sorted(j for tasks in all_.routes.values() for j in tasks) == [0, 1, 2, 3]
    assert find_partition(
        PartitionProblem(together, 4, {1: (1, 5, 6)}), 0, 1000, known=each.routes
    ).cost == pytest.approx(each.cost)
    one, many = Master(penalty, number={1: 3}), Master(penalty)
    one.add(1, own)
    for i in (1, 5, 6):
        many.add(i, own)
    assert one.relax().value == pytest.approx(many.relax().value)
    assert (
        find_partition(PartitionProblem(together, 4, {1: (1,)}), 0, 1000).cost
        > each.cost
    )


def test_missing_robots_cost_what_a_robot_does_at_most(columns):
    """At least n columns, each that is missing at the cost f: the dual of that row is between 0 and f."""
    for f in (0.5, 5.0, 500.0):
        relaxation, penalty = Master(np.full(4, 100.0)), np.full(4, 100.0)
        for robot, column in columns[::2]:
            relaxation.add(robot, [column])
        relaxation.relax()
        relaxation.at_least(3, f)
        for robot, column in columns[1::2]:
            relaxation.add(robot, [column])
        relaxed, pool = relaxation.relax(), ColumnPool(4)
        for robot, column in columns:
            pool.add(robot, [column])
        assert 0.0 <= relaxed.reward <= f
        least = [
            min(
                0.0,
                *(
                    c.length - relaxed.prices[list(c.tasks)].sum() - relaxed.reward
                    for i, c in columns
                    if i == r
                ),
            )
            for r in range(3)
        ]
        assert relaxed.value == pytest.approx(
            3 * relaxed.reward + relaxed.prices.sum() + sum(least)
        )
        assert pool.relax(penalty).value - 1e-9 <= relaxed.value
        assert all(column.tasks for _, column in relaxation.basis)


@pytest.mark.parametrize("broken", [1, 2])
def test_a_failed_search_is_retried_once_without_its_start_and_then_raises(
    columns, broken, monkeypatch
):
    """Once more without the start that it was given, and without presolve; then it is an error."""
    best, runs, searched = (
        find_partition(PartitionProblem(columns, 4), 0, 1000),
        [],
        master._search_columns,
    )

    def breaking(highs, nodes, start, below):
        runs.append(start)
        if len(runs) > broken:
            return searched(highs, nodes, start, below)
        status = highspy.HighsModelStatus.kSolveError
        return SimpleNamespace(getModelStatus=lambda: status, getInfo=highs.getInfo)

    monkeypatch.setattr(master, "_search_columns", breaking)
    if broken == 1:
        assert find_partition(
            PartitionProblem(columns, 4), 0, 1000, known=best.routes
        ).cost == pytest.approx(best.cost)
        assert [start is None for start in runs] == [False, True]
        return
    with pytest.raises(
        SolverError, match=f"partitioning of {len(columns)} columns: .* kSolveError"
    ):
        find_partition(PartitionProblem(columns, 4), 0, 1000, known=best.routes)


REJECTED = """0:29:0135 0:29:0369 0:30:0459 0:29:046 0:28:13689 0:28:1458 0:28:1468 0:30:23679 0:30:2467 0:30:35679
0:28:3568 0:30:35689 1:26:1345 1:27:13459 1:29:2346 1:30:348 2:29:027 2:30:0279 2:30:12567 2:30:2578 2:30:378 3:29:2368
4:29:027 4:29:123569 4:30:12567 4:29:2346 4:28:2358 4:30:23589 4:30:2368 4:30:2578 4:29:3568"""
"""robot:m above 1000:tasks. Without a cover; HiGHS presolves it to a solution that it then rejects as a solve error."""


def test_columns_that_presolve_takes_for_feasible_are_proven_not_to_be():
    words = [word.split(":") for word in REJECTED.split()]
    columns = [
        (int(i), RouteColumn(1000.0 + int(m), tuple(map(int, tasks))))
        for i, m, tasks in words
    ]
    sets = [
        {j: set(c.tasks) for j, (i, c) in enumerate(columns) if i == robot}
        for robot in range(5)
    ]
    choices = product(*([set(), *own.values()] for own in sets))
    assert not any(
        sum(map(len, sets)) == 10 and len(set().union(*sets)) == 10 for sets in choices
    )
    assert find_partition(
        PartitionProblem(columns, 10), seed=0, nodes=2
    ) == PartitionResult(np.inf, {}, np.inf)


def test_no_cover_is_proven_and_relaxes_at_the_penalty():
    lonely = [(0, RouteColumn(3.0, (0,)))]
    none = PartitionResult(np.inf, {}, np.inf)
    assert find_partition(PartitionProblem(lonely, 2), seed=0, nodes=10) == none
    assert find_partition(PartitionProblem([], 2), seed=0, nodes=10) == none
    pool = ColumnPool(2)
    pool.add(0, [RouteColumn(3.0, (0,))])
    assert pool.relax(np.array([50.0, 50.0])).value == pytest.approx(53.0)
    assert ColumnPool(2).relax(np.array([50.0, 60.0])).value == pytest.approx(110.0)


def test_a_shorter_tour_of_the_same_set_replaces_the_longer():
    pool = ColumnPool(3)
    assert pool.add(1, [RouteColumn(5.0, (0, 2)), RouteColumn(6.0, (1,))]) == 2
    assert pool.add(1, [RouteColumn(5.0, (0, 2))]) == 0
    assert pool.add(1, [RouteColumn(4.5, (0, 2))]) == 1
    assert pool.add(0, [RouteColumn(9.0, (0, 2))]) == 1
    assert pool.items() == [
        (0, RouteColumn(9.0, (0, 2))),
        (1, RouteColumn(4.5, (0, 2))),
        (1, RouteColumn(6.0, (1,))),
    ]
    assert not pool.has(1, RouteColumn(4.0, (0, 2)))


def test_a_tour_that_is_shorter_by_rounding_alone_is_no_news():
    master = Master(np.full(3, 9.0))
    assert master.add(1, [RouteColumn(5.0, (0, 2))]) == 1
    assert master.add(1, [RouteColumn(5.0 - 1e-12, (0, 2))]) == 0
    assert master.add(1, [RouteColumn(5.0 - 1e-6, (0, 2))]) == 1


def test_a_problem_with_other_lengths_has_the_same_tasks_and_groups():
    problem = PartitionProblem([(1, RouteColumn(3.0, (0, 1)))], 2, {1: (1, 5)})
    assert problem.with_lengths([1.0]) == PartitionProblem(
        [(1, RouteColumn(1.0, (0, 1)))], 2, {1: (1, 5)}
    )
    with pytest.raises(ValueError, match="zip"):
        problem.with_lengths([])


def test_no_plan_is_missed_that_costs_less_than_the_searched_ones(columns):
    best = cheapest_exact_cover(columns)
    problem = PartitionProblem(columns, 4)
    for below in (best - 2.0, best - 1e-3):
        none = find_partition(problem, 0, 1000, below=below)
        assert min(none.cost, none.bound) >= best - 1e-9
    found = find_partition(problem, 0, 1000, below=best + 1e-3)
    assert found.cost == pytest.approx(best)
    assert found.bound <= best + 1e-9
