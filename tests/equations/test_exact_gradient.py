"""The equations of the exact first-order algorithms and of their ADMM kin, beside their matrix forms."""

import random

import cvxpy as cp
import numpy as np
import pytest

from crazychoir.optimization.algorithms.exact_gradient.exact_diffusion import (
    ExactDiffusion,
)
from crazychoir.optimization.algorithms.exact_gradient.extra import EXTRA
from crazychoir.optimization.algorithms.exact_gradient.linearised_admm import (
    LinearisedADMM,
)
from crazychoir.optimization.algorithms.exact_gradient.nids import NIDS
from crazychoir.optimization.algorithms.exact_gradient.pg_extra import PGEXTRA
from crazychoir.optimization.algorithms.exact_gradient.prox_skip import (
    ProxSkip,
    SharedCoin,
)
from crazychoir.optimization.algorithms.exact_gradient.relaxed_admm import RelaxedADMM
from crazychoir.optimization.generate import random_quadratics
from crazychoir.optimization.problems.composite import (
    CompositeCost,
    l1_proximal,
    projection_proximal,
)
from crazychoir.optimization.problems.problems import CostCoupled
from crazychoir.optimization.problems.projection import Box
from crazychoir.optimization.rounds.mixing import team
from crazychoir.team.graph import erdos_renyi_connected, metropolis
from crazychoir.types import PerNeighbor

Q = random_quadratics(6, 3, seed=1)
GRAPH = erdos_renyi_connected(6, 0.5, 1)
START = np.random.default_rng(7).normal(size=(6, 3))
STEP = 0.03
ROUNDS = 25
IDENTITY = np.eye(6)
ADJACENCY = np.array(
    [[float(j in GRAPH.neighbors(i)) for j in range(6)] for i in range(6)]
)
DEGREES = np.diag(ADJACENCY.sum(axis=1))
W = np.array([[metropolis(GRAPH)[i].get(j, 0.0) for j in range(6)] for i in range(6)])
V = (IDENTITY + W) / 2


def gradients(x):
    """Return the gradient of each agent at its row of x."""
    return np.einsum("inm,im->in", Q.p, x) + Q.q


def shrink(z, threshold):
    """Return the soft threshold of each row of z."""
    return np.sign(z) * np.maximum(np.abs(z) - threshold, 0.0)


def iterates(agents, rounds=ROUNDS):
    """Yield the x of all agents after each round."""
    for _ in range(rounds):
        sent = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            heard = {j: sent[j] for j in GRAPH.neighbors(i)}
            agent.step(
                {j: m[i] if isinstance(m, PerNeighbor) else m for j, m in heard.items()}
            )
        yield np.array([agent.x for agent in agents.values()])


def assert_equal(agents, reference):
    """Compare the iterates of the agents, from the first round on, with x(1), x(2), ..."""
    for found, wanted in zip(iterates(agents, len(reference)), reference, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-12)


def test_extra_follows_its_equation():
    """x(k+2) = (I + W) x(k+1) - V x(k) - a [g(x(k+1)) - g(x(k))]."""
    x = [START, W @ START - STEP * gradients(START)]
    while len(x) <= ROUNDS:
        change = gradients(x[-1]) - gradients(x[-2])
        x.append((IDENTITY + W) @ x[-1] - V @ x[-2] - STEP * change)
    agents = team(GRAPH, lambda i, w: EXTRA(i, START[i], w, Q.gradient(i), STEP))
    assert_equal(agents, x[1:])


def test_pg_extra_follows_its_equation():
    """z(k+2) = W x(k+1) + z(k+1) - V x(k) - a [g(x(k+1)) - g(x(k))],  x = prox(z)."""
    weight = 0.4
    z = W @ START - STEP * gradients(START)
    x = [START, shrink(z, weight * STEP)]
    while len(x) <= ROUNDS:
        change = gradients(x[-1]) - gradients(x[-2])
        z = W @ x[-1] + z - V @ x[-2] - STEP * change
        x.append(shrink(z, weight * STEP))
    agents = team(
        GRAPH,
        lambda i, w: PGEXTRA(
            i, START[i], w, CompositeCost(Q.gradient(i), l1_proximal(weight)), STEP
        ),
    )
    assert_equal(agents, x[1:])
    assert np.any(x[-1] == 0.0)


def test_nids_follows_its_equation_with_a_step_of_its_own_at_each_agent():
    """z(k+1) = z(k) - x(k) + [I - c A (I - W)] (2 x(k) - x(k-1) - A [g(x(k)) - g(x(k-1))])."""
    weight = 0.4
    steps = np.linspace(0.02, 0.06, 6)
    A = np.diag(steps)
    coupling = 0.5 / steps.max()
    mixing = IDENTITY - coupling * A @ (IDENTITY - W)
    z = START - A @ gradients(START)
    x = [START, shrink(z, weight * steps[:, None])]
    while len(x) <= ROUNDS + 1:
        change = gradients(x[-1]) - gradients(x[-2])
        z = z - x[-1] + mixing @ (2 * x[-1] - x[-2] - A @ change)
        x.append(shrink(z, weight * steps[:, None]))
    agents = team(
        GRAPH,
        lambda i, w: NIDS(
            i,
            START[i],
            w,
            CompositeCost(Q.gradient(i), l1_proximal(weight)),
            steps[i],
            coupling,
        ),
    )
    np.testing.assert_allclose([a.x for a in agents.values()], x[1], atol=1e-15)
    assert_equal(agents, x[2:])


def test_exact_diffusion_follows_its_equation():
    """p(k+1) = x(k) - a g(x(k)),  x(k+1) = V (p(k+1) + x(k) - p(k)),  p(0) = x(0)."""
    x = [START]
    p = START
    for _ in range(ROUNDS):
        adapted = x[-1] - STEP * gradients(x[-1])
        x.append(V @ (adapted + x[-1] - p))
        p = adapted
    agents = team(
        GRAPH, lambda i, w: ExactDiffusion(i, START[i], w, Q.gradient(i), STEP)
    )
    assert_equal(agents, x[1:])


def proxskip_reference(p, seed):
    """Return x after each communication, and the number of gradient steps of all."""
    toss = random.Random(seed)  # noqa: S311 - when to send, not secrets
    x = START
    h = np.zeros_like(START)
    found = []
    steps = 0
    while len(found) < ROUNDS:
        y = x - STEP * (gradients(x) - h)
        steps += 1
        communicate = toss.random() < p
        x = V @ y if communicate else y
        h = h + p / STEP * (x - y)
        if communicate:
            found.append(x)
    return found, steps


@pytest.mark.parametrize("p", [1.0, 0.3])
def test_proxskip_follows_its_equation_and_sends_only_where_the_coin_says_it(p):
    reference, steps = proxskip_reference(p, seed=5)
    agents = team(
        GRAPH,
        lambda i, w: ProxSkip(
            i, START[i], w, Q.gradient(i), STEP, SharedCoin(p, seed=5)
        ),
    )
    start_steps = [agent.steps for agent in agents.values()]
    assert_equal(agents, reference)
    assert len(set(start_steps)) == 1
    assert {agent.steps for agent in agents.values()} == {agents[0].steps}
    assert agents[0].steps > steps, "those of the next round are done too"
    assert (agents[0].steps == ROUNDS + 1) == (p == 1.0)


def test_proxskip_without_skips_is_exact_diffusion():
    skipping = team(
        GRAPH,
        lambda i, w: ProxSkip(i, START[i], w, Q.gradient(i), STEP, SharedCoin(1.0)),
    )
    diffusing = team(
        GRAPH, lambda i, w: ExactDiffusion(i, START[i], w, Q.gradient(i), STEP)
    )
    assert_equal(skipping, list(iterates(diffusing)))


def test_linearised_admm_follows_its_equation():
    """x(k+1) = x(k) - B^-1 [g(x(k)) + c K x(k) + l(k)],  K = D - A,  B = 2 c D + rho."""
    penalty = 0.7
    proximity = np.linspace(8.0, 12.0, 6)
    K = DEGREES - ADJACENCY
    B = 2 * penalty * DEGREES + np.diag(proximity)
    x = [START]
    multiplier = np.zeros_like(START)
    for _ in range(ROUNDS):
        force = gradients(x[-1]) + penalty * K @ x[-1] + multiplier
        x.append(x[-1] - np.linalg.solve(B, force))
        multiplier = multiplier + penalty * K @ x[-1]
    agents = {
        i: LinearisedADMM(
            i, START[i], GRAPH.neighbors(i), Q.gradient(i), penalty, proximity[i]
        )
        for i in GRAPH.ids
    }
    assert_equal(agents, x[1:])


def test_relaxed_admm_follows_its_equation_with_the_messages_that_arrive():
    """x_i = (P_i + rho d_i)^-1 (sum_j z_ij - q_i),  z_ji <- (1 - a) z_ji + a (2 rho x_i - z_ij)."""
    penalty = 0.8
    relaxation = 0.6
    x = cp.Variable(3)
    agents = {
        i: RelaxedADMM(
            CostCoupled(i, x, 0.5 * cp.quad_form(x, Q.p[i]) + Q.q[i] @ x),
            GRAPH.neighbors(i),
            penalty,
            relaxation,
        )
        for i in GRAPH.ids
    }
    z = np.zeros((6, 6, 3))
    arrives = np.random.default_rng(3)
    for _ in range(ROUNDS):
        sums = np.einsum("ij,ijn->in", ADJACENCY, z)
        best = np.array(
            [
                np.linalg.solve(
                    Q.p[i] + penalty * DEGREES[i, i] * np.eye(3), sums[i] - Q.q[i]
                )
                for i in GRAPH.ids
            ]
        )
        sent = {i: agent.message() for i, agent in agents.items()}
        np.testing.assert_allclose([a.x for a in agents.values()], best, atol=1e-11)
        got = arrives.random((6, 6)) < 0.6
        before = z.copy()
        for i, agent in agents.items():
            heard = [j for j in GRAPH.neighbors(i) if got[i, j]]
            agent.step({j: sent[j][i] for j in heard})
            for j in heard:
                q = 2 * penalty * best[j] - before[j, i]
                z[i, j] = (1 - relaxation) * before[i, j] + relaxation * q


def test_the_proximal_operators_minimise_what_they_say():
    z = np.array([-1.3, -0.1, 0.2, 2.0])
    a = 0.7
    x = cp.Variable(4)
    for found, penalty, rows in (
        (l1_proximal(0.6)(z, a), 0.6 * cp.norm1(x), []),
        (projection_proximal(Box(-1.0, 0.1).project)(z, a), 0.0, [x >= -1.0, x <= 0.1]),
    ):
        cost = penalty + cp.sum_squares(x - z) / (2 * a)
        cp.Problem(cp.Minimize(cost), rows).solve(solver=cp.CLARABEL)
        np.testing.assert_allclose(found, x.value, atol=1e-6)
