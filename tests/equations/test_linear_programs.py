"""The equations of distributed simplex, task assignment and primal decomposition."""

import itertools

import numpy as np
import pytest
from coupled import random_blocks
from scipy.optimize import linprog

from crazychoir.optimization.algorithms.convexified import Convexified
from crazychoir.optimization.algorithms.simplex import BasisExchange
from crazychoir.optimization.problems.lexicographic import (
    ProgramColumns,
    find_optimal_basis,
    unite_columns,
)
from crazychoir.optimization.problems.mixed_integer import MixedIntegerBlock
from crazychoir.optimization.problems.options_lp import AgentOptions, OptionsPool
from crazychoir.team.graph import complete, metropolis

DRAW = np.random.default_rng(11)


def degenerate(seed):
    """A program with several optimal bases, and several bases of one vertex."""
    chance = np.random.default_rng(seed)
    A = chance.integers(0, 2, (4, 9)).astype(float)
    return chance.integers(1, 3, 9).astype(float), A, A @ chance.integers(0, 2, 9)


@pytest.mark.parametrize("seed", range(12))
def test_the_lexicographic_basis_is_the_best_of_all_with_a_small_number_for_e(seed):
    """Where d -> 0, costs are compared in turn: artificial columns, c, then x_0, x_1, ... by id."""
    c, A, b = degenerate(seed)
    columns = unite_columns([ProgramColumns.artificial(4), ProgramColumns.own(0, c, A)])
    basis = find_optimal_basis(columns, ProgramColumns.artificial(4), b)
    right = b + 0.05 ** np.arange(1, 5)
    best, least = None, (np.inf,)
    for chosen in itertools.combinations(range(len(columns)), 4):
        B = columns.entries[:, chosen]
        if (
            abs(np.linalg.det(B)) > 1e-9
            and (x := np.linalg.solve(B, right)).min() > 0.0
        ):
            whole = np.zeros(len(columns))
            whole[list(chosen)] = x
            value = tuple(np.round([*(columns.cost @ whole), *whole], 9).tolist())
            best, least = (chosen, value) if value < least else (best, least)
    level = np.linalg.solve(columns.entries[:, best], b)
    assert columns.cost[:, best] @ level == pytest.approx(
        basis.columns.cost @ basis.level, abs=1e-9
    )
    assert columns.ids[list(best)].tolist() == basis.columns.ids.tolist()


@pytest.mark.parametrize("seed", range(8))
def test_prices_of_a_basis_are_dual_feasible_and_worth_as_much(seed):
    c, A, b = degenerate(seed)
    agents = {
        i: BasisExchange(i, c[3 * i :][:3], A[:, 3 * i :][:, :3], b, 1)
        for i in range(3)
    }
    while not agents[0].settled:
        told = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.step({j: told[j] for j in range(3) if j != i})
    penalties = 0.0 * agents[0].pricing().penalties()
    for _ in penalties:
        penalties = np.maximum.reduce(
            [agent.pricing().penalties(penalties) for agent in agents.values()]
        )
    prices = agents[0].pricing().prices(penalties)
    assert (c - prices @ A >= -1e-9).all()
    assert prices @ b == pytest.approx(agents[0].cost)


def test_the_certificate_of_an_infeasible_program_is_one():
    A, b = (
        np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
        np.array([1.0, 1.0, 2.0]),
    )
    alone = BasisExchange(0, np.zeros(3), A, b, 0)
    while not alone.settled:
        alone.step({})
    y = alone.certificate
    assert alone.status == "infeasible"
    assert (y @ A <= 1e-9).all()
    assert y @ b == pytest.approx(alone.violation.sum())


def test_prices_are_subgradients_of_the_local_value():
    block = random_blocks(1, seed=5)[0]
    local = Convexified(block, 50.0)
    for y in DRAW.uniform(-0.5, 6.0, (12, 3)):
        at = local.allocate(y)
        for other in DRAW.uniform(-0.5, 6.0, (6, 3)):
            assert local.allocate(other).value >= at.value - at.mu @ (other - y) - 1e-7
        assert at.mu.sum() <= 50.0 + 1e-7
        assert (block.A @ at.x <= y + at.violation + 1e-7).all()
        assert at.value == pytest.approx(block.c @ at.x + 50.0 * at.violation)


def test_the_convex_hull_is_that_of_all_points():
    """p(y) by column generation, and by a linear program over every point of the set."""
    rows = [[2.0, 3.0]], [7.0]
    block = MixedIntegerBlock(
        0, [-1.0, -1.4], [[1.0, 2.0]], [1.0], rows=rows, bounds=(0, 3), integer=[0, 1]
    )
    points = np.array(
        [p for p in itertools.product(range(4), repeat=2) if 2 * p[0] + 3 * p[1] <= 7]
    )
    local = Convexified(block, 9.0)
    for y in (-1.0, 0.0, 0.7, 2.5, 3.1, 9.0):
        c = np.append(points @ block.c, 9.0)
        use = [np.append(points @ block.A[0], -1.0)]
        whole = linprog(
            c,
            A_ub=use,
            b_ub=[y],
            A_eq=[np.append(np.ones(len(points)), 0.0)],
            b_eq=[1.0],
        )
        assert local.allocate(np.array([y])).value == pytest.approx(whole.fun)


def test_the_tightening_is_that_of_all_points():
    for n in range(4):
        A = DRAW.normal(size=(3, 3)) * [
            [1.0],
            [1.0],
            [0.02],
        ]  # the last is hardly used: U - L is the smaller there
        block = MixedIntegerBlock(
            n, [0.0] * 3, A, [0.0] * 3, bounds=(0, 2), integer=range(3)
        )
        use = np.array(list(itertools.product(range(3), repeat=3))) @ block.A.T
        low, high = use.min(axis=0), use.max(axis=0)
        assert block.tightening() == pytest.approx(
            np.minimum(high - low, (use - low).max(axis=1).min())
        )


def test_trade_by_metropolis_weights_keeps_the_sum_of_the_shares():
    mu, weights = DRAW.random((6, 3)), metropolis(complete(6))
    trade = np.array(
        [mu[i] - sum(w * mu[j] for j, w in weights[i].items()) for i in range(6)]
    )
    assert trade.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)


def all_integer(block):
    """The block with integers alone, so that each option has integers of its own."""
    return MixedIntegerBlock(
        block.agent,
        block.c,
        block.A,
        block.share,
        rows=block.rows,
        bounds=block.bounds,
        integer=range(block.n),
    )


def test_the_best_options_are_those_of_all_choices():
    blocks = [all_integer(block) for block in random_blocks(3, seed=2, tightness=0.5)]
    capacity = sum(block.share for block in blocks)
    pool, tables = OptionsPool(capacity, np.ones(3), [0, 1, 2]), []
    for block in blocks:
        options = AgentOptions(block)
        for y in DRAW.uniform(0.0, 3.0, (5, 3)):
            options.add(block.within(y)[0])
        tables.append(options.table)
    pool.add(dict(enumerate(tables)))
    fitting = [
        sum(table[o][1] for table, o in zip(tables, chosen, strict=True))
        for chosen in itertools.product(*(range(len(table)) for table in tables))
        if (
            np.sum(
                [table[o][2:] for table, o in zip(tables, chosen, strict=True)], axis=0
            )
            <= capacity
        ).all()
    ]
    (missing, cost), _, mixtures = pool.best(0, None)
    assert missing == 0.0
    assert cost == pytest.approx(min(fitting))
    assert cost == pool.value(mixtures).cost
    assert (pool.relaxed({})[0] >= 0.0).all()


def test_options_with_the_same_integers_are_mixed():
    """x_0 in [0, 3] and x_1 in {0, 1} share one unit: 0.4 of x_0 beside x_1 = 0, as 3 is too much."""
    blocks = [
        MixedIntegerBlock(0, [-1.0], [[2.5]], [0.5], bounds=(0.0, 3.0)),
        MixedIntegerBlock(1, [-0.1], [[1.0]], [0.5], bounds=(0.0, 1.0), integer=[0]),
    ]
    pool = OptionsPool(np.ones(1), np.ones(1), [0, 1])
    tables = {}
    for block, points in zip(blocks, ([0.0, 3.0], [0.0, 1.0]), strict=True):
        options = AgentOptions(block)
        for point in points:
            options.add(np.array([point]))
        tables[block.agent] = options.table
    pool.add(tables)
    choice = pool.value(pool.best(0, None)[2])
    assert choice.cost == pytest.approx(-0.4)
    assert choice.left == pytest.approx([0.0], abs=1e-9)
    assert len(choice.mixtures[1]) == 1
