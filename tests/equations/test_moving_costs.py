"""Prediction and correction, and coupled predictive control: their equations in matrix form."""

import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.optimization.algorithms.time_varying.coupled_control import (
    CoupledMPC,
    OutputCoupling,
)
from crazychoir.optimization.algorithms.time_varying.prediction_correction import (
    MovingCost,
    PredictionCorrection,
    Sampling,
)
from crazychoir.optimization.predictive_control import Prediction
from crazychoir.team.graph import erdos_renyi_connected, path

GRAPH = erdos_renyi_connected(5, 0.5, 2)
C = 0.7
CHANCE = np.random.default_rng(0)
P = [a @ a.T + np.eye(2) for a in CHANCE.normal(size=(5, 2, 2))]
PHASE = CHANCE.uniform(0, 6, (5, 2))
DEGREES = np.array([len(GRAPH.neighbors(i)) for i in range(5)], float)
ADJACENCY = np.array(
    [[float(j in GRAPH.neighbors(i)) for j in range(5)] for i in range(5)]
)


def cost(i, exact):
    """f_i(y; t) = 1/2 (y - b_i)'P_i (y - b_i) + sum exp(y - t)/9,  b_i = cos(t + phase)."""
    return MovingCost(
        lambda y, t: P[i] @ (y - np.cos(t + PHASE[i])) + np.exp(y - t) / 9,
        lambda y, t: P[i] + np.diag(np.exp(y - t)) / 9,
        C,
        (lambda y, t: P[i] @ np.sin(t + PHASE[i]) - np.exp(y - t) / 9)
        if exact
        else None,
    )


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("K", [0, 2])
def test_prediction_and_correction_follow_the_equations(K, exact):
    """p = -H_K r with H_K = sum_n=0..K (D^-1 B)^n D^-1, the truncated inverse of the Hessian of F."""
    h, a, corrections = 0.1, 0.1, 2
    costs = [cost(i, exact) for i in range(5)]
    agents = {
        i: PredictionCorrection(
            i, [1.0, i], GRAPH.neighbors(i), costs[i], a, Sampling(h, corrections, K)
        )
        for i in range(5)
    }
    y = np.array([[1.0, i] for i in range(5)])
    laplacian = np.kron(np.diag(DEGREES) - ADJACENCY, np.eye(2))
    B = C * np.kron(ADJACENCY, np.eye(2))

    def gradients(y, t):
        return np.concatenate([costs[i].gradient(y[i], t) for i in range(5)])

    for k in range(6):
        run_in_step(agents, GRAPH, corrections + K)
        t = k * h
        for _ in range(corrections):
            y = y - a * (gradients(y, t) + C * laplacian @ y.ravel()).reshape(5, 2)
        x = np.array([agent.x for agent in agents.values()])
        assert x == pytest.approx(y, abs=1e-12)
        D = np.kron(np.diag(C * DEGREES), np.eye(2))
        for i in range(5):
            D[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += costs[i].hessian(y[i], t)
        if exact:
            r = np.concatenate([costs[i].rate(y[i], t) for i in range(5)])
        else:
            r = (gradients(y, t) - gradients(y, t - h)) / h * (k > 0)
        inverse = np.linalg.inv(D)
        H = sum(np.linalg.matrix_power(inverse @ B, n) @ inverse for n in range(K + 1))
        y = y - h * (H @ r).reshape(5, 2)
        ahead = np.array([agent.y for agent in agents.values()])
        assert ahead == pytest.approx(y, abs=1e-12)


def test_coupled_control_is_admm_with_copies_of_both_outputs_of_an_edge():
    """Without limits a plan is linear in x and z, so that a round is one of matrices."""
    steps, rho, reach = 3, 2.0, 0.4
    none, one, no_limits = np.zeros((0, 1)), np.eye(1), np.zeros(0)
    of = Prediction(one, one, one, one, one, none, no_limits, none, no_limits, steps)
    graph, start = path(3), np.array([2.0, 0.0, -1.0])
    agents = {
        i: CoupledMPC(
            i, [start[i]], graph.neighbors(i), of, OutputCoupling(reach, rho, 99)
        )
        for i in range(3)
    }
    sums = np.tril(np.ones((steps, steps)))  # y = x + sums U

    def plan(x, z, degree):
        """Argmin sum_t<T x_t^2 + |U|^2 + rho degree/2 |y - z|^2; the last state costs nothing."""
        early = sums[:-1]
        pull = rho * degree
        hessian = 2 * early.T @ early + 2 * np.eye(steps) + pull * sums.T @ sums
        slope = 2 * early.T @ np.full(steps - 1, x) + pull * sums.T @ (x - z)
        return x - sums @ np.linalg.solve(hessian, slope)

    edges = [(0, 1), (1, 2)]
    dual = {(e, i): np.zeros(steps) for e in edges for i in e}
    degree = [1, 2, 1]
    y = [plan(start[i], np.zeros(steps), 0) for i in range(3)]
    for _ in range(12):
        run_in_step(agents, graph, 1)
        copy = {}
        for i, j in edges:  # the nearest pair of outputs within the reach
            v, w = y[i] + dual[(i, j), i], y[j] + dual[(i, j), j]
            over = ((v - w) - np.clip(v - w, -reach, reach)) / 2
            copy[(i, j), i], copy[(i, j), j] = v - over, w + over
            dual[(i, j), i], dual[(i, j), j] = over, -over
        target = [
            np.mean([copy[e, i] - dual[e, i] for e in edges if i in e], axis=0)
            for i in range(3)
        ]
        y = [plan(start[i], target[i], degree[i]) for i in range(3)]
        for i in range(3):
            assert agents[i].y[:, 0] == pytest.approx(y[i], abs=1e-9)
