import cvxpy as cp
import numpy as np
import pytest
from in_step import run_in_step
from quadratics import costs, optimum, problems, recorded

from crazychoir.errors import AgentFailed, ConfigError, SolverError
from crazychoir.optimization.algorithms.dual_decomposition import DualDecomposition
from crazychoir.optimization.problems.problems import CostCoupled
from crazychoir.optimization.rounds.step_size import Diminishing
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import GraphSequence, erdos_renyi_connected, path, ring


def agents(parts, step=0.4, rounds=400):
    return {part.agent: DualDecomposition(part, step, rounds) for part in parts}


def test_it_gives_the_recorded_iterates(reference_data):
    """Ring of 5, 300 iterations with 0.5 / (k + 1)^0.51; that counts the minimisation before the first exchange."""
    data, parts = recorded(reference_data("disropt"), "dualdecomp_ring_N5")
    team = agents(parts, Diminishing(0.5, 0.51), data["iterations"] - 1)
    history = simulate(team, ring(5))
    np.testing.assert_allclose(history.of()[:, -1], data["x_final"], atol=1e-9)
    assert np.abs(history.of()[:, -1] - data["x_opt"]).max() < 1.01 * data["max_err"]


@pytest.mark.parametrize("seed", range(5))
def test_it_finds_the_centralised_optimum(seed):
    parts = problems(costs(6, 3, seed))
    team = agents(parts)
    run_in_step(team, erdos_renyi_connected(6, 0.5, seed))
    np.testing.assert_allclose(
        [agent.x for agent in team.values()], np.tile(optimum(parts), (6, 1)), atol=1e-6
    )


def test_it_finds_it_where_the_sets_differ():
    x = cp.Variable(2)
    sets = [[x[0] >= 0.5], [cp.norm(x) <= 1], [x[0] + x[1] == 0.3]]
    parts = [
        CostCoupled(i, x, cp.sum_squares(x - i), own) for i, own in enumerate(sets)
    ]
    team = agents(parts, rounds=300)
    run_in_step(team, path(3))
    np.testing.assert_allclose(
        [agent.x for agent in team.values()], np.tile(optimum(parts), (3, 1)), atol=1e-5
    )


def test_it_finds_it_on_a_changing_graph():
    parts, graph = (
        problems(costs(6, 2, 4)),
        GraphSequence.draw(erdos_renyi_connected(6, 0.6, 1), 0.4, 4, 2),
    )
    team = agents(parts, rounds=800)
    run_in_step(team, graph)
    np.testing.assert_allclose(
        [agent.x for agent in team.values()], np.tile(optimum(parts), (6, 1)), atol=1e-6
    )


def test_the_iterates_are_the_same_whatever_is_lost():
    parts = problems(costs(5, 2, 1))
    histories = [
        simulate(agents(parts, rounds=60), ring(5), loss=loss).of()
        for loss in (0.0, 0.4)
    ]
    assert np.array_equal(*histories)


def test_an_infeasible_agent_ends_the_team_with_its_name():
    x = cp.Variable(2)
    parts = problems(costs(4, 2, 0))
    parts[2] = CostCoupled(2, x, cp.sum_squares(x), [x <= 1, x[1] >= 2])
    with pytest.raises(
        SolverError, match=r"agent 2: local problem: .*infeasible: .*violated by"
    ):
        simulate(agents(parts), ring(4), loss=0.3)


def test_a_message_of_another_dimension_names_both_agents():
    team = agents(problems(costs(2, 2, 0)))
    team[0].message()
    with pytest.raises(
        ConfigError,
        match=r"agent 0: message of agent 1: found shape \(3,\); allowed: shape \(2,\)",
    ):
        team[0].step({1: np.zeros(3)})
    with pytest.raises(ConfigError, match="agent 0: message of agent 1: found str"):
        team[0].step({1: "x"})


def test_what_is_not_a_number_is_told_to_all():
    class Broken(DualDecomposition):
        def message(self):
            return np.full(2, np.nan)

    parts = problems(costs(3, 2, 0))
    team = agents(parts) | {1: Broken(parts[1], 0.4)}
    with pytest.raises(
        AgentFailed, match=r"agent 1 has failed, .*: round 0: nan in message\(\)\[0\]"
    ):
        simulate(team, path(3))


def test_a_directed_graph_is_refused():
    with pytest.raises(
        ConfigError,
        match="graph of DualDecomposition: found agent 1 hears agent 0, but not",
    ):
        simulate(agents(problems(costs(4, 2, 0))), ring(4, directed=True))
