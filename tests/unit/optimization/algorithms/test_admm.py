import subprocess
import sys

import cvxpy as cp
import numpy as np
import pytest
from in_step import run_in_step
from quadratics import costs, optimum, problems, recorded

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.admm import ADMM
from crazychoir.optimization.problems.problems import CostCoupled
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import Graph, erdos_renyi_connected, path, ring


def agents(parts, graph, penalty=3.0, iterations=100):
    return {
        part.agent: ADMM(part, graph.neighbors(part.agent), penalty, iterations)
        for part in parts
    }


def test_it_gives_the_recorded_iterates(reference_data):
    """Erdős–Rényi graph of 5, 100 iterations; that counts the minimisation before the first exchange."""
    data, parts = recorded(reference_data("disropt"), "admm_er_N5")
    graph = Graph.from_neighbors(
        {i: np.flatnonzero(row).tolist() for i, row in enumerate(data["Adj"])}
    )
    history = simulate(
        agents(parts, graph, data["penalty"], data["iterations"] - 1), graph
    )
    np.testing.assert_allclose(history.of()[:, -1], data["x_final"], atol=1e-9)
    assert np.abs(history.of()[:, -1] - data["x_opt"]).max() < 1.01 * data["max_err"]


@pytest.mark.parametrize("seed", range(5))
def test_it_finds_the_centralised_optimum(seed):
    parts, graph = problems(costs(6, 3, seed)), erdos_renyi_connected(6, 0.5, seed)
    team = agents(parts, graph)
    assert run_in_step(team, graph) == 200
    assert team[0].iterations == 100
    np.testing.assert_allclose(
        [agent.x for agent in team.values()], np.tile(optimum(parts), (6, 1)), atol=1e-7
    )


def test_it_needs_neither_strong_convexity_nor_smoothness():
    x = cp.Variable(2)
    objectives = [cp.norm1(x - 1), x[0], cp.norm(x + 1), 2 * cp.max(x)]
    parts = [CostCoupled(i, x, f, [x >= -2, x <= 3]) for i, f in enumerate(objectives)]
    assert parts[1].solver() == "HiGHS"
    team = agents(parts, path(4), iterations=400)
    run_in_step(team, path(4))
    np.testing.assert_allclose(
        [agent.x for agent in team.values()], np.tile(optimum(parts), (4, 1)), atol=1e-4
    )


def test_the_iterates_are_the_same_whatever_is_lost():
    parts = problems(costs(5, 2, 1))
    histories = [
        simulate(agents(parts, ring(5), iterations=30), ring(5), loss=loss).of()
        for loss in (0.0, 0.4)
    ]
    assert np.array_equal(*histories)


def test_what_is_wrong_is_named():
    parts = problems(costs(3, 2, 0))
    with pytest.raises(
        ConfigError,
        match=r"agent 1: penalty: found 0\.0; allowed: a finite number above 0",
    ):
        ADMM(parts[1], (0, 2), 0.0)
    agent = ADMM(parts[1], (0, 2), 1.0)
    agent.message()
    with pytest.raises(
        ConfigError,
        match=r"agent 1: found messages of \[0\]; .* of its neighbors \[0, 2\]",
    ):
        agent.step({0: np.zeros(2)})
    x = cp.Variable(2)
    with pytest.raises(SolverError, match=r"agent 0: local problem: .*infeasible"):
        ADMM(CostCoupled(0, x, x[0], [x >= 1, x <= 0]), (1,), 1.0).message()


@pytest.mark.parametrize("own", ["equalities", "both", "zero"])
def test_a_team_with_an_infeasible_agent_fails_and_names_it(own):
    x = cp.Variable(2, name="x")
    rows = {
        "equalities": [x[0] == 1, x[0] == 2],
        "both": [x[0] == 1, x[0] <= 0],
        "zero": [0 * x == 1],
    }[own]
    parts = [
        CostCoupled(i, x, cp.sum_squares(x - i), rows if i == 2 else [])
        for i in range(4)
    ]
    with pytest.raises(
        SolverError, match=r"agent 2: local problem: .* infeasible: constraints\[\d\]"
    ):
        simulate(agents(parts, ring(4)), ring(4))


INFEASIBLE = """
import cvxpy as cp
from crazychoir.optimization.algorithms.admm import ADMM
from crazychoir.optimization.problems.problems import CostCoupled

def agent(i, graph):
    x = cp.Variable(2)
    own = [x[0] == 1, x[0] == 2] if i == 1 else []
    return ADMM(CostCoupled(i, x, cp.sum_squares(x - i), own), graph.neighbors(i), penalty=1.0, iterations=5)
"""


def test_the_command_line_ends_with_the_conflict_and_an_exit_code(tmp_path):
    file = tmp_path / "conflict.py"
    file.write_text(INFEASIBLE)
    command = [
        sys.executable,
        "-m",
        "crazychoir.cli.main",
        "simulate",
        str(file),
        "--agents",
        "3",
    ]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert ended.returncode != 0
    assert "agent 1: local problem" in ended.stderr
    assert "exclude" in ended.stderr or "infeasible" in ended.stderr
    assert "Traceback" not in ended.stderr
