"""The exact first-order algorithms: the centralised optimum, with lost messages too, their bounds, clear errors."""

import re

import cvxpy as cp
import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.errors import ConfigError
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
from crazychoir.optimization.problems.composite import CompositeCost, l1_proximal
from crazychoir.optimization.rounds.mixing import rows, team
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import (
    GraphSequence,
    complete,
    erdos_renyi_connected,
    metropolis,
    path,
    ring,
)

START = np.zeros(3)
AGENTS = 6


class LeastSquares:
    """f_i(x) = |A_i x - b_i|^2 / 2 with two rows each: no f_i alone has a unique minimiser of x (3,)."""

    def __init__(self, seed):
        chance = np.random.default_rng(seed)
        directions = np.linalg.qr(chance.normal(size=(AGENTS, 3, 2)))[0]
        scales = chance.uniform(0.7, 1.3, (AGENTS, 2, 1))
        self.a = scales * directions.transpose(0, 2, 1)
        self.b = chance.normal(size=(AGENTS, 2))
        self.graph = erdos_renyi_connected(AGENTS, 0.5, seed)
        self.own = [float(np.linalg.norm(a, 2) ** 2) for a in self.a]
        self.smoothness = max(self.own)
        row = metropolis(self.graph)
        w = [[row[i].get(j, 0.0) for j in range(AGENTS)] for i in range(AGENTS)]
        self.least_eigenvalue = float(np.linalg.eigvalsh(w)[0])

    def gradient(self, i):
        return lambda x: self.a[i].T @ (self.a[i] @ x - self.b[i])

    def ridge_gradient(self, i):
        return lambda x: self.gradient(i)(x) + 0.5 * x

    def optimum(self, weight=0.0, ridge=0.0):
        """argmin sum_i f_i(x) + weight |x|_1 + ridge |x|^2 / 2."""
        x = cp.Variable(3)
        cost = 0.5 * cp.sum_squares(self.a.reshape(-1, 3) @ x - self.b.ravel())
        cost += AGENTS * (weight * cp.norm1(x) + 0.5 * ridge * cp.sum_squares(x))
        cp.Problem(cp.Minimize(cost)).solve(solver=cp.CLARABEL)
        return x.value


def extra(p, i, w):
    step = 0.95 * (1.0 + p.least_eigenvalue) / p.smoothness
    return EXTRA(i, START, w, p.gradient(i), step)


def pg_extra(p, i, w):
    step = 0.95 * (1.0 + p.least_eigenvalue) / p.smoothness
    cost = CompositeCost(p.gradient(i), l1_proximal(0.1))
    return PGEXTRA(i, START, w, cost, step)


def nids(p, i, w):
    cost = CompositeCost(p.gradient(i), l1_proximal(0.1))
    coupling = 0.5 * min(p.own) / 1.5
    return NIDS(i, START, w, cost, 1.5 / p.own[i], coupling)


def exact_diffusion(p, i, w):
    return ExactDiffusion(i, START, w, p.gradient(i), 1.5 / p.smoothness)


def prox_skip(p, i, w):
    step = 1.0 / (p.smoothness + 0.5)
    return ProxSkip(i, START, w, p.ridge_gradient(i), step, SharedCoin(0.3, seed=2))


def linearised_admm(p, i, w):
    return LinearisedADMM(
        i,
        START,
        p.graph.neighbors(i),
        p.gradient(i),
        penalty=0.2 * p.smoothness,
        proximity=0.55 * p.own[i],
    )


MAKERS = {
    "EXTRA": (extra, {}),
    "PG-EXTRA": (pg_extra, {"weight": 0.1}),
    "NIDS": (nids, {"weight": 0.1}),
    "exact diffusion": (exact_diffusion, {}),
    "ProxSkip": (prox_skip, {"ridge": 0.5}),
    "linearised ADMM": (linearised_admm, {}),
}
ROUNDS = 450


def make_team(name, problem, rounds=ROUNDS):
    make = MAKERS[name][0]
    agents = team(problem.graph, lambda i, w: make(problem, i, w))
    for agent in agents.values():
        agent.rounds = rounds
    return agents


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", MAKERS)
def test_it_finds_the_centralised_optimum_within_its_bound(name, seed):
    problem = LeastSquares(seed)
    agents = make_team(name, problem)
    assert run_in_step(agents, problem.graph) == ROUNDS
    optimum = problem.optimum(**MAKERS[name][1])
    np.testing.assert_allclose(
        [agent.x for agent in agents.values()], np.tile(optimum, (AGENTS, 1)), atol=1e-5
    )


@pytest.mark.parametrize("name", MAKERS)
def test_forty_percent_loss_changes_no_iterate(name):
    problem = LeastSquares(0)
    still, lossy = (
        simulate(make_team(name, problem, 40), problem.graph, loss=loss)
        for loss in (0.0, 0.4)
    )
    assert np.array_equal(still.of(), lossy.of())
    assert lossy.lost > 0
    assert still.lost == 0


def test_silent_rounds_of_proxskip_send_no_message():
    problem = LeastSquares(0)
    skipping = make_team("ProxSkip", problem, 40)
    silent = simulate(skipping, problem.graph)
    talking = simulate(make_team("EXTRA", problem, 40), problem.graph)
    assert silent.messages == talking.messages
    assert all(agent.steps > 100 for agent in skipping.values())


def test_proxskip_needs_fewer_messages_where_gradients_change_slowly():
    """L / m = 100; with p = 1 it is exact diffusion. Both send 100 messages to each neighbour."""
    graph = complete(4)
    optimum = 1.5

    scale = np.array([1.0, 0.01])

    def find_error(p):
        agents = team(
            graph,
            lambda i, w: ProxSkip(
                i, np.zeros(2), w, lambda x: scale * (x - i), 1.0, SharedCoin(p), 100
            ),
        )
        run_in_step(agents, graph)
        return max(np.abs(agent.x - optimum).max() for agent in agents.values())

    assert find_error(1.0) > 0.3
    assert find_error(0.1) < 1e-2


# The bounds of the steps ----------------------------------------------------------------------------


def spread_after(make, rounds=400):
    """Return the largest distance from the mean of 0 to 5 on a ring, where f_i = |x - i|^2 / 2, L = 1."""
    graph = ring(AGENTS)
    agents = team(graph, lambda i, w: make(i, w, lambda x: x - i))
    run_in_step(agents, graph, rounds)
    return max(abs(agent.x[0] - 2.5) for agent in agents.values())


BOUNDS = {
    "EXTRA": (
        lambda a: lambda i, w, g: EXTRA(i, [0.0], w, g, a),
        (5.0 - 3.0 / 3.0) / 4.0,
    ),
    "NIDS": (lambda a: lambda i, w, g: NIDS(i, [0.0], w, CompositeCost(g), a), 2.0),
    "exact diffusion": (
        lambda a: lambda i, w, g: ExactDiffusion(i, [0.0], w, g, a),
        2.0,
    ),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_iterates_grow_beyond_the_largest_step_and_not_below_it(name):
    """A ring of six has w = -1/3. For this cost EXTRA converges up to (5 + 3 w) / 4, and its bound is 1 + w."""
    make, largest = BOUNDS[name]
    assert spread_after(make(0.98 * largest)) < 1e-3
    assert spread_after(make(1.02 * largest)) > 1e2


def test_linearised_admm_converges_at_its_bound_and_not_far_beyond_it():
    def make(proximity):
        return lambda i, w, g: LinearisedADMM(
            i, [0.0], [j for j in w[0] if j != i], g, 0.01, proximity
        )

    assert spread_after(make(0.51), 2000) < 1e-3
    assert spread_after(make(0.4), 60) > 1e2


TOO_LARGE_STEPS = {
    "EXTRA": lambda i, w, g: EXTRA(i, START, w, g, 50.0),
    "PG-EXTRA": lambda i, w, g: PGEXTRA(i, START, w, CompositeCost(g), 50.0),
    "NIDS": lambda i, w, g: NIDS(i, START, w, CompositeCost(g), 50.0),
    "exact diffusion": lambda i, w, g: ExactDiffusion(i, START, w, g, 50.0),
    "ProxSkip": lambda i, w, g: ProxSkip(i, START, w, g, 50.0, SharedCoin(0.5)),
    "linearised ADMM": lambda i, w, g: LinearisedADMM(
        i, START, [j for j in w[0] if j != i], g, 0.004, 0.004
    ),
}


@pytest.mark.parametrize("name", TOO_LARGE_STEPS)
def test_step_that_is_too_large_is_named_with_its_bound(name):
    agents = team(ring(4), lambda i, w: TOO_LARGE_STEPS[name](i, w, lambda x: x - i))
    with pytest.raises(ConfigError) as error:
        run_in_step(agents, ring(4), 500)
    assert re.search(
        r"agent \d: step \d+.*, round \d+: found iterates that have grown from .*; "
        r"allowed: .*L.*\. Take a smaller step\.",
        str(error.value),
    )


# What is wrong is named -----------------------------------------------------------------------------

SMOOTH = CompositeCost(lambda x: x)
ROW = {0: 0.5, 1: 0.5}


def test_steps_that_must_be_common_are_compared():
    weights = rows(ring(4))
    for make, name in (
        (lambda i, a: EXTRA(i, START, weights[i], np.sin, a), "step_size, round 0"),
        (lambda i, a: NIDS(i, START, weights[i], SMOOTH, a), "coupling"),
        (
            lambda i, a: ExactDiffusion(i, START, weights[i], np.sin, a),
            "step_size, round 0",
        ),
        (
            lambda i, a: ProxSkip(i, START, weights[i], np.sin, 0.1, SharedCoin(a)),
            "coin",
        ),
        (
            lambda i, a: LinearisedADMM(i, START, ring(4).neighbors(i), np.sin, a, 1.0),
            "penalty",
        ),
    ):
        agents = {i: make(i, 0.5 if i == 3 else 0.6) for i in range(4)}
        with pytest.raises(
            ConfigError, match=f"agent 3: {name}: found .*, as agent 0's"
        ):
            simulate(agents, ring(4), rounds=2)


def test_weights_that_are_not_symmetric_are_named_by_both_agents():
    """Each row and each column of these weights sums to one."""
    circulant = {0: 0.5, 1: 0.3, 2: 0.2}
    weights = {i: {(i + n) % 3: w for n, w in circulant.items()} for i in range(3)}
    agents = {i: EXTRA(i, START, weights[i], np.sin, 0.1) for i in range(3)}
    with pytest.raises(
        ConfigError,
        match=r"agent 0: weights\[1\]: found 0.3; allowed: 0.2, as agent 1's: symmetric",
    ):
        simulate(agents, complete(3), loss=0.2)


def test_a_graph_that_changes_is_refused():
    changing = GraphSequence((path(4), complete(4)))
    with pytest.raises(
        ConfigError,
        match=r"agent 0: weights: found rows of 2 graphs; .* GradientTracking allows",
    ):
        team(changing, lambda i, w: EXTRA(i, START, w, np.sin, 0.1))


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: EXTRA(0, START, ROW, np.sin, 0.0), "step size: a"),
        (lambda: PGEXTRA(0, START, ROW, SMOOTH, -1.0), "step size: a"),
        (
            lambda: NIDS(0, START, ROW, SMOOTH, 0.5, coupling=1.1),
            r"agent 0: coupling: found 1.1; allowed: above 0, at most 1 / \(2 step\) = 1",
        ),
        (lambda: NIDS(0, START, ROW, SMOOTH, 0.5, coupling=0.0), "agent 0: coupling"),
        (lambda: ExactDiffusion(0, START, ROW, 3.0, 0.1), "agent 0: gradient"),
        (lambda: SharedCoin(0.0), "coin: p: found 0.0; allowed: 0.001 to 1"),
        (lambda: SharedCoin(1.5), "coin: p"),
        (
            lambda: LinearisedADMM(0, START, [1], np.sin, 0.0, 1.0),
            "agent 0: penalty: found 0.0; allowed: a finite number above 0",
        ),
        (
            lambda: LinearisedADMM(0, START, [1], np.sin, 1.0, np.inf),
            "agent 0: proximity",
        ),
        (lambda: l1_proximal(-1.0), "l1_proximal: weight"),
        (
            lambda: NIDS(
                0, START, ROW, CompositeCost(np.sin, lambda z, a: np.ones(2)), 0.1
            ),
            r"agent 0: proximal, round 0: found shape \(2,\); allowed: shape \(3,\)",
        ),
    ],
)
def test_what_cannot_be_is_refused_when_it_is_made(make, error):
    with pytest.raises(ConfigError, match=error):
        make()
