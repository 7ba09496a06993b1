"""Costs that move and states that move: tracking errors, the centre's trajectory, loss, and clear errors."""

from functools import cache

import cvxpy as cp
import numpy as np
import pytest
from in_step import run_in_step

from crazychoir.errors import ConfigError, SolverError
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
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import erdos_renyi_connected, path

GRAPH = erdos_renyi_connected(5, 0.5, 2)
COUPLING = 1.0
SPAN = 4.0
"""s that the costs move."""


class MovingTargets:
    """f_i(y; t) = 1/2 (y - b_i)'P_i (y - b_i), where b_i circles."""

    def __init__(self, seed):
        chance = np.random.default_rng(seed)
        roots = chance.normal(size=(5, 2, 2))
        self.p = roots @ roots.transpose(0, 2, 1) + np.eye(2)
        self.phase = chance.uniform(0, 6, (5, 2))
        degrees = [len(GRAPH.neighbors(i)) for i in range(5)]
        links = [[float(j in GRAPH.neighbors(i)) for j in range(5)] for i in range(5)]
        laplacian = np.diag(degrees) - np.array(links)
        self.hessian = COUPLING * np.kron(laplacian, np.eye(2))
        for i in range(5):
            self.hessian[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += self.p[i]
        self.step = 1.0 / np.linalg.eigvalsh(self.hessian).max()

    def cost(self, i, exact):
        p, phase = self.p[i], self.phase[i]
        return MovingCost(
            lambda y, t: p @ (y - np.cos(t + phase)),
            lambda y, t: p,
            COUPLING,
            (lambda y, t: p @ np.sin(t + phase)) if exact else None,
        )

    def optimum(self, t):
        """(5, 2), by the centre."""
        pull = np.einsum("ijk,ik->ij", self.p, np.cos(t + self.phase))
        return np.linalg.solve(self.hessian, pull.ravel()).reshape(5, 2)

    def agents(self, sampling, exact=True, samples=None):
        return {
            i: PredictionCorrection(
                i,
                np.zeros(2),
                GRAPH.neighbors(i),
                self.cost(i, exact),
                self.step,
                sampling,
                samples,
            )
            for i in range(5)
        }

    def error(self, sampling, exact=True):
        """The largest error in the second half of the time."""
        agents = self.agents(sampling, exact)
        count = round(SPAN / sampling.period)
        errors = []
        for k in range(count):
            run_in_step(agents, GRAPH, sampling.corrections)
            x = np.array([agent.x for agent in agents.values()])
            errors.append(np.abs(x - self.optimum(k * sampling.period)).max())
            run_in_step(agents, GRAPH, sampling.rounds - sampling.corrections)
        return max(errors[count // 2 :])


@pytest.mark.parametrize("seed", range(2))
def test_prediction_tracks_better_than_correction_alone(seed):
    targets = MovingTargets(seed)
    alone = targets.error(Sampling(0.1, 1, None))
    assert targets.error(Sampling(0.1, 1, 4)) < 0.2 * alone
    assert targets.error(Sampling(0.1, 1, 4), exact=False) < 0.3 * alone


@pytest.mark.parametrize("seed", range(2))
def test_prediction_beats_as_many_rounds_of_correction_where_the_period_is_short(seed):
    targets = MovingTargets(seed)
    corrected = targets.error(Sampling(0.02, 9, None))
    assert targets.error(Sampling(0.02, 1, 8)) < 0.7 * corrected


def test_the_error_is_of_the_order_of_h_without_and_of_h_squared_with_prediction():
    targets = MovingTargets(0)
    coarse, fine = (
        [targets.error(Sampling(h, 2, K)) for K in (None, 12)] for h in (0.1, 0.05)
    )
    without, with_prediction = np.array(coarse) / fine
    assert 1.6 < without < 2.4
    assert 3.0 < with_prediction < 5.0


def test_the_error_settles_at_0_for_costs_that_rest():
    targets = MovingTargets(1)
    agents = targets.agents(Sampling(1e-9, 1, 2), samples=150)
    run_in_step(agents, GRAPH)
    x = np.array([agent.x for agent in agents.values()])
    assert x == pytest.approx(targets.optimum(0.0), abs=1e-6)


# Predictive control -------------------------------------------------------------------------------------------------

H, T, REACH, STEPS = 0.5, 5, 1.0, 4
LINE = path(3)
STARTS = (4.0, 4.6, 5.2)
LIMITS = (0.3, 2.0, 2.0)


def robot(most):
    """A double integrator: |v| <= 2, |u| <= most."""
    both = np.array([[1.0], [-1.0]])
    return Prediction(
        np.array([[1.0, H], [0.0, 1.0]]),
        np.array([[H**2 / 2], [H]]),
        np.array([[1.0, 0.0]]),
        np.eye(2),
        np.eye(1),
        both @ np.array([[0.0, 1.0]]),
        np.full(2, 2.0),
        both,
        np.full(2, most),
        T,
        P=4.0 * np.eye(2),
    )


def robots(iterations, neighbors=LINE.neighbors, penalty=100.0, **options):
    coupling = OutputCoupling(REACH, penalty, iterations)
    return {
        i: CoupledMPC(
            i, [x, 0.0], neighbors(i), robot(most), coupling, STEPS, **options
        )
        for i, (x, most) in enumerate(zip(STARTS, LIMITS, strict=True))
    }


def states(agents, iterations):
    """(STEPS, 3, 2): the states of the closed loop."""
    found = []
    for _ in range(STEPS):
        run_in_step(agents, LINE, iterations)
        found.append([agent.x for agent in agents.values()])
    return np.array(found)


@cache
def centre():
    """The states of one controller for all."""
    models = [robot(most) for most in LIMITS]
    now, found = [np.array([x, 0.0]) for x in STARTS], []
    for _ in range(STEPS):
        x = [cp.Variable((T + 1, 2)) for _ in models]
        u = [cp.Variable((T, 1)) for _ in models]
        rules, cost = [], 0.0
        for one, xi, ui, start in zip(models, x, u, now, strict=True):
            rules += [xi[0] == start, xi[1:] == xi[:-1] @ one.A.T + ui @ one.B.T]
            rules += [cp.abs(ui) <= one.h[0], cp.abs(xi[1:, 1]) <= 2.0]
            cost += cp.sum_squares(xi[:-1]) + cp.sum_squares(ui)
            cost += 4.0 * cp.sum_squares(xi[-1])
        rules += [cp.abs(x[i][1:, 0] - x[j][1:, 0]) <= REACH for i, j in LINE.edges()]
        cp.Problem(cp.Minimize(cost), rules).solve(solver=cp.CLARABEL)
        now = [
            one.A @ start + one.B @ ui.value[0]
            for one, start, ui in zip(models, now, u, strict=True)
        ]
        found.append(now)
    return np.array(found)


def test_the_team_flies_the_trajectory_of_the_centre():
    agents = robots(160)
    assert states(agents, 160) == pytest.approx(centre(), abs=1e-3)
    assert max(agent.violation for agent in agents.values()) < 1e-3


def test_few_iterations_stay_near_it_and_no_coupling_leaves_it():
    near = np.abs(states(robots(40), 40) - centre()).max()
    apart = robots(1, lambda i: ())
    for agent in apart.values():
        for _ in range(STEPS):
            agent.step({})
    far = np.abs(
        [agent.x - x for agent, x in zip(apart.values(), centre()[-1], strict=True)]
    )
    assert near < 0.02
    assert far.max() > 0.1


def test_neighbours_within_reach_do_not_change_the_first_input():
    """The targets of the first plans are the plans without neighbours, and not the origin."""
    coupling = OutputCoupling(1000.0, 100.0, iterations=1)

    def make(i, neighbors):
        return CoupledMPC(
            i, [1.0 + 0.1 * i, 0.0], neighbors, robot(9.0), coupling, STEPS
        )

    team = {i: make(i, LINE.neighbors(i)) for i in range(3)}
    alone = {i: make(i, ()) for i in range(3)}
    run_in_step(team, LINE, 1)
    for i in range(3):
        alone[i].step({})
        assert team[i].u == pytest.approx(alone[i].u, abs=1e-6)


def test_the_plant_may_differ_from_the_model():
    agents = robots(5, plant=lambda x, u: 0.5 * x)
    run_in_step(agents, LINE)
    assert [agent.x[0] for agent in agents.values()] == pytest.approx(
        [x / 2**STEPS for x in STARTS]
    )


def test_limits_that_allow_no_plan_are_named():
    with pytest.raises(SolverError, match="agent 7: predictive control, round 0"):
        CoupledMPC(7, [0.0, 9.0], (), robot(0.1), OutputCoupling(1.0, 1.0, 1))


# Both ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "graph"),
    [
        (lambda: MovingTargets(0).agents(Sampling(0.1, 1, 3), samples=20), GRAPH),
        (lambda: robots(20), LINE),
    ],
)
def test_loss_changes_no_bit(make, graph):
    calm, lossy = make(), make()
    run_in_step(calm, graph)
    history = simulate(lossy, graph, loss=0.4, seed=3)
    assert history.lost > 0.2 * history.messages
    for i, agent in lossy.items():
        assert agent.x.tobytes() == calm[i].x.tobytes()


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: Sampling(0.0), "Sampling: period: found 0.0"),
        (lambda: Sampling(1.0, 0), "Sampling: corrections: found 0"),
        (lambda: Sampling(1.0, 1, -1), "Sampling: predictions: found -1"),
        (lambda: OutputCoupling(0.0, 1.0, 1), "OutputCoupling: reach: found 0.0"),
        (lambda: OutputCoupling(1.0, 0.0, 1), "OutputCoupling: penalty: found 0.0"),
        (lambda: OutputCoupling(1.0, 1.0, 0), "OutputCoupling: iterations: found 0"),
    ],
)
def test_bad_arguments_are_named(make, error):
    with pytest.raises(ConfigError, match=error):
        make()


def test_a_wrong_size_is_named():
    for agent in (MovingTargets(0).agents(Sampling(0.1))[0], robots(5)[0]):
        heard = dict.fromkeys(agent.neighbors, np.ones(3))
        error = r"agent 0: message of agent \d: found shape \(3,\)"
        with pytest.raises(ConfigError, match=error):
            agent.step(heard)
