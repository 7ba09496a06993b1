"""Algorithms that average with their neighbours: the same iterates with loss, the central optimum, clear errors.

A new algorithm gets an entry in MAKERS.
"""

import json
import re

import cvxpy
import numpy as np
import pytest

from crazychoir.errors import AgentFailed, ConfigError, SolverError
from crazychoir.optimization.algorithms.admm import ADMM
from crazychoir.optimization.algorithms.aggregative_tracking import (
    AggregativeProblem,
    AggregativeTracking,
)
from crazychoir.optimization.algorithms.allocation import Allocation
from crazychoir.optimization.algorithms.asynchronous_consensus import (
    AsynchronousConsensus,
)
from crazychoir.optimization.algorithms.block_consensus import BlockConsensus
from crazychoir.optimization.algorithms.block_subgradient import BlockSubgradientMethod
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.algorithms.directed_gradient_tracking import (
    DirectedGradientTracking,
)
from crazychoir.optimization.algorithms.dual_decomposition import DualDecomposition
from crazychoir.optimization.algorithms.dual_subgradient import DualSubgradient
from crazychoir.optimization.algorithms.gradient_tracking import GradientTracking
from crazychoir.optimization.algorithms.max_consensus import MaxConsensus
from crazychoir.optimization.algorithms.primal_decomposition import PrimalDecomposition
from crazychoir.optimization.algorithms.push_sum import PushSum
from crazychoir.optimization.algorithms.set_membership import (
    AsynchronousSetMembership,
    SetMembership,
)
from crazychoir.optimization.algorithms.subgradient import SubgradientMethod
from crazychoir.optimization.generate import random_quadratics
from crazychoir.optimization.problems.gradient import ProjectedCost, Samples
from crazychoir.optimization.problems.problems import ConstraintCoupled, CostCoupled
from crazychoir.optimization.problems.projection import Box, Convex, Disc, Strip
from crazychoir.optimization.rounds.blocks import RandomBlocks
from crazychoir.optimization.rounds.mixing import columns, rows, team
from crazychoir.optimization.rounds.step_size import Diminishing
from crazychoir.optimization.rounds.stopping import Settled, Until
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import (
    Graph,
    GraphSequence,
    column_stochastic,
    complete,
    erdos_renyi_connected,
    path,
    ring,
    row_stochastic,
)

Q = random_quadratics(5, 2, seed=3)
GRAPH = erdos_renyi_connected(5, 0.5, 2)
DIRECTED = erdos_renyi_connected(5, 0.4, 1, directed=True)
PUSH = columns(DIRECTED, column_stochastic)
PULL = rows(DIRECTED, row_stochastic)
WEIGHTS = rows(GRAPH)
ONES = np.ones(2)
STEP = Diminishing(0.2, 0.6)


def half(x):
    return 0.5 * x


MAKERS = {
    "consensus": (GRAPH, lambda i: Consensus(i, ONES * i, WEIGHTS[i])),
    "max": (GRAPH, lambda i: MaxConsensus(i, [i, -i], GRAPH.diameter())),
    "block consensus": (
        GRAPH,
        lambda i: BlockConsensus(
            i, ONES * i, WEIGHTS[i], RandomBlocks([1, 1], awake=0.8)
        ),
    ),
    "push-sum": (DIRECTED, lambda i: PushSum(i, ONES * i, PUSH[i])),
    "sub-gradient": (
        GRAPH,
        lambda i: SubgradientMethod(
            i, ONES, WEIGHTS[i], Q.gradient(i), STEP, Box(-1, 1).project
        ),
    ),
    "stochastic": (
        GRAPH,
        lambda i: SubgradientMethod(
            i, ONES, WEIGHTS[i], Samples(i, lambda x, s: x - s, [1, 2, 3], 2), STEP
        ),
    ),
    "block sub-gradient": (
        GRAPH,
        lambda i: BlockSubgradientMethod(
            i,
            ONES,
            WEIGHTS[i],
            RandomBlocks([1, 1], awake=0.8),
            ProjectedCost(Q.gradient(i)),
            STEP,
        ),
    ),
    "gradient tracking": (
        GRAPH,
        lambda i: GradientTracking(i, ONES, WEIGHTS[i], Q.gradient(i), 0.02),
    ),
    "directed gradient tracking": (
        DIRECTED,
        lambda i: DirectedGradientTracking(
            i, ONES, PULL[i], PUSH[i], Q.gradient(i), 0.02
        ),
    ),
    "aggregative tracking": (
        GRAPH,
        lambda i: AggregativeTracking(
            i,
            ONES,
            WEIGHTS[i],
            AggregativeProblem(
                half, lambda x: 0.5 * np.eye(2), lambda x, s: x - i, lambda x, s: s
            ),
            0.1,
        ),
    ),
    "set membership": (
        GRAPH,
        lambda i: SetMembership(i, ONES * i, WEIGHTS[i], (Disc([i, 0.0], 4.0),)),
    ),
}


SENDS_ONE_ARRAY = ("sub-gradient", "stochastic", "block sub-gradient")
"""Doubly stochastic algorithms with one array in a message; the others send a list of two."""


@pytest.mark.parametrize("name", MAKERS)
def test_iterates_are_equal_without_and_with_40_percent_loss(name):
    graph, make = MAKERS[name]
    calm, lossy = (
        simulate({i: make(i) for i in graph.ids}, graph, loss=loss, rounds=40, seed=7)
        for loss in (0.0, 0.4)
    )
    assert calm.of().tobytes() == lossy.of().tobytes()
    assert len(calm.of()[0]) > 2
    assert lossy.lost > 0.2 * lossy.messages > calm.lost


@pytest.mark.parametrize(
    "name", [name for name in MAKERS if name not in ("max", "push-sum")]
)
def test_a_wrong_size_is_named(name):
    graph, make = MAKERS[name]
    agent = make(0)
    agent.connected = True
    wrong = np.ones(3)
    heard = {j: wrong for j in graph.in_neighbors(0)}
    if getattr(agent, "doubly_stochastic", False):
        weights = rows(graph)
        heard = {j: [weights[j][0][0], wrong] for j in heard}
        if name not in SENDS_ONE_ARRAY:
            heard = {j: [w, [x, x]] for j, (w, x) in heard.items()}
    elif name == "directed gradient tracking":
        heard = {j: [x, x] for j, x in heard.items()}
    with pytest.raises(
        ConfigError, match=r"agent 0: message of agent \d: found shape \(3,\)"
    ):
        agent.step(heard)


@pytest.mark.parametrize(
    "name", [name for name in MAKERS if name == "push-sum" or "tracking" in name]
)
@pytest.mark.parametrize("bad", ["text", [1.0], [ONES, 1.0, 2.0], {"x": 1.0}])
def test_a_malformed_message_names_the_neighbour_and_the_round(name, bad):
    graph, make = MAKERS[name]
    heard = {j: bad for j in graph.in_neighbors(0)}
    if getattr(make(0), "doubly_stochastic", False):
        heard = {j: [rows(graph)[j][0][0], bad] for j in heard}
    with pytest.raises(
        ConfigError,
        match=r"agent 0: message of agent \d, round 0: found .*; allowed: a list of 2",
    ):
        make(0).step(heard)


@pytest.mark.parametrize(
    ("messages", "error"),
    [
        (
            [[0, np.ones(1)]],
            r"agent 0: message of agent \d, round 0: found block 0; allowed: all of x, then",
        ),
        (
            [ONES, [7, np.ones(1)]],
            r"agent 0: message of agent \d, round 1: found block 7; allowed: .* 0 to 1",
        ),
        (
            [ONES, [1, np.ones(2)]],
            r"agent 0: message of agent \d: found shape \(2,\); allowed: shape \(1,\)",
        ),
        (
            [ONES, [1]],
            r"agent 0: message of agent \d, round 1: found a list of 1: int; allowed: a list of 2",
        ),
        ([ONES, "x"], r"agent 0: message of agent \d: found str"),
    ],
)
def test_a_block_that_is_none_is_named(messages, error):
    graph, make = MAKERS["block consensus"]
    agent = make(0)

    def run():
        for message in messages:
            agent.step(dict.fromkeys(graph.in_neighbors(0), message))

    with pytest.raises(ConfigError, match=error):
        run()


# Optima -------------------------------------------------------------------------------------------------------------


def test_recorded_push_sum(reference_data):
    """Erdos-Renyi graph of 5, 100 rounds of the recorded column-stochastic weights."""
    data = json.loads((reference_data("disropt") / "pushsum_er_N5.json").read_text())
    graph = Graph.from_edges(
        5, [(i, j) for i in range(5) for j in range(i) if data["Adj"][i][j]]
    )
    share = [
        {i: data["C"][i][j] for i in range(5) if data["C"][i][j]} for j in range(5)
    ]
    agents = {
        i: PushSum(i, data["x0"][i], share[i], data["iterations"]) for i in range(5)
    }
    history = simulate(agents, graph, loss=0.4)
    assert history.rounds == 100
    np.testing.assert_allclose(history.of()[:, -1], data["x_final"], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_max_consensus_ends_after_as_many_rounds_as_the_diameter(seed):
    graph = erdos_renyi_connected(8, 0.25, seed)
    x = np.random.default_rng(seed).normal(size=(8, 3))
    history = simulate(
        {i: MaxConsensus(i, x[i], graph.diameter()) for i in range(8)}, graph, loss=0.4
    )
    assert history.rounds == graph.diameter()
    assert all((last == x.max(axis=0)).all() for last in history.last().values())


def test_max_consensus_may_end_when_nothing_changes_any_more():
    """D = 10 is known as a bound only; the true diameter is 2."""
    graph = ring(5)
    agents = {
        i: Until(MaxConsensus(i, [float(i)], 1000), Settled(0.0, 2), 2)
        for i in range(5)
    }
    history = simulate(agents, graph)
    assert history.last() == dict.fromkeys(range(5), 4.0)
    assert history.rounds < 10


@pytest.mark.parametrize("seed", range(3))
def test_the_subgradient_method_finds_a_constrained_optimum_of_kinks(seed):
    """f_i(x) = |A_i x - b_i|_1, x in a box, on a changing graph."""
    chance = np.random.default_rng(seed)
    a, b = chance.normal(size=(6, 4, 2)), chance.normal(size=(6, 4))
    graph = GraphSequence.draw(erdos_renyi_connected(6, 0.6, seed), 0.5, 4, seed)
    agents = team(
        graph,
        lambda i, w: SubgradientMethod(
            i,
            np.zeros(2),
            w,
            lambda x: a[i].T @ np.sign(a[i] @ x - b[i]),
            Diminishing(0.05, 0.6),
            Box(-0.3, 0.4).project,
            rounds=3000,
        ),
    )
    history = simulate(agents, graph, record=("x", "average"), network={"delay": 0.0})
    x = cvxpy.Variable(2)
    cost = sum(cvxpy.norm1(a[i] @ x - b[i]) for i in range(6))
    least = cvxpy.Problem(cvxpy.Minimize(cost), [x >= -0.3, x <= 0.4]).solve(
        solver=cvxpy.CLARABEL
    )
    for name, gap in (("x", 2e-3), ("average", 1e-2)):
        for last in history.last(name).values():
            assert np.abs(a @ last - b).sum() == pytest.approx(least, rel=gap)
    assert np.abs(a @ agents[0].average - b).sum() >= least - 1e-6


def test_stochastic_gradients_find_the_optimum_of_all_samples():
    """Least squares of samples that are spread over the agents."""
    chance = np.random.default_rng(5)
    a = chance.normal(size=(5, 30, 3))
    b = a @ np.array([1.0, -2.0, 0.5]) + 0.1 * chance.normal(size=(5, 30))
    loss_gradient = lambda i: lambda x, s: a[i, s] * (a[i, s] @ x - b[i, s])  # noqa: E731
    agents = team(
        GRAPH,
        lambda i, w: SubgradientMethod(
            i,
            np.zeros(3),
            w,
            Samples(i, loss_gradient(i), range(30), batch=3),
            Diminishing(0.3, 0.7),
            rounds=1500,
        ),
    )
    simulate(agents, GRAPH, network={"delay": 0.0})
    optimum = np.linalg.lstsq(a.reshape(-1, 3), b.ravel(), rcond=None)[0]
    for agent in agents.values():
        assert agent.x == pytest.approx(optimum, abs=0.02)


@pytest.mark.parametrize("chances", [None, [0.2, 0.8]])
def test_the_block_method_finds_the_optimum_though_agents_sleep(chances):
    agents = team(
        GRAPH,
        lambda i, w: BlockSubgradientMethod(
            i,
            np.zeros(2),
            w,
            RandomBlocks([1, 1], chances, awake=0.7),
            ProjectedCost(Q.gradient(i), Box(-1.0, 0.5).project),
            Diminishing(0.3, 0.7),
            rounds=4000,
        ),
    )
    simulate(agents, GRAPH, network={"delay": 0.0})
    x = cvxpy.Variable(2)
    cost = 0.5 * cvxpy.quad_form(x, Q.p.sum(axis=0)) + Q.q.sum(axis=0) @ x
    cvxpy.Problem(cvxpy.Minimize(cost), [x >= -1.0, x <= 0.5]).solve(
        solver=cvxpy.CLARABEL
    )
    for agent in agents.values():
        assert agent.x == pytest.approx(x.value, abs=0.03)


def test_block_consensus_agrees_between_the_values_of_the_start_and_sends_one_block():
    agents = team(
        GRAPH,
        lambda i, w: BlockConsensus(
            i, [i, i**2, -i], w, RandomBlocks([1, 2], [0.3, 0.7], 0.8, seed=2), 300
        ),
    )
    for agent in agents.values():
        agent.step({j: agents[j].x for j in GRAPH.neighbors(agent.i)})
    sent = [agent.message() for agent in agents.values()]
    assert {len(m[1]) for m in sent if m is not None} <= {1, 2}
    assert None in [agents[i].message() for i in agents] or all(
        m[0] in (0, 1) for m in sent
    )
    agents = team(
        GRAPH,
        lambda i, w: BlockConsensus(
            i, [i, i**2, -i], w, RandomBlocks([1, 2], [0.3, 0.7], 0.8, seed=2), 400
        ),
    )
    history = simulate(agents, GRAPH, loss=0.3)
    assert history.spread()[-1] < 1e-9
    low, high = history.of()[:, 0].min(axis=0), history.of()[:, 0].max(axis=0)
    assert np.all((low < history.last()[0]) & (history.last()[0] < high))


# Asynchronous -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "graph", [ring(6), path(6), ring(6, directed=True), complete(4)]
)
def test_asynchronous_consensus_agrees_at_40_percent_loss(graph):
    agents = team(
        graph, lambda i, w: AsynchronousConsensus(i, [i, i**2], w[0]), row_stochastic
    )
    history = simulate(agents, graph, loss=0.4, rounds=400, compute=(0.0, 0.01), seed=3)
    last = np.array(list(history.last().values()))
    n = len(graph.ids) - 1
    assert np.ptp(last, axis=0).max() < 1e-6
    assert np.all((last > 0.1) & (last < [n - 0.1, n**2 - 0.1]))
    assert history.lost == pytest.approx(0.4 * history.messages, rel=0.1)
    assert history.resent == 0


def test_asynchronous_consensus_with_all_heard_is_consensus():
    weights = {0: 0.5, 1: 0.3, 2: 0.2}
    agent, calm = AsynchronousConsensus(0, [1.0], weights), Consensus(0, [1.0], weights)
    heard = {1: np.array([2.0]), 2: np.array([-4.0])}
    agent.step(heard)
    calm.step(heard)
    assert agent.x == pytest.approx(calm.x)
    alone = AsynchronousConsensus(0, [1.0], weights)
    alone.step({})
    assert alone.x == [1.0]


def beacons(i):
    """What robot i measures of the place (0.3, -0.2): its distance from a beacon, and a direction."""
    place, chance = np.array([0.3, -0.2]), np.random.default_rng(i)
    centre, a = chance.normal(size=2), chance.normal(size=2)
    return Disc(centre, np.linalg.norm(place - centre) + 0.02), Strip(
        a, a @ place + 0.01, 0.06
    )


@pytest.mark.parametrize("kind", [SetMembership, AsynchronousSetMembership])
def test_set_membership_ends_where_all_measurements_are_met_at_40_percent_loss(kind):
    def make(i, w):
        sets = iter(beacons(i))
        weights = w if kind is SetMembership else w[0]
        return kind(
            i, [3.0 * i, 2.0], weights, (Box(-20.0, 20.0),), lambda: next(sets, None)
        )

    agents = team(GRAPH, make)
    history = simulate(agents, GRAPH, loss=0.4, rounds=120, seed=1)
    for last in history.last().values():
        for i in GRAPH.ids:
            for one in beacons(i):
                assert np.linalg.norm(one.project(last) - last) < 1e-3
    assert np.ptp(list(history.last().values()), axis=0).max() < 1e-3


# Bad input, named on every agent ------------------------------------------------------------------------------------


def refused(agents, graph, **options):
    """The error of a simulation, as it would be in flight: no look at the whole team before."""
    for agent in agents.values():
        agent.connected = False
    with pytest.raises((ConfigError, SolverError)) as error:
        simulate(agents, graph, record=(), rounds=500, **options)
    return str(error.value)


def test_weights_that_are_not_doubly_stochastic_are_named_by_the_agent_of_the_column():
    agents = team(
        path(4), lambda i, w: GradientTracking(i, ONES, w, half, 0.1), row_stochastic
    )
    said = refused(agents, path(4), loss=0.3)
    assert (
        "agent 0: weights, column 0, round 0: found sum 0.833333333; allowed: columns that sum to one, too"
        in said
    )
    changing = GraphSequence((path(4), complete(4), path(4)))
    agents = team(
        changing, lambda i, w: SubgradientMethod(i, ONES, w, half, 0.1), row_stochastic
    )
    assert "column 0, round 0" in refused(agents, changing)
    mended = team(changing, lambda i, w: SubgradientMethod(i, ONES, w, half, 0.1))
    for i, agent in mended.items():
        agent.weights = (*agent.weights[:2], rows(path(4), row_stochastic)[i][0])
    assert "column 0, round 2" in refused(mended, changing)


def resource(i):
    x = cvxpy.Variable(2)
    return ConstraintCoupled(i, x, cvxpy.sum_squares(x - i), x, share=ONES)


def own(i):
    x = cvxpy.Variable(2)
    return CostCoupled(i, x, cvxpy.sum_squares(x - i))


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (
            lambda i, a: SubgradientMethod(i, ONES, WEIGHTS[i], half, a),
            "step_size, round 0",
        ),
        (
            lambda i, a: BlockSubgradientMethod(
                i,
                ONES,
                WEIGHTS[i],
                RandomBlocks([2]),
                ProjectedCost(half),
                Diminishing(0.1, a),
            ),
            ".*, round 1",
        ),
        (
            lambda i, a: DualSubgradient(resource(i), WEIGHTS[i], a),
            "step_size, round 0",
        ),
        (lambda i, a: DualDecomposition(own(i), a), "step_size, round 0"),
        (lambda i, a: ADMM(own(i), GRAPH.neighbors(i), a), "penalty"),
        (
            lambda i, a: PrimalDecomposition(
                i, WEIGHTS[i], Allocation(resource(i), 9.0), ONES, a
            ),
            "step_size, round 0",
        ),
    ],
)
def test_steps_and_penalties_that_must_be_common_are_compared(make, name):
    with pytest.raises(
        ConfigError, match=f"agent 3: {name}: found 0.*; allowed: 0.*, as agent 0's"
    ):
        simulate(
            {i: make(i, 0.5 if i == 3 else 0.6) for i in GRAPH.ids}, GRAPH, rounds=2
        )
    assert simulate({i: make(i, 0.6) for i in GRAPH.ids}, GRAPH, rounds=2).rounds == 2


def test_all_agents_hear_of_it_in_bounded_time():
    agents = team(ring(8), lambda i, w: GradientTracking(i, ONES, w, half, 0.1))
    agents[3].weights = ({3: 0.2, 2: 0.3, 4: 0.5},)
    assert "agent 2: weights, column 2" in refused(agents, ring(8), loss=0.4)
    assert all(agent.k <= 5 for agent in agents.values())
    assert issubclass(AgentFailed, RuntimeError)


def nan_later(x):
    return np.array([0.0, np.nan]) if x[0] < 0.5 else 0.3 * x


@pytest.mark.parametrize(
    ("gradient", "error"),
    [
        (
            nan_later,
            r"agent 2: gradient, round \d+\[1\]: found nan; allowed: finite numbers",
        ),
        (
            lambda x: np.ones(3),
            r"agent 2: gradient, round 0: found shape \(3,\); allowed: shape \(2,\)",
        ),
        (3.0, r"agent 2: gradient: found float; allowed: a function of numpy arrays"),
    ],
)
def test_a_bad_gradient_names_agent_round_and_row(gradient, error):
    gradients = {2: gradient}

    def run():
        agents = team(
            GRAPH,
            lambda i, w: SubgradientMethod(
                i, ONES, w, gradients.get(i, half), 0.5, rounds=50
            ),
        )
        simulate(agents, GRAPH)

    with pytest.raises(ConfigError, match=error):
        run()


TOO_LARGE_STEPS = {
    "gradient tracking": lambda i, w: GradientTracking(i, ONES, w, Q.gradient(i), 50.0),
    "subgradient": lambda i, w: SubgradientMethod(i, ONES, w, Q.gradient(i), 50.0),
    "block subgradient": lambda i, w: BlockSubgradientMethod(
        i,
        ONES,
        w,
        RandomBlocks((1, 1)),
        ProjectedCost(Q.gradient(i)),
        50.0,
    ),
}


@pytest.mark.parametrize("name", TOO_LARGE_STEPS)
def test_step_that_is_too_large_is_named_with_the_bound_that_holds_for_it(name):
    said = refused(team(GRAPH, TOO_LARGE_STEPS[name]), GRAPH, loss=0.2)
    assert re.search(
        r"agent \d: step 50, round \d+: found iterates that have grown from .* to .*; "
        r"allowed: .* L.*\. Take a smaller step\.",
        said,
    )


def test_gradient_that_overflows_at_a_grown_x_says_so():
    with np.errstate(over="ignore", invalid="ignore"):
        said = refused(
            team(
                GRAPH,
                lambda i, w: GradientTracking(i, 9.0 * ONES, w, lambda x: x**9, 1.0),
            ),
            GRAPH,
        )
    assert "gradient, round" in said
    assert "at an x that has grown to" in said


def test_iterates_far_from_all_data_may_begin_next_to_nothing():
    """Agent 0 alone has data. At the other end of the path the first values are below 1e-20."""
    graph = path(48)

    def make(i, weights):
        gradient = (lambda x: x - 1e10) if i == 0 else np.zeros_like
        return GradientTracking(i, np.zeros(2), weights, gradient, 0.01, rounds=400)

    agents = team(graph, make)
    simulate(agents, graph)
    assert agents[47].x[0] > 0.0


def test_iterates_may_grow_from_zero_to_a_far_optimum():
    far = 1e9
    agents = team(
        GRAPH,
        lambda i, w: GradientTracking(
            i, np.zeros(2), w, lambda x: x - far, 0.05, rounds=2000
        ),
    )
    simulate(agents, GRAPH)
    np.testing.assert_allclose(agents[0].x, [far, far], rtol=1e-6)


def test_measurements_without_a_common_point_are_named():
    sets = (Box(0.0, 1.0), Box([2.0, 0.0], [3.0, 1.0]))
    with pytest.raises(
        SolverError, match=r"agent 1: measurements: row 0: .* infeasible: from 2 to 1"
    ):
        SetMembership(1, [0.0, 0.0], WEIGHTS[1], sets)
    later = iter([Disc([0.0, 0.0], 1.0), Disc([3.0, 0.0], 1.0)])
    measure = {2: lambda: next(later, None)}
    agents = team(
        GRAPH, lambda i, w: SetMembership(i, ONES, w, (), measure.get(i, lambda: None))
    )
    assert "agent 2: measurements: projection of" in refused(agents, GRAPH)


def test_a_set_that_cvxpy_does_not_know_as_convex():
    x = cvxpy.Variable(2)
    with pytest.raises(
        ConfigError, match=r"agent 1: set: constraints\[0\]: .* a convex set"
    ):
        Convex(x, [cvxpy.norm(x) >= 1.0], "agent 1: set")


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: Box([0.0, 2.0], 1.0), "box"),
        (lambda: Strip([0.0, 0.0], 1.0, 0.1), "strip: found"),
        (lambda: Strip([0.0, np.nan], 1.0, 0.1), r"strip: a\[1\]"),
        (lambda: Disc([0.0], -1.0), "disc: radius"),
        (lambda: Diminishing(1.0, 1.5), "step size: p"),
        (lambda: Diminishing(-1.0), "step size: a"),
        (lambda: SubgradientMethod(0, ONES, {0: 1.0}, half, 0.0), "step size: a"),
        (
            lambda: SubgradientMethod(0, ONES, {0: 1.0}, half, lambda k: 1 - k),
            "step size: round 1",
        ),
        (lambda: PushSum(0, ONES, {0: 0.0, 1: 1.0}), "agent 0: shares"),
        (lambda: PushSum(0, ONES, {0: 0.4, 1: 0.4}), "agent 0: shares = .* sum to 0.8"),
        (lambda: AsynchronousConsensus(0, ONES, {0: 1.2, 1: -0.2}), "agent 0: weights"),
        (
            lambda: BlockConsensus(0, np.ones(4), {0: 1.0}, RandomBlocks([1, 2])),
            "agent 0: blocks",
        ),
        (
            lambda: BlockConsensus(
                0, np.ones(3), {0: 1.0}, RandomBlocks([1, 2], [1.0, 0.0])
            ),
            "agent 0: chances of blocks",
        ),
        (
            lambda: BlockConsensus(
                0, np.ones(3), {0: 1.0}, RandomBlocks([1, 2], awake=0.0)
            ),
            "agent 0: awake",
        ),
        (
            lambda: BlockConsensus(0, np.ones((3, 1)), {0: 1.0}, RandomBlocks([1, 2])),
            "agent 0: x: found shape",
        ),
        (
            lambda: BlockConsensus(0, ONES, [{0: 1.0}, {0: 1.0}], RandomBlocks([2])),
            "agent 0: weights: found 2 rows",
        ),
        (
            lambda: SetMembership(0, np.ones((3, 1)), {0: 1.0}, ()),
            "agent 0: x: found shape",
        ),
        (
            lambda: Samples(0, half, [1, 2], batch=3),
            "agent 0: batch: found 3; allowed: 1 to 2",
        ),
        (
            lambda: AggregativeTracking(
                0,
                ONES,
                {0: 1.0},
                AggregativeProblem(half, half, half, half),
                0.1,
                delta=0.0,
            ),
            "agent 0: delta",
        ),
    ],
)
def test_what_cannot_be_is_refused_when_it_is_made(make, error):
    with pytest.raises(ConfigError, match=error):
        make()
