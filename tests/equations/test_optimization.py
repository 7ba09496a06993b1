"""The equations of the distributed algorithms: what they keep, step by step, and where they lead."""

import math
from itertools import pairwise

import cvxpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_step import run_in_step

from crazychoir.optimization.algorithms.aggregative_tracking import (
    AggregativeProblem,
    AggregativeTracking,
)
from crazychoir.optimization.algorithms.block_subgradient import BlockSubgradientMethod
from crazychoir.optimization.algorithms.directed_gradient_tracking import (
    DirectedGradientTracking,
)
from crazychoir.optimization.algorithms.gradient_tracking import GradientTracking
from crazychoir.optimization.algorithms.push_sum import PushSum
from crazychoir.optimization.algorithms.subgradient import SubgradientMethod
from crazychoir.optimization.generate import random_quadratics
from crazychoir.optimization.problems.gradient import ProjectedCost, Samples, keep_point
from crazychoir.optimization.problems.projection import (
    Box,
    Convex,
    Disc,
    Intersection,
    Strip,
)
from crazychoir.optimization.rounds.average import RunningAverage
from crazychoir.optimization.rounds.blocks import RandomBlocks
from crazychoir.optimization.rounds.mixing import columns, rows, team
from crazychoir.optimization.rounds.step_size import Constant, Diminishing
from crazychoir.team import graph as graphs

Q = random_quadratics(6, 3, seed=1)
GRAPH = graphs.erdos_renyi_connected(6, 0.5, 1)
DIRECTED = graphs.erdos_renyi_connected(6, 0.4, 3, directed=True)
CHANGING = graphs.GraphSequence.draw(GRAPH, 0.4, 5, 1)


def matrix(weights, k=0):
    return np.array([[weights[i][k].get(j, 0.0) for j in weights] for i in weights])


def gathered(agents, name):
    return np.array([getattr(agent, name) for agent in agents.values()])


# Averages and steps -------------------------------------------------------------------------------------------------


@given(
    st.lists(st.tuples(st.floats(-9, 9), st.floats(0.01, 9)), min_size=1, max_size=9)
)
def test_a_running_average_is_the_weighted_mean(steps):
    average = RunningAverage()
    for x, a in steps:
        average.add(np.array([x]), a)
    mean = math.fsum(x * a for x, a in steps) / math.fsum(a for _, a in steps)
    assert average.value == pytest.approx([mean], abs=1e-9)


@given(st.integers(0, 1000), st.floats(0.01, 10), st.floats(0.1, 1))
def test_step_sizes(k, a, p):
    assert Constant(a)(k) == a
    assert Diminishing(a, p)(k) == pytest.approx(a * math.exp(-p * math.log(k + 1)))


def test_a_mini_batch_has_the_mean_gradient_in_expectation():
    samples = np.random.default_rng(0).normal(size=(12, 2))
    gradient = Samples(3, lambda x, s: x - s, samples, batch=5, seed=1)
    drawn = np.array([gradient(np.array([1.0, 2.0])) for _ in range(4000)])
    assert drawn.mean(axis=0) == pytest.approx(
        np.array([1.0, 2.0]) - samples.mean(axis=0), abs=0.02
    )
    one = Samples(3, lambda x, s: x - s, samples, seed=1)(np.zeros(2))
    assert any(np.allclose(one, -s) for s in samples)
    assert Samples(3, lambda x, s: x - s, samples, batch=12)(
        np.zeros(2)
    ) == pytest.approx(-samples.mean(axis=0))


# Projections --------------------------------------------------------------------------------------------------------

POINTS = st.lists(st.floats(-5, 5), min_size=3, max_size=3).map(np.array)
SETS = (
    Box([-1.0, -2.0, 0.0], [1.0, np.inf, 0.5]),
    Strip([1.0, -2.0, 0.5], 0.7, 0.4),
    Strip([1.0, 1.0, 1.0], 1.0, 0.0),
    Disc([0.5, 0.0, -1.0], 1.5),
    Disc([0.5, 0.0, -1.0], 0.0),
)


@pytest.mark.parametrize("one", SETS)
@given(POINTS, POINTS)
def test_a_projection_is_in_the_set_and_sees_all_of_it_behind_a_plane(one, z, other):
    """(z - P(z))'(y - P(z)) <= 0 for all y of the set: which makes P(z) the nearest point."""
    nearest, y = one.project(z), one.project(other)
    assert one.project(nearest) == pytest.approx(nearest, abs=1e-9)
    assert (z - nearest) @ (y - nearest) <= 1e-9


@pytest.mark.parametrize("one", SETS)
def test_closed_forms_agree_with_the_constraints_as_cvxpy_solves_them(one):
    x = cvxpy.Variable(3)
    compiled = Convex(x, one.constraints(x))
    for z in np.random.default_rng(2).normal(size=(5, 3)) * 3.0:
        assert compiled.project(z) == pytest.approx(one.project(z), abs=2e-4)


def test_the_projection_onto_an_intersection_is_not_one_after_the_other():
    both = Intersection(2, [Disc([0.0, 0.0], 1.0), Strip([1.0, 1.0], 1.0, 0.2)])
    z = np.array([2.0, -1.5])
    nearest = both.project(z)
    for y in (np.array([0.5, 0.5]), np.array([1.0, 0.0]), np.array([0.9, 0.1])):
        assert (z - nearest) @ (y - nearest) <= 1e-6
    assert (
        np.linalg.norm(nearest - both.sets[0].project(both.sets[1].project(z))) > 1e-2
    )
    boxes = Intersection(2, [Box(-1.0, 1.0), Box([0.0, -3.0], 2.0)])
    assert boxes.project(z).tolist() == [1.0, -1.0]


# Sums that are kept -------------------------------------------------------------------------------------------------


def stepwise(agents, graph, rounds):
    """After each round."""
    for k in range(rounds):
        sent = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            heard = {j: sent[j] for j in graph.at(k).in_neighbors(i)}
            agent.step(
                {j: m[i] if isinstance(m, dict) else m for j, m in heard.items()}
            )
        yield k


@pytest.mark.parametrize(
    "graph", [DIRECTED, graphs.GraphSequence.draw(DIRECTED, 0.5, 3, 1)]
)
def test_push_sum_follows_its_equation_and_keeps_both_sums(graph):
    weights = columns(graph, graphs.column_stochastic)
    x = np.random.default_rng(1).normal(size=(6, 2))
    agents = {i: PushSum(i, x[i], weights[i]) for i in graph.ids}
    s, y = x, np.ones(6)
    for k in stepwise(agents, graph, 20):
        a = matrix(weights, k % len(weights[0])).T
        s, y = a @ s, a @ y
        assert gathered(agents, "x") == pytest.approx(s / y[:, None], abs=1e-12)
        assert gathered(agents, "s").sum(axis=0) == pytest.approx(x.sum(axis=0))
        assert gathered(agents, "y").sum() == pytest.approx(6.0)


def test_gradient_tracking_follows_its_equation_and_tracks_the_sum_of_gradients():
    agents = team(
        GRAPH, lambda i, w: GradientTracking(i, np.ones(3) * i, w, Q.gradient(i), 0.02)
    )
    w, x = matrix(rows(GRAPH)), gathered(agents, "x")
    d = before = np.array([Q.gradient(i)(x[i]) for i in range(6)])
    for _ in stepwise(agents, GRAPH, 20):
        x = w @ x - 0.02 * d
        now = np.array([Q.gradient(i)(x[i]) for i in range(6)])
        d, before = w @ d + now - before, now
        assert gathered(agents, "x") == pytest.approx(x, abs=1e-12)
        assert gathered(agents, "d").sum(axis=0) == pytest.approx(now.sum(axis=0))


def test_directed_gradient_tracking_follows_its_equation_and_tracks_the_sum_of_gradients():
    pull, push = (
        rows(DIRECTED, graphs.row_stochastic),
        columns(DIRECTED, graphs.column_stochastic),
    )
    agents = {
        i: DirectedGradientTracking(
            i, np.ones(3) * i, pull[i], push[i], Q.gradient(i), 0.02
        )
        for i in range(6)
    }
    a, b, x = matrix(pull), matrix(push).T, gathered(agents, "x")
    d = before = np.array([Q.gradient(i)(x[i]) for i in range(6)])
    for _ in stepwise(agents, DIRECTED, 20):
        x = a @ (x - 0.02 * d)
        now = np.array([Q.gradient(i)(x[i]) for i in range(6)])
        d, before = b @ d + now - before, now
        assert gathered(agents, "x") == pytest.approx(x, abs=1e-12)
        assert gathered(agents, "d").sum(axis=0) == pytest.approx(now.sum(axis=0))


def test_the_subgradient_method_follows_its_equation_and_averages_by_its_steps():
    step, box = Diminishing(0.3, 0.7), Box(-0.4, 0.4)
    agents = team(
        GRAPH,
        lambda i, w: SubgradientMethod(
            i, np.ones(3) * i, w, Q.gradient(i), step, box.project
        ),
    )
    w, x, total = matrix(rows(GRAPH)), gathered(agents, "x"), 0.0
    for k in stepwise(agents, GRAPH, 15):
        v = w @ x
        x = np.clip(
            v - step(k) * np.array([Q.gradient(i)(v[i]) for i in range(6)]), -0.4, 0.4
        )
        total = total + step(k) * x
        assert gathered(agents, "x") == pytest.approx(x, abs=1e-12)
        assert gathered(agents, "average") == pytest.approx(
            total / sum(map(step, range(k + 1))), abs=1e-12
        )


def test_the_block_method_with_one_block_always_awake_is_the_subgradient_method():
    step = Constant(0.01)
    whole = team(
        GRAPH,
        lambda i, w: SubgradientMethod(
            i, np.ones(3) * i, w, Q.gradient(i), step, rounds=30
        ),
    )
    block = team(
        GRAPH,
        lambda i, w: BlockSubgradientMethod(
            i,
            np.ones(3) * i,
            w,
            RandomBlocks([3]),
            ProjectedCost(Q.gradient(i)),
            step,
            rounds=30,
        ),
    )
    run_in_step(whole, GRAPH)
    run_in_step(block, GRAPH)
    assert gathered(block, "x") == pytest.approx(gathered(whole, "x"), abs=1e-12)


class Targets:
    """f_i(x, s) = 1/2 |x - r_i|^2 + 1/2 c_i |s - b|^2,  phi_i(x) = A_i x."""

    def __init__(self, agents=6, n=3, d=2, seed=4):
        chance = np.random.default_rng(seed)
        self.r, self.c = (
            chance.normal(size=(agents, n)),
            chance.uniform(0.5, 3.0, agents),
        )
        self.b = np.array([1.0, -1.0])
        self.a = chance.normal(size=(agents, d, n))

    def agent(self, i, w, project=keep_point, **options):
        return AggregativeTracking(
            i,
            np.zeros(3),
            w,
            AggregativeProblem(
                lambda x: self.a[i] @ x,
                lambda x: self.a[i],
                lambda x, s: x - self.r[i],
                lambda x, s: self.c[i] * (s - self.b),
                project,
            ),
            **options,
        )

    def optimum(self, low=None):
        x, n = cvxpy.Variable((6, 3)), len(self.r)
        sigma = sum(self.a[i] @ x[i] for i in range(n)) / n
        cost = 0.5 * cvxpy.sum_squares(
            x - self.r
        ) + 0.5 * self.c.sum() * cvxpy.sum_squares(sigma - self.b)
        cvxpy.Problem(cvxpy.Minimize(cost), [] if low is None else [x >= low]).solve(
            solver=cvxpy.CLARABEL
        )
        return x.value


def test_aggregative_tracking_follows_its_equation_and_tracks_both_means():
    targets = Targets()
    agents = team(GRAPH, lambda i, w: targets.agent(i, w, step=0.05, delta=0.7))
    w, x = matrix(rows(GRAPH)), gathered(agents, "x")
    phi = sigma = np.einsum("ijk,ik->ij", targets.a, x)
    y = g = targets.c[:, None] * (sigma - targets.b)
    for _ in stepwise(agents, GRAPH, 20):
        down = x - targets.r + np.einsum("ijk,ij->ik", targets.a, y)
        x = x + 0.7 * (-0.05 * down)
        new_phi = np.einsum("ijk,ik->ij", targets.a, x)
        sigma, phi = w @ sigma + new_phi - phi, new_phi
        new_g = targets.c[:, None] * (sigma - targets.b)
        y, g = w @ y + new_g - g, new_g
        assert gathered(agents, "x") == pytest.approx(x, abs=1e-12)
        assert gathered(agents, "sigma").mean(axis=0) == pytest.approx(phi.mean(axis=0))
        assert gathered(agents, "y").mean(axis=0) == pytest.approx(g.mean(axis=0))


@pytest.mark.parametrize("low", [None, 0.3])
@pytest.mark.parametrize("graph", [GRAPH, CHANGING])
def test_aggregative_tracking_reaches_the_central_optimum(graph, low):
    targets = Targets()
    options = {} if low is None else {"project": Box(low, np.inf).project}
    agents = team(
        graph, lambda i, w: targets.agent(i, w, step=0.03, rounds=2500, **options)
    )
    run_in_step(agents, graph)
    assert gathered(agents, "x") == pytest.approx(targets.optimum(low), abs=1e-5)


def test_aggregative_tracking_follows_costs_that_change():
    targets = Targets()
    agents = team(GRAPH, lambda i, w: targets.agent(i, w, step=0.03, rounds=4000))
    run_in_step(agents, GRAPH, 1500)
    assert gathered(agents, "x") == pytest.approx(targets.optimum(), abs=1e-4)
    targets.b, targets.r = np.array([-3.0, 0.5]), targets.r[::-1].copy()
    run_in_step(agents, GRAPH)
    assert gathered(agents, "x") == pytest.approx(targets.optimum(), abs=1e-4)
    assert np.abs(targets.r - targets.r[::-1]).max() > 0.5


@pytest.mark.parametrize("graph", [GRAPH, CHANGING, graphs.ring(6)])
def test_gradient_tracking_reaches_the_central_optimum_linearly(graph):
    agents = team(
        graph,
        lambda i, w: GradientTracking(i, np.zeros(3), w, Q.gradient(i), 0.01),
        graphs.metropolis,
    )
    errors = []
    for k in stepwise(agents, graph, 2400):
        if k % 600 == 599:
            errors.append(np.abs(gathered(agents, "x") - Q.optimum).max())
    assert errors[-1] < 1e-10
    assert all(
        later < 0.1 * earlier or later < 1e-13 for earlier, later in pairwise(errors)
    )


@pytest.mark.parametrize("graph", [DIRECTED, graphs.ring(6, directed=True)])
def test_directed_gradient_tracking_reaches_the_central_optimum(graph):
    pull, push = (
        rows(graph, graphs.row_stochastic),
        columns(graph, graphs.column_stochastic),
    )
    agents = {
        i: DirectedGradientTracking(
            i, np.zeros(3), pull[i], push[i], Q.gradient(i), 0.005, 6000
        )
        for i in range(6)
    }
    run_in_step(agents, graph)
    assert gathered(agents, "x") == pytest.approx(np.tile(Q.optimum, (6, 1)), abs=1e-10)


def test_gradient_tracking_on_a_directed_graph_with_rows_alone_would_end_elsewhere():
    """Why the directed one needs shares, too: with row-stochastic weights for both, it solves another problem."""

    class Unchecked(GradientTracking):
        doubly_stochastic = False

    weights = graphs.row_stochastic
    agents = team(
        DIRECTED,
        lambda i, w: Unchecked(i, np.zeros(3), w, Q.gradient(i), 0.005, 6000),
        weights,
    )
    run_in_step(agents, DIRECTED)
    assert np.abs(gathered(agents, "x") - Q.optimum).max() > 1e-2
