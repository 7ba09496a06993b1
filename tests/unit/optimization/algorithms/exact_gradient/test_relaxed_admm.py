"""Relaxed ADMM: the centralised optimum though lost messages stay lost."""

import cvxpy as cp
import numpy as np
import pytest
from quadratics import costs, optimum, problems

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.exact_gradient.relaxed_admm import RelaxedADMM
from crazychoir.optimization.problems.problems import CostCoupled
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import erdos_renyi_connected, path, ring


def make_team(parts, graph, rounds, penalty=3.0, relaxation=0.5):
    return {
        part.agent: RelaxedADMM(
            part, graph.neighbors(part.agent), penalty, relaxation, rounds
        )
        for part in parts
    }


@pytest.mark.parametrize(
    ("seed", "loss", "rounds"),
    [(0, 0.0, 200), (0, 0.4, 250), (1, 0.4, 350), (0, 0.7, 450)],
)
def test_it_finds_the_centralised_optimum_though_lost_messages_stay_lost(
    seed, loss, rounds
):
    parts = problems(costs(6, 3, seed))
    graph = erdos_renyi_connected(6, 0.5, seed)
    history = simulate(make_team(parts, graph, rounds), graph, loss=loss, seed=seed)
    np.testing.assert_allclose(
        list(history.last().values()), np.tile(optimum(parts), (6, 1)), atol=1e-6
    )
    assert history.resent == 0
    assert history.lost == pytest.approx(loss * history.messages, rel=0.1)


def test_it_needs_neither_strong_convexity_nor_smoothness():
    x = cp.Variable(2)
    objectives = [cp.norm1(x - 1), x[0], cp.norm(x + 1), 2 * cp.max(x)]
    parts = [CostCoupled(i, x, f, [x >= -2, x <= 3]) for i, f in enumerate(objectives)]
    history = simulate(make_team(parts, path(4), 300, penalty=1.0), path(4), loss=0.4)
    np.testing.assert_allclose(
        list(history.last().values()), np.tile(optimum(parts), (4, 1)), atol=1e-3
    )


def test_a_message_counts_once():
    part = problems(costs(3, 2, 0))[1]
    agent, twin = (RelaxedADMM(part, (0, 2), 1.0) for _ in range(2))
    agent.step({0: [4, np.ones(2)]})
    twin.step({0: [4, np.ones(2)]})
    agent.step({0: [4, np.ones(2)]})
    agent.step({0: [3, -np.ones(2)]})
    assert agent.x.tolist() == twin.x.tolist()
    agent.step({0: [5, np.ones(2)]})
    assert agent.x.tolist() != twin.x.tolist()


def test_penalties_and_relaxations_that_must_be_common_are_compared():
    parts = problems(costs(4, 2, 0))
    for name in ("penalty", "relaxation"):
        agents = make_team(parts, ring(4), 5)
        setattr(agents[2], name, 0.7)
        with pytest.raises(ConfigError, match=f"agent 2: {name}: .*, as agent 0's"):
            simulate(agents, ring(4))


def test_what_is_wrong_is_named():
    part = problems(costs(3, 2, 0))[1]
    for penalty, relaxation, error in (
        (0.0, 0.5, "agent 1: penalty: found 0.0; allowed: above 0, below inf"),
        (1.0, 1.0, "agent 1: relaxation: found 1.0; allowed: above 0, below 1"),
    ):
        with pytest.raises(ConfigError, match=error):
            RelaxedADMM(part, (0, 2), penalty, relaxation)
    agent = RelaxedADMM(part, (0, 2), 1.0)
    with pytest.raises(ConfigError, match=r"message of agent 3: .*neighbors \[0, 2\]"):
        agent.step({3: [0, np.zeros(2)]})
    with pytest.raises(ConfigError, match="message of agent 0, round 0: found shape"):
        agent.step({0: np.zeros(2)})
    x = cp.Variable(2)
    infeasible = CostCoupled(0, x, x[0], [x >= 1, x <= 0])
    with pytest.raises(SolverError, match=r"agent 0: local problem: .*infeasible"):
        RelaxedADMM(infeasible, (1,), 1.0).message()
