import cvxpy as cp
import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.errors import ConfigError
from crazychoir.optimization.algorithms.dual_subgradient import DualSubgradient
from crazychoir.optimization.problems.problems import ConstraintCoupled
from crazychoir.optimization.rounds.mixing import team
from crazychoir.optimization.rounds.step_size import Diminishing
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import GraphSequence, erdos_renyi_connected, ring


def coupled(count, seed, kind):
    """Agents of dimension 1 to 3 that want more of two resources than there is."""
    draw, parts = np.random.default_rng(seed), []
    for i in range(count):
        x = cp.Variable(1 + i % 3)
        want, G = draw.uniform(1, 2, x.size), draw.uniform(0.5, 1.5, (2, x.size))
        objective = {"linear": -want @ x, "quadratic": cp.sum_squares(x - want)}[kind]
        coupling = G @ x if i % 2 or kind == "linear" else [G[0] @ x, cp.sum_squares(x)]
        parts.append(
            ConstraintCoupled(
                i,
                x,
                objective,
                coupling,
                [x >= 0, x <= 2],
                share=draw.uniform(0.4, 0.8, 2),
            )
        )
    return parts


def centralised(parts):
    excess = sum(part.coupling - part.share for part in parts) <= 0
    local = [c for part in parts for c in part.local.constraints]
    problem = cp.Problem(
        cp.Minimize(sum(part.local.objective for part in parts)), [excess, *local]
    )
    problem.solve(solver=cp.CLARABEL)
    return (
        problem.value,
        [np.atleast_1d(part.x.value).copy() for part in parts],
        excess.dual_value,
    )


def agents(parts, graph, step, rounds):
    return team(
        graph, lambda i, weights: DualSubgradient(parts[i], weights, step, rounds)
    )


@pytest.mark.parametrize("seed", range(3))
def test_it_comes_near_the_centralised_optimum_and_its_prices(seed):
    """As near as the step size lets neighbours differ: 2 / 800^0.6 is 0.04."""
    parts, graph = coupled(5, seed, "quadratic"), erdos_renyi_connected(5, 0.5, seed)
    _, x, prices = centralised(parts)
    found = agents(parts, graph, Diminishing(2.0, 0.6), 800)
    run_in_step(found, graph)
    for i, agent in found.items():
        np.testing.assert_allclose(agent.x, x[i], atol=0.05)
        np.testing.assert_allclose(agent.prices, prices, atol=0.15)


def scalars():
    """min sum_i (x_i - i - 1)^2  s.t.  sum_i x_i <= 5: all give up 2."""
    parts = []
    for i in range(5):
        x = cp.Variable()
        parts.append(
            ConstraintCoupled(i, x, cp.square(x - i - 1), x, share=np.array([1.0]))
        )
    return parts


@pytest.mark.parametrize("graph", [ring(5), GraphSequence.draw(ring(5), 0.4, 3, 1)])
def test_it_comes_the_nearer_the_longer_it_runs(graph):
    def error(rounds):
        found = agents(scalars(), graph, Diminishing(2.0, 0.8), rounds)
        run_in_step(found, graph)
        return max(abs(agent.x[0] - i + 1) for i, agent in found.items())

    assert error(2000) < 0.25 * error(200)
    assert error(2000) < 0.05


def test_the_average_finds_it_where_x_jumps_between_corners():
    parts = coupled(5, 1, "linear")
    value, *_ = centralised(parts)
    found = agents(parts, ring(5), Diminishing(2.0, 0.6), 800)
    run_in_step(found, ring(5))
    cost = sum(part.local.value(found[i].average) for i, part in enumerate(parts))
    excess = sum(part.excess(found[i].average) for i, part in enumerate(parts))
    assert cost == pytest.approx(value, rel=0.04)
    assert excess.max() < 0.15
    assert all(np.isin(found[i].x, [0.0, 2.0]).all() for i in found)


def test_the_iterates_are_the_same_whatever_is_lost():
    parts = coupled(4, 3, "quadratic")

    def run(loss):
        return simulate(
            agents(parts, ring(4), 0.3, 40), ring(4), loss=loss, record=("x", "prices")
        )

    kept, lossy = run(0.0), run(0.4)
    assert np.array_equal(kept.of("prices"), lossy.of("prices"))
    assert all(
        np.array_equal(kept.values[i]["x"], lossy.values[i]["x"]) for i in range(4)
    )


def test_agents_without_a_message_have_no_average_yet():
    agent = DualSubgradient(coupled(1, 0, "quadratic")[0], {0: 1.0}, 0.1)
    assert agent.average.tolist() == [0.0]


def test_prices_of_another_number_of_constraints_name_both_agents():
    agent = DualSubgradient(coupled(2, 0, "quadratic")[0], {0: 0.5, 1: 0.5}, 0.1)
    agent.message()
    with pytest.raises(
        ConfigError, match=r"agent 0: message of agent 1: found shape \(3,\)"
    ):
        agent.step({1: [0.5, np.zeros(3)]})
