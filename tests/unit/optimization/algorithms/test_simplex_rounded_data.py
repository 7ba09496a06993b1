"""Linear programs with rounded data: all agents find the answer of HiGHS, or all refuse with one text."""

import numpy as np
import pytest
from scipy.optimize import linprog
from teams import run_team

from crazychoir.bus.codec import decode, encode
from crazychoir.errors import SolverError
from crazychoir.optimization.algorithms.simplex import DistributedSimplex
from crazychoir.team.graph import ring

PROGRAMS = 300
SLOW = pytest.mark.slow
CLOSE = 1e-6
"""Up to what a row must be met, relative to the right-hand sides added up."""


def repeated_row(chance, decimals):
    """Return c, A, b with the first row twice, the second time with relative errors of 10^-decimals."""
    m = int(chance.integers(1, 4))
    n = int(chance.integers(3, 8))
    A = chance.random((m, n))
    A = np.vstack([A, A[0] * (1.0 + 10.0**-decimals * chance.normal(size=n))])
    return chance.random(n), A, A @ chance.random(n)


def transport(chance, decimals):
    """Return c, A, b of a transport problem with rounded supplies and demands."""
    sources = int(chance.integers(2, 4))
    sinks = int(chance.integers(2, 4))
    A = np.zeros((sources + sinks, sources * sinks))
    for i in range(sources):
        for j in range(sinks):
            A[i, i * sinks + j] = 1.0
            A[sources + j, i * sinks + j] = 1.0
    supplies = chance.random(sources)
    demands = chance.random(sinks)
    demands *= supplies.sum() / demands.sum()
    b = np.round(np.concatenate([supplies, demands]), decimals)
    return chance.random(sources * sinks), A, b


def redundant_rows(chance, decimals):
    """Return c, A, b with two rows that are sums of others but for rounding."""
    m = int(chance.integers(2, 5))
    n = int(chance.integers(3, 9))
    A = chance.normal(size=(m, n))
    A = np.vstack([A, chance.integers(-2, 3, (2, m)) @ A])
    b = A @ (chance.random(n) * (chance.random(n) < 0.6))
    return chance.random(n), np.round(A, decimals), np.round(b, decimals)


def team(c, A, b, agents):
    parts = np.array_split(np.arange(len(c)), agents)
    return {
        i: DistributedSimplex(i, c[part], A[:, part], b, agents // 2)
        for i, part in enumerate(parts)
    }


def refusals_of(agents):
    """Run to the end on a ring; return the errors, without the agent that raises them, of the last round."""
    graph = ring(len(agents)) if len(agents) > 1 else None
    for _ in range(200):
        if all(agent.done for agent in agents.values()):
            return []
        sent = {i: agent.message() for i, agent in agents.items()}
        refusals = []
        for i, agent in agents.items():
            neighbors = graph.in_neighbors(i) if graph else ()
            try:
                agent.step({j: decode(encode(sent[j])) for j in neighbors})
            except SolverError as error:
                refusals.append(error.status)
        if refusals:
            return refusals
    raise AssertionError("no end")


def outcome(kind, decimals, seed):
    """Return what a team ends with, "optimal", "infeasible" or "cannot tell", after a look at all that it says."""
    chance = np.random.default_rng(seed)
    c, A, b = kind(chance, decimals)
    agents = team(c, A, b, 1 + seed % 3)
    refusals = refusals_of(agents)
    central = linprog(c, A_eq=A, b_eq=b)
    if refusals:
        assert len(refusals) == len(agents)
        assert len(set(refusals)) == 1
        if "double precision cannot tell" in refusals[0]:
            return "cannot tell"
        assert refusals[0].startswith("infeasible")
        # HiGHS meets a row up to 1e-7, whatever its terms are.
        assert central.status or decimals <= 9
        return "infeasible"
    results = [agent.result for agent in agents.values()]
    x = np.concatenate([result.x for result in results])
    assert (x >= 0.0).all()
    assert np.abs(A @ x - b).max() <= CLOSE * (1.0 + np.abs(b).sum())
    assert all(result.ids == results[0].ids for result in results)
    assert all(result.cost == results[0].cost for result in results)
    if central.status == 0:
        assert results[0].cost == pytest.approx(central.fun, rel=1e-5, abs=1e-5)
    return "optimal"


def seeds():
    """A few programs by default, PROGRAMS of them with the slow tests."""
    return [
        range(12),
        pytest.param(range(12, PROGRAMS), marks=SLOW),
    ]


@pytest.mark.parametrize("decimals", range(7, 14))
@pytest.mark.parametrize("some", seeds(), ids=["few", "many"])
def test_a_repeated_row_gives_the_answer_of_highs_or_one_refusal(decimals, some):
    found = [outcome(repeated_row, decimals, seed) for seed in some]
    assert "infeasible" not in found
    if decimals >= 11:
        assert "cannot tell" not in found


@pytest.mark.parametrize("decimals", range(6, 13))
@pytest.mark.parametrize("some", seeds(), ids=["few", "many"])
def test_rounded_supplies_and_demands_give_one_basis(decimals, some):
    found = [outcome(transport, decimals, seed) for seed in some]
    assert "cannot tell" not in found
    if decimals >= 10:
        assert "infeasible" not in found


@pytest.mark.parametrize("decimals", range(7, 14))
@pytest.mark.parametrize("some", seeds(), ids=["few", "many"])
def test_redundant_rows_that_are_rounded_give_one_answer_or_one_refusal(decimals, some):
    found = [outcome(redundant_rows, decimals, seed) for seed in some]
    if decimals >= 12:
        assert set(found) == {"optimal"}


def test_two_agents_find_the_point_that_a_repeated_row_leaves():
    A = np.array([[4.0, 1.0, 1.0], [3.9999999996, 0.9999999997, 1.0]])
    parts = [np.array([0, 1]), np.array([2])]
    c = np.array([4.0, 2.0, 2.0])
    agents = {
        i: DistributedSimplex(i, c[part], A[:, part], [6.0, 5.9999999996], 1)
        for i, part in enumerate(parts)
    }
    run_team(agents, ring(2))
    assert [agent.result.cost for agent in agents.values()] == pytest.approx([6.0] * 2)
    assert agents[0].result.ids == agents[1].result.ids


def test_one_agent_finds_the_point_that_a_repeated_row_leaves():
    A = [[2.0, 3.0, 4.0], [2.0000000006, 2.9999999991, 3.9999999992]]
    alone = DistributedSimplex(0, [2.0, 5.0, 3.0], A, [10.0, 9.9999999994], 0)
    while not alone.done:
        alone.step({})
    assert alone.result.x == pytest.approx([0.0, 0.0, 2.5])
    assert alone.result.cost == pytest.approx(7.5)
