"""Robots that plan one after another: ChoiRbot's example of four integrators, beside the plan of a centre."""

import cvxpy as cp
import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.optimization.predictive_control import (
    Prediction,
    PredictiveControl,
    SequentialMPC,
    integrators,
)

ONE, BOTH = np.eye(1), np.array([[1.0], [-1.0]])
H, T, REACH, X_MAX, TALKS = 1.0, 10, 2.0, 10.0, 10
P = (1 + np.sqrt(1 + 4 / H**2)) / 2
LQR = -H * P / (1 + P * H**2) * ONE
STARTS = (5.0, 5.2, 5.4, 5.5)


def scalar(most=0.5, gain=None):
    """x+ = x + H u, |x| <= 10, |u| <= most, Q = R = 1."""
    return Prediction(
        ONE,
        H * ONE,
        ONE,
        ONE,
        ONE,
        BOTH,
        np.full(2, X_MAX),
        BOTH,
        np.full(2, most),
        T,
        K=gain,
    )


def team(limits, gain=None, starts=STARTS, reach=REACH):
    return [
        SequentialMPC(
            i,
            tuple(j for j in range(len(starts)) if j != i),
            PredictiveControl(scalar(most, gain), reach),
            np.array([x]),
        )
        for i, (most, x) in enumerate(zip(limits, starts, strict=True))
    ]


def talk(agents, arrives=lambda: True):
    """Each hears the others, but what is lost, as often as in flight."""
    for _ in range(TALKS):
        said = {agent.i: agent.message() for agent in agents}
        for agent in agents:
            agent.step({j: said[j] for j in agent.neighbors if arrives()})


def run(agents, steps, arrives=lambda: True):
    """States and inputs (steps, N)."""
    x, u = [], []
    for _ in range(steps):
        talk(agents, arrives)
        x.append([agent.x[0] for agent in agents])
        u.append([agent.advance(agent.x + H * agent.u)[0] for agent in agents])
    return np.array(x), np.array(u)


def centre(limits, starts, steps):
    """The same by one problem for all in each step."""
    n = len(starts)
    x, u, now = cp.Variable((T + 1, n)), cp.Variable((T, n)), cp.Parameter(n)
    rules = [x[0] == now, x[1:] == x[:-1] + H * u, cp.abs(x[1:]) <= X_MAX]
    rules += [cp.abs(u[:, i]) <= limits[i] for i in range(n)]
    rules += [cp.abs(x[1:, i] - x[1:, j]) <= REACH for i in range(n) for j in range(i)]
    problem = cp.Problem(cp.Minimize(cp.sum_squares(x[:-1]) + cp.sum_squares(u)), rules)
    states, inputs = [np.array(starts)], []
    for _ in range(steps):
        now.value = states[-1]
        problem.solve(solver=cp.CLARABEL)
        inputs.append(u.value[0])
        states.append(states[-1] + H * u.value[0])
    return np.array(states[:-1]), np.array(inputs)


def cost(x, u):
    return float(np.sum(x**2) + np.sum(u**2))


def test_the_example_of_four_converges_as_a_centre_would_lead_it():
    x, u = run(team([0.5] * 4, LQR), 30)
    assert np.abs(x[-1]).max() < 1e-6
    assert np.abs(u).max() <= 0.5 + 1e-9
    assert np.ptp(x, axis=1).max() <= REACH
    there, inputs = centre([0.5] * 4, STARTS, 14)
    np.testing.assert_allclose(x[:14], there, atol=1e-4)
    np.testing.assert_allclose(u[:14], inputs, atol=1e-4)


def test_all_wait_for_the_slowest_as_a_centre_would_let_them():
    limits = [0.5, 0.5, 0.2, 0.5]
    agents = team(limits)
    x, u = run(agents, 40)
    assert np.ptp(x, axis=1).max() == pytest.approx(REACH, abs=1e-9), (
        "the constraint counts"
    )
    assert all(
        agent.tally.solved == 40 and agent.tally.infeasible == 0 for agent in agents
    )
    assert np.abs(x[-1]).max() < 1e-3
    assert (np.abs(u) <= np.array(limits) + 1e-9).all()
    assert cost(x, u) == pytest.approx(cost(*centre(limits, STARTS, 40)), rel=1e-3)


@pytest.mark.parametrize("loss", [0.5, 0.7, 0.85])
def test_whatever_is_lost_all_stay_within_reach(loss):
    draw = np.random.default_rng(7)
    agents = team([0.5, 0.5, 0.2, 0.5])
    x, _ = run(agents, 150, arrives=lambda: draw.random() >= loss)
    assert np.ptp(x, axis=1).max() <= REACH + 1e-9
    assert sum(agent.tally.kept for agent in agents) > 0
    assert all(agent.tally.infeasible == 0 for agent in agents)
    assert loss > 0.8 or np.abs(x[-1]).max() < 0.01, (
        "late, but there; beyond, the last in turn hears too little"
    )


def test_an_agent_that_hears_no_other_follows_its_plan_and_stops_at_its_end():
    agents = team([0.5] * 4)
    x, _ = run(agents, 1)
    x, _ = run(agents, 2 * T, arrives=lambda: False)
    assert all(agent.tally.kept >= 2 * T - 1 for agent in agents), (
        "the first in turn knows enough for one step"
    )
    np.testing.assert_array_equal(x[-1], x[-2])


def test_an_agent_out_of_reach_gets_no_further_and_comes_back():
    agents = team([0.5, 0.5], starts=(5.0, 8.0))
    x, _ = run(agents, 20)
    apart = np.ptp(x, axis=1)
    assert (np.diff(apart[:8]) <= 1e-9).all()
    assert apart[0] == 3.0
    assert apart[3:].max() <= REACH + 1e-9
    assert agents[0].tally.loosened > 0
    assert agents[0].tally.infeasible == 0


def test_what_is_infeasible_is_said_and_the_last_plan_goes_on():
    outside = team(
        [0.5, 0.5], starts=(11.0, 10.0)
    )  # |x| <= 10 is further away than an input goes
    x, _ = run(outside, 1)
    assert outside[0].tally.infeasible == 1
    assert outside[0].tally.why == "step 0: infeasible"
    assert outside[0].x[0] == x[0, 0], "its first plan: to stay"


def test_a_restarted_agent_announces_its_new_place():
    one, other = team([0.5, 0.5], starts=(5.0, 5.0))
    talk([one, other])
    one.restart(np.array([6.0]))
    np.testing.assert_array_equal(one.message()[1], np.full((T + 2, 1), 6.0))


@pytest.mark.parametrize(
    "said", [[0, np.zeros((3, 1))], [0], "x", [0.5, np.zeros((T + 2, 1))]]
)
def test_messages_that_are_none_are_refused(said):
    one, _ = team([0.5, 0.5], starts=(5.0, 5.0))
    with pytest.raises(ConfigError, match="message of agent 1"):
        one.step({1: said})


def test_the_program_of_a_drone_is_solved_as_by_cvxpy():
    A, B = integrators(0.4, 2)
    most = np.array([9.0, 9.0, 0.6, 0.6, 1.0, 1.0])
    both = np.vstack([np.eye(6), -np.eye(6)])
    Q, R = np.diag([1.0, 1.0, 0.1, 0.1, 0.1, 0.1]), 0.05 * np.eye(2)
    push, Z = np.vstack([np.eye(2), -np.eye(2)]), np.eye(6)[2:]
    of = Prediction(
        A, B, np.eye(2, 6), Q, R, both, np.r_[most, most], push, np.full(4, 4.0), T, Z=Z
    )
    control = PredictiveControl(of, 0.3)
    x, u, now = cp.Variable((T + 1, 6)), cp.Variable((T, 2)), cp.Parameter(6)
    high, low = cp.Parameter((T, 2)), cp.Parameter((T, 2))
    rules = [
        x[0] == now,
        x[1:] == x[:-1] @ A.T + u @ B.T,
        cp.abs(u) <= 4.0,
        x[T, 2:] == 0.0,
    ]
    rules += [
        cp.abs(x[1:]) <= np.tile(most, (T, 1)),
        x[1:, :2] <= high,
        x[1:, :2] >= low,
    ]
    weights = cp.sum_squares(x[:T] @ np.sqrt(Q)) + cp.sum_squares(u @ np.sqrt(R))
    problem, draw = cp.Problem(cp.Minimize(weights), rules), np.random.default_rng(5)
    for _ in range(8):
        now.value = draw.normal(size=6) * [2, 2, 0.1, 0.1, 0.1, 0.1]
        others = (
            now.value[:2]
            + draw.uniform(-0.1, 0.1, size=(3, 1, 2))
            + np.linspace(0, 0.3, T)[None, :, None]
        )
        high.value, low.value = others.min(axis=0) + 0.3, others.max(axis=0) - 0.3
        problem.solve(solver=cp.CLARABEL)
        np.testing.assert_allclose(control.solve(now.value, others), u.value, atol=2e-3)


def test_constraints_that_no_input_changes_hold_or_are_infeasible():
    """The place after one step is that of the speed before: no input reaches it."""
    A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]])
    limits = {
        "E": np.array([[1.0, 0.0]]),
        "f": np.ones(1),
        "G": np.array([[1.0], [-1.0]]),
        "h": np.full(2, 9.0),
    }
    of = Prediction(A, B, np.eye(1, 2), np.eye(2), np.eye(1), **limits, T=2)
    control, nothing = PredictiveControl(of), np.zeros((0, 2, 1))
    inside = control.solve(np.array([0.0, 0.5]), nothing)
    assert (of.states(np.array([0.0, 0.5]), inside)[1:3, 0] <= 1.0 + 1e-9).all()
    assert control.solve(np.array([0.0, 1.5]), nothing) == "infeasible"


def test_an_end_that_no_input_reaches_is_met_or_infeasible():
    """The second state goes its own way; an end that names the first one twice is no conflict."""
    A, B, Z = (
        np.diag([1.0, 0.5]),
        np.array([[1.0], [0.0]]),
        np.array([[1.0, 0.0], [3.0, 0.0], [0.0, 1.0]]),
    )
    free = {
        "E": np.zeros((0, 2)),
        "f": np.zeros(0),
        "G": np.zeros((0, 1)),
        "h": np.zeros(0),
    }
    of = Prediction(A, B, np.eye(2), np.eye(2), np.eye(1), **free, T=3, Z=Z)
    control, nothing = PredictiveControl(of), np.zeros((0, 3, 2))
    for start, is_met in (([2.0, 0.0], True), ([2.0, 1.0], False), ([-1.0, 0.0], True)):
        found = control.solve(np.array(start), nothing)
        assert isinstance(found, str) != is_met
        if is_met:
            np.testing.assert_allclose(
                of.states(np.array(start), found)[3], 0.0, atol=1e-9
            )
