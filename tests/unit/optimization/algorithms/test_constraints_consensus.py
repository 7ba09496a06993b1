import re

import cvxpy as cp
import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.constraints_consensus import (
    ConstraintsConsensus,
)
from crazychoir.optimization.problems.problems import CommonCost
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import (
    GraphSequence,
    complete,
    erdos_renyi_connected,
    path,
    ring,
)

GRAPHS = {
    "ring": ring,
    "directed ring": lambda n: ring(n, directed=True),
    "complete": complete,
    "path": path,
}


def drawn(count, n, rows, seed, linear, tight=False):
    """Rows with a common point, a box at agent 0; tight: all rows hold with equality there."""
    draw = np.random.default_rng(seed)
    c, L, A, x0 = (
        draw.normal(size=n),
        draw.normal(size=(n, n)),
        draw.normal(size=(count, rows, n)),
        draw.normal(size=n),
    )
    b = A @ x0 + (0.0 if tight else draw.uniform(0, 2, (count, rows)))
    x = cp.Variable(n)
    objective = (
        c @ x if linear else cp.quad_form(x, L @ L.T + 0.1 * np.eye(n)) + 5 * c @ x
    )
    box = [x <= 20, x >= -20]
    return [
        CommonCost(i, x, objective, [A[i] @ x <= b[i], *(box if i == 0 else [])])
        for i in range(count)
    ]


def optimum(parts):
    problem = cp.Problem(
        cp.Minimize(parts[0].objective), [c for part in parts for c in part.constraints]
    )
    problem.solve(solver=cp.CLARABEL)
    return problem.value


def in_other_units(parts, unit):
    """The same programs in z with x[0] = unit z[0]."""
    factor = np.ones(parts[0].n)
    factor[0] = unit
    x = cp.Variable(parts[0].n)
    form = parts[0].cost
    objective = (form.q * factor) @ x
    if form.P.any():
        P = form.P * np.outer(factor, factor)
        objective += 0.5 * cp.quad_form(x, cp.psd_wrap(P))
    return [
        CommonCost(
            part.agent,
            x,
            objective,
            [(part.polyhedron.A * factor) @ x <= part.polyhedron.b],
        )
        for part in parts
    ], factor


@pytest.mark.parametrize("unit", [1e-6, 1e-3, 1e3, 1e6])
@pytest.mark.parametrize("linear", [False, True])
def test_unit_of_a_variable_does_not_matter(linear, unit):
    graph = ring(5)
    for seed in range(3):
        parts = drawn(5, 3, 4, seed, linear)
        others, factor = in_other_units(parts, unit)
        found = []
        for problems in (parts, others):
            team = {
                i: ConstraintsConsensus(part, graph.diameter())
                for i, part in enumerate(problems)
            }
            run_in_step(team, graph)
            found.append(team[0].x)
        np.testing.assert_allclose(factor * found[1], found[0], rtol=1e-8, atol=1e-9)


def test_entry_with_a_small_slope_is_held_by_its_constraint():
    x = cp.Variable(2)
    team = {
        i: ConstraintsConsensus(
            CommonCost(i, x, -x[0] - 1e-4 * x[1], [x[0] <= 1 + i, x[1] <= 100 + i]), 1
        )
        for i in range(3)
    }
    run_in_step(team, complete(3))
    np.testing.assert_allclose(team[1].x, [1.0, 100.0], rtol=1e-12)


@pytest.mark.parametrize("tight", [False, True])
@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("name", GRAPHS)
def test_all_find_the_centralised_optimum_in_finite_time(name, linear, tight):
    for seed in range(3):
        parts, graph = drawn(7, 3, 4, seed, linear, tight), GRAPHS[name](7)
        team = {
            i: ConstraintsConsensus(part, graph.diameter())
            for i, part in enumerate(parts)
        }
        rounds = run_in_step(team, graph)
        assert rounds < 10 * graph.diameter()
        assert parts[0].value(team[0].x) == pytest.approx(
            optimum(parts), rel=1e-6, abs=1e-6
        )
        for agent in team.values():
            np.testing.assert_allclose(agent.x, team[0].x, atol=1e-9)
            np.testing.assert_allclose(
                agent.basis[:, :-1] @ agent.x, agent.basis[:, -1], rtol=0, atol=1e-13
            )
            assert len(agent.basis) <= 3


def test_agents_with_many_rows_send_at_most_n():
    parts, graph = drawn(4, 2, 300, 1, linear=True), ring(4)
    team = {
        i: ConstraintsConsensus(part, graph.diameter()) for i, part in enumerate(parts)
    }
    run_in_step(team, graph)
    assert parts[0].value(team[3].x) == pytest.approx(optimum(parts), rel=1e-6)
    assert all(len(agent.basis) <= 2 for agent in team.values())


def test_all_agents_take_the_same_of_several_optima():
    x = cp.Variable(2)
    rows = [[x[0] >= 1], [x[1] >= -3], [x[1] <= 5]]
    team = {
        i: ConstraintsConsensus(CommonCost(i, x, x[0], own), 1)
        for i, own in enumerate(rows)
    }
    run_in_step(team, complete(3))
    np.testing.assert_allclose(
        [agent.x for agent in team.values()], np.tile([1.0, 0.0], (3, 1)), atol=1e-9
    )


def test_equalities_count():
    x = cp.Variable(2)
    rows = [[x[0] + x[1] == 3], [x[0] <= 1]]
    team = {
        i: ConstraintsConsensus(CommonCost(i, x, cp.sum_squares(x), own), 1)
        for i, own in enumerate(rows)
    }
    run_in_step(team, path(2))
    np.testing.assert_allclose(team[1].x, [1.0, 2.0], atol=1e-9)


def test_on_a_changing_graph_it_takes_so_many_rounds():
    parts, graph = (
        drawn(6, 3, 4, 2, linear=True),
        GraphSequence.draw(erdos_renyi_connected(6, 0.4, 1), 0.3, 5, 1),
    )
    team = {i: ConstraintsConsensus(part, rounds=40) for i, part in enumerate(parts)}
    assert run_in_step(team, graph) == 40
    for agent in team.values():
        assert parts[0].value(agent.x) == pytest.approx(optimum(parts), rel=1e-6)


def test_the_rounds_are_the_same_whatever_is_lost():
    parts, graph = drawn(6, 3, 4, 2, linear=True), ring(6, directed=True)
    runs = [
        simulate(
            {i: ConstraintsConsensus(part, 5) for i, part in enumerate(parts)},
            graph,
            loss=loss,
            seed=1,
        )
        for loss in (0.0, 0.4)
    ]
    assert runs[0].rounds == runs[1].rounds
    assert np.array_equal(runs[0].of(), runs[1].of())


def test_constraints_that_exclude_each_other_are_found_and_named():
    x = cp.Variable(2)
    rows = [[x[0] >= 1], [x[1] >= 0], [x[0] <= -0.5]]
    team = {
        i: ConstraintsConsensus(CommonCost(i, x, cp.sum_squares(x), own), 2)
        for i, own in enumerate(rows)
    }
    with pytest.raises(
        SolverError,
        match=r"agent 1: .*infeasible: row [+-]1 x\[0\] <= -(0.5|1): violated by 1.5",
    ):
        simulate(team, path(3), loss=0.2)


def test_what_is_wrong_is_named():
    x = cp.Variable(2)
    part = CommonCost(3, x, x[0])
    with pytest.raises(ConfigError, match="agent 3: diameter, rounds"):
        ConstraintsConsensus(part)
    agent = ConstraintsConsensus(part, 2)
    agent.message()
    with pytest.raises(
        ConfigError,
        match=r"agent 3: message of agent 4: found a basis \(1, 5\); allowed: \(m, 3\)",
    ):
        agent.step({4: [0, np.zeros((1, 5))]})


@pytest.mark.parametrize(
    ("objective", "rows"),
    [
        (lambda x: -x[0], lambda x, i: [x[0] >= -i]),
        (lambda x: -x[0], lambda x, i: [x[0] <= 1e6 + i, x[1] >= 0]),
        (lambda x: cp.square(x[0] - 1) - x[1], lambda x, i: [x[0] <= 5 + i]),
    ],
    ids=["unbounded", "far", "unbounded quadratic"],
)
def test_an_optimum_that_only_the_tie_break_holds_is_refused_by_all_in_one_round(
    objective, rows
):
    x = cp.Variable(2)
    team = {
        i: ConstraintsConsensus(CommonCost(i, x, objective(x), rows(x, i)), 1)
        for i in range(3)
    }
    said = []
    for _ in range(10):
        messages = {i: agent.message() for i, agent in team.items()}
        for i, agent in team.items():
            try:
                agent.step({j: message for j, message in messages.items() if j != i})
            except SolverError as error:
                said.append(str(error))
        if said:
            break
    assert len(said) == 3
    assert all(
        f"agent {i}: constraints consensus" in text and "tie-break" in text
        for i, text in enumerate(said)
    )


@pytest.mark.parametrize("size", [1e-8, 1e-5, 1.0, 1e3])
def test_rows_of_any_size_are_met(size):
    x = cp.Variable(2)
    rows = [[x[0] <= -size], [x[1] <= 10.0 * size], [x[0] <= 1e6, 1e-6 * x[1] <= 1.0]]
    objective = cp.sum_squares(x - size)
    team = {
        i: ConstraintsConsensus(CommonCost(i, x, objective, own), 1)
        for i, own in enumerate(rows)
    }
    run_in_step(team, complete(3))
    for agent in team.values():
        np.testing.assert_allclose(agent.x, [-size, size], rtol=1e-6)


@pytest.mark.parametrize("size", [1e-8, 1e-5, 1.0, 1e5])
def test_rows_of_any_size_that_exclude_each_other_are_infeasible(size):
    x = cp.Variable(2)
    rows = [[x[0] <= -size, x[1] <= 1.0], [x[0] >= size]]
    team = {
        i: ConstraintsConsensus(CommonCost(i, x, cp.sum_squares(x), own), 1)
        for i, own in enumerate(rows)
    }
    with pytest.raises(
        SolverError, match=re.escape(f"violated by {2.0 * size:.4g}, at best")
    ):
        run_in_step(team, complete(2))


def test_a_linear_program_with_rows_of_any_units_is_solved_or_refused():
    """Rows from 10^-6 to 10^6; columns that the tie-break is too large for are refused."""
    chance = np.random.default_rng(4)
    solved = 0
    for seed in range(12):
        parts, graph = drawn(4, 3, 4, seed, linear=True), complete(4)
        c = parts[0].cost.q
        s = 10.0 ** chance.uniform(-6, 6, 3) if seed % 2 else np.ones(3)
        x = cp.Variable(3)
        scaled = []
        for part in parts:
            over = part.polyhedron
            r = 10.0 ** chance.uniform(-6, 6, len(over.b))
            scaled.append(
                CommonCost(
                    part.agent,
                    x,
                    (c * s) @ x,
                    [(r[:, None] * over.A * s) @ x <= r * over.b],
                )
            )
        team = {i: ConstraintsConsensus(part, 1) for i, part in enumerate(scaled)}
        try:
            run_in_step(team, graph)
        except SolverError as error:
            assert seed % 2, error  # noqa: PT017
            assert "tie-break" in str(error) or "cannot tell" in str(error)  # noqa: PT017
            continue
        solved += 1
        for agent in team.values():
            assert c @ (s * agent.x) == pytest.approx(
                optimum(parts), rel=1e-6, abs=1e-6
            )
    assert solved >= 6


def test_rounded_zero_in_the_objective_hides_no_row():
    x = cp.Variable(2)
    objective = x[0] + (0.1 + 0.2 - 0.3) * x[1]
    rows = [[x[0] + x[1] >= 1.0], [x[0] >= 0.0], [x[1] >= 0.0, x[1] <= 0.5]]
    team = {
        i: ConstraintsConsensus(CommonCost(i, x, objective, own), 1)
        for i, own in enumerate(rows)
    }
    run_in_step(team, complete(3))
    np.testing.assert_allclose(team[0].x, [0.5, 0.5], atol=1e-9)
