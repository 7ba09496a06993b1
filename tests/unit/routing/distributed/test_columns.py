import numpy as np
import pytest
from scipy.optimize import linprog

from crazychoir.routing.distributed.columns import ColumnProgram
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.route_table import RouteTable

PENALTY = 40.0


def over_all_columns(table, y):
    """p(y) by a general LP solver over every column."""
    n, m = len(table), len(y)
    visits = np.zeros((m, n))
    for c in range(n):
        visits[list(table.column(c).tasks), c] = 1.0
    result = linprog(
        np.concatenate([table.length, np.full(m, PENALTY)]),
        A_ub=-np.hstack([visits, np.eye(m)]),
        b_ub=-y,
        A_eq=np.concatenate([np.ones(n), np.zeros(m)])[None],
        b_eq=[1.0],
    )
    return result.fun


@pytest.fixture
def table():
    return RouteTable(
        random_instance(1, 6, seed=11, shape=InstanceShape(route_length_limit=35.0))
        .local(0)
        .vehicle
    )


def test_column_generation_reaches_the_value_over_all_columns(table):
    program = ColumnProgram(table, np.full(6, PENALTY))
    for y in np.random.default_rng(5).uniform(-0.3, 1.2, size=(20, 6)):
        assert program.solve(y).value == pytest.approx(
            over_all_columns(table, y), abs=1e-6
        )


def test_a_warm_program_answers_as_a_fresh_one(table):
    warm = ColumnProgram(table, np.full(6, PENALTY))
    for y in np.random.default_rng(6).uniform(0, 0.7, size=(10, 6)):
        fresh = ColumnProgram(table, np.full(6, PENALTY)).solve(y)
        assert warm.solve(y).value == pytest.approx(fresh.value, abs=1e-6)


def test_no_demand_costs_nothing(table):
    solution = ColumnProgram(table, np.full(6, PENALTY)).solve(np.zeros(6))
    assert (
        solution.value,
        solution.mu.max(),
        solution.violation.max(),
        solution.active,
    ) == (0.0, 0.0, 0.0, [])


def test_full_demand_within_reach_uses_the_one_tour():
    table = RouteTable(random_instance(1, 4, seed=3).local(0).vehicle)
    solution = ColumnProgram(table, np.full(4, 100.0)).solve(np.ones(4))
    assert [c.tasks for c in solution.active] == [(0, 1, 2, 3)]
    assert solution.value == pytest.approx(table.find([0, 1, 2, 3]).length)


def test_what_a_robot_cannot_do_stays_unserved_at_the_penalty():
    raw = random_instance(2, 3, seed=1).to_json()
    raw["capability"] = [[True] * 3, [True, False, True]]
    raw["capacity"] = [9.0, 9.0]
    program = ColumnProgram(
        RouteTable(Instance.parse(raw).local(1).vehicle), np.full(3, PENALTY)
    )
    solution = program.solve(np.array([0.0, 0.25, 0.0]))
    assert (solution.mu[1], solution.violation[1]) == (PENALTY, 0.25)
    assert solution.value == pytest.approx(0.25 * PENALTY)
    assert program.solve(np.array([0.0, -0.25, 0.0])).mu.tolist() == [0.0, 0.0, 0.0]


def test_a_robot_without_any_task_prices_at_the_penalty():
    raw = random_instance(2, 3, seed=1).to_json()
    raw["capability"], raw["capacity"] = [[True] * 3, [False] * 3], [9.0, 9.0]
    table = RouteTable(Instance.parse(raw).local(1).vehicle)
    solution = ColumnProgram(table, np.full(3, PENALTY)).solve(np.full(3, 0.5))
    assert solution.mu.tolist() == [PENALTY] * 3
    assert solution.value == pytest.approx(1.5 * PENALTY)
