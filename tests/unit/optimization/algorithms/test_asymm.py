import cvxpy as cp
import numpy as np
import pytest
from quadratics import costs, optimum, problems
from scipy.optimize import minimize

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.asymm import ASYMM, PenaltySchedule
from crazychoir.optimization.problems.smooth import SmoothFunction, SmoothProblem
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import erdos_renyi_connected, path, ring


def agents(graph, functions, start, equalities=None, inequalities=None, **options):
    own = lambda i, of: of.get(i) if of else None  # noqa: E731
    return {
        i: ASYMM(
            i,
            graph.neighbors(i),
            graph.diameter(),
            start[i],
            SmoothProblem(functions[i], own(i, equalities), own(i, inequalities)),
            PenaltySchedule(**options),
        )
        for i in graph.ids
    }


def localisation(count, seed):
    """The place of a target by noisy distances to known points: sum_i (|x - a_i|^2 - d_i^2)^2, not convex."""
    draw = np.random.default_rng(seed)
    points, target = draw.uniform(-5, 5, (count, 2)), np.array([1.0, 2.0])
    squares = (
        np.linalg.norm(points - target, axis=1) + 0.1 * draw.normal(size=count)
    ) ** 2
    return [_distance(a, d) for a, d in zip(points, squares, strict=True)]


def _distance(a, d):
    return SmoothFunction(
        lambda x: ((x - a) @ (x - a) - d) ** 2 / 100,
        lambda x: ((x - a) @ (x - a) - d) * (x - a) / 25,
    )


def together(functions, start, **constraints):
    return minimize(
        lambda x: sum(f.value(x) for f in functions),
        start,
        jac=lambda x: sum(f.derivative(x) for f in functions),
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
        **constraints,
    ).x


@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_it_finds_a_convex_optimum_whatever_is_lost(loss):
    parts, graph = (
        problems(costs(5, 2, 2), bound=100.0),
        erdos_renyi_connected(5, 0.5, 3),
    )
    functions = [SmoothFunction(part.value, part.gradient) for part in parts]
    team = agents(graph, functions, np.zeros((5, 2)), penalty=4.0, epochs=14)
    history = simulate(team, graph, loss=loss, compute=(0.0, 0.01), rounds=3000)
    assert all(agent.done for agent in team.values())
    assert (history.lost > 0) == (loss > 0)
    for x in history.last().values():
        np.testing.assert_allclose(x, optimum(parts), atol=1e-5)


@pytest.mark.parametrize("seed", range(2))
def test_it_finds_a_local_minimum_of_a_problem_that_is_not_convex(seed):
    functions, graph = localisation(6, seed), ring(6)
    start = np.random.default_rng(seed).normal(size=(6, 2)) * 2
    team = agents(graph, functions, start, epochs=16)
    simulate(team, graph, loss=0.4, seed=seed, rounds=3000)
    found = together(functions, start.mean(axis=0))
    for agent in team.values():
        np.testing.assert_allclose(agent.x, found, atol=1e-5)


def test_constraints_of_single_agents_bind_all():
    functions, graph, start = localisation(5, 4), ring(5), np.array([1.0, 2.0])
    circle = SmoothFunction(lambda x: np.array([x @ x - 9.0]), lambda x: 2 * x[None])
    left = SmoothFunction(lambda x: x[0] - 1.5, lambda x: np.array([1.0, 0.0]))
    team = agents(
        graph,
        functions,
        np.tile(start, (5, 1)),
        {2: circle},
        {3: left},
        penalty=4.0,
        epochs=16,
    )
    simulate(team, graph, loss=0.4, rounds=3000)
    bounds = [
        {"type": "eq", "fun": lambda x: circle.value(x)[0]},
        {"type": "ineq", "fun": lambda x: -left.value(x)},
    ]
    found = together(functions, start, constraints=bounds)
    assert found[0] == pytest.approx(1.5)
    for agent in team.values():
        np.testing.assert_allclose(agent.x, found, atol=1e-5)
    assert team[3]._own.m[0] > 0


def test_an_agent_does_not_go_on_before_it_has_heard_all_neighbors():
    agent = agents(ring(3), localisation(3, 0), np.zeros((3, 2)))[0]
    agent.step({1: [0, b"\x00", np.ones(2), np.zeros(2), 1.0]})
    assert agent.x.tolist() == [0.0, 0.0]
    agent.step({2: [0, b"\x00", np.ones(2), np.zeros(2), 1.0]})
    assert agent.x.tolist() != [0.0, 0.0]


def test_a_neighbor_in_the_next_epoch_says_that_all_are_done_with_this_one():
    agent = agents(ring(3), localisation(3, 0), np.zeros((3, 2)))[0]
    said = lambda epoch: [epoch, b"\x00", np.ones(2), np.zeros(2), 1.0]  # noqa: E731
    agent.step({1: said(0), 2: said(1)})
    assert agent.epoch == 1
    x = agent.x
    agent.step({2: said(1)})  # agent 1 is not known to be there yet
    assert agent.epoch == 1
    assert agent.x is x


def test_a_gradient_must_stay_small_before_it_counts():
    agent = ASYMM(
        0,
        (1,),
        1,
        [0.0, 0.0],
        SmoothProblem(SmoothFunction(lambda x: x @ x, lambda x: 2 * x)),
    )
    bits = []
    for _ in range(6):
        agent.step({1: [0, b"\x00", np.zeros(2), np.zeros(2), 1.0]})
        bits.append(agent.message()[1][1])
    assert bits == 4 * [b"\x00"] + 2 * [b"\x01"]


def test_multipliers_come_from_both_ends_and_lost_messages_do_not_matter():
    agent = agents(ring(3), localisation(3, 0), np.zeros((3, 2)), penalty=2.0)[0]
    ahead, here = [1, b"\x00", np.array([1.0, 0.0])], [0, b"\x00", np.zeros(2)]
    agent.step({1: [*ahead, np.zeros(2), 1.0], 2: [*here, np.zeros(2), 1.0]})
    np.testing.assert_allclose(agent.nu[1], [-2.0, 0.0])
    np.testing.assert_allclose(agent.message()[1][3], [-2.0, 0.0])


def test_what_is_wrong_is_named():
    good = SmoothFunction(lambda x: x @ x, lambda x: 2 * x)

    def make(f, inequalities=None, **options):
        problem = SmoothProblem(f, inequalities=inequalities)
        return ASYMM(3, (4,), 1, [0.0, 0.0], problem, PenaltySchedule(**options))

    said = {4: [0, b"\x00", np.ones(2), np.zeros(2), 1.0]}
    with pytest.raises(
        ConfigError, match="agent 3: penalty: found 0; allowed: above 0"
    ):
        make(good, penalty=0)
    with pytest.raises(
        ConfigError, match="agent 3: shrink: found 1; allowed: above 0, below 1"
    ):
        make(good, shrink=1.0)
    with pytest.raises(
        ConfigError,
        match=r"agent 3: objective: value and .* shapes \(1,\) and \(1, 3\)",
    ):
        make(SmoothFunction(lambda x: 0.0, lambda x: np.zeros(3))).step(said)
    with pytest.raises(
        SolverError,
        match=r"agent 3: inequalities: value, row 1, at x = \[0.0, 0.0\]: .* not finite",
    ):
        make(
            good,
            inequalities=SmoothFunction(
                lambda x: np.array([0, np.nan]), lambda x: np.zeros((2, 2))
            ),
        ).step(said)
    with pytest.raises(
        ConfigError, match="agent 3: epochs: found 0; allowed: 1 or more"
    ):
        make(good, epochs=0)
    for bad in (
        None,
        [0],
        [0, 1, np.ones(2), np.zeros(2), 1.0],
        [0, b"", np.ones(2), np.zeros(2), "x"],
    ):
        with pytest.raises(
            ConfigError,
            match=r"agent 3: message of agent 4, round 1: found .*; allowed: a list of 5",
        ):
            make(good).step({4: bad})
    with pytest.raises(
        ConfigError, match=r"agent 3: message of agent 4: found shape \(3,\)"
    ):
        make(good).step({4: [0, b"\x00", np.ones(3), np.zeros(2), 1.0]})


def test_a_problem_of_cvxpy_is_a_smooth_function():
    x = cp.Variable(2)
    part = problems(costs(1, 2, 0))[0]
    value, derivative = SmoothFunction(part.value, part.gradient).at(np.ones(2), "f")
    assert value.shape == (1,)
    assert derivative.shape == (1, 2)
    assert x.value is None


def test_constraints_that_exclude_each_other_are_no_answer():
    graph = ring(3)
    below = SmoothFunction(lambda x: x + 1.0, lambda x: np.eye(1))
    above = SmoothFunction(lambda x: 1.0 - x, lambda x: -np.eye(1))
    rows = {1: below, 2: above}
    functions = [
        SmoothFunction(lambda x, i=i: (x[0] - i) ** 2, lambda x, i=i: 2.0 * (x - i))
        for i in graph.ids
    ]
    team = {
        i: ASYMM(
            i,
            graph.neighbors(i),
            graph.diameter(),
            [1.0 * i],
            SmoothProblem(functions[i], inequalities=rows.get(i)),
        )
        for i in graph.ids
    }
    with pytest.raises(
        SolverError, match=r"agent \d: x is 0.\d+ from that of agent \d after 25 epochs"
    ):
        simulate(team, graph, loss=0.4, seed=3, rounds=20_000)


ROWS = SmoothFunction(
    lambda x: np.array([x[0] - 1.0, x[0] - 2.0]),
    lambda x: np.array([[1.0, 0.0], [1.0, 0.0]]),
)
SIDES = SmoothFunction(
    lambda x: np.array([x[0] - 1.0, 2.0 - x[0]]),
    lambda x: np.array([[1.0, 0.0], [-1.0, 0.0]]),
)


@pytest.mark.parametrize("epochs", [10, 25])
@pytest.mark.parametrize("kind", ["equalities", "inequalities"])
def test_constraints_of_one_agent_that_exclude_each_other_are_not_averaged(
    kind, epochs
):
    functions = [SmoothFunction(lambda x: float(x @ x), lambda x: 2.0 * x)] * 2
    rows = ROWS if kind == "equalities" else SIDES
    team = agents(
        path(2), functions, np.zeros((2, 2)), **{kind: {0: rows}}, epochs=epochs
    )
    with pytest.raises(
        SolverError,
        match=f"agent 0: {kind}, row [01]: violated by 0.5 .*exclude each other",
    ):
        simulate(team, path(2), rounds=20000)
