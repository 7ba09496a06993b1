"""The equations of the dual family's docstrings, each against its textbook form."""

import cvxpy as cp
import numpy as np
import pytest
from in_step import run_in_step
from quadratics import costs, problems

from crazychoir.optimization.algorithms.admm import ADMM
from crazychoir.optimization.algorithms.asymm import ASYMM, PenaltySchedule
from crazychoir.optimization.algorithms.constraints_consensus import (
    ConstraintsConsensus,
)
from crazychoir.optimization.algorithms.dual_decomposition import DualDecomposition
from crazychoir.optimization.algorithms.dual_subgradient import DualSubgradient
from crazychoir.optimization.problems.active_set import minimise
from crazychoir.optimization.problems.problems import CommonCost, ConstraintCoupled
from crazychoir.optimization.problems.quadratic import Polyhedron, QuadraticProgram
from crazychoir.optimization.problems.smooth import (
    SmoothFunction,
    SmoothProblem,
    descend_once,
)
from crazychoir.team.graph import erdos_renyi_connected, metropolis, path

GRAPH = erdos_renyi_connected(5, 0.5, 2)


@pytest.fixture
def parts():
    return problems(costs(5, 3, 7))


def test_with_the_equalities_alone_the_minimum_is_an_affine_function_of_the_cost():
    """x = K (q + p) + k solves the conditions P x + q + p + E'nu = 0, E x = e."""
    draw = np.random.default_rng(0)
    L, E, e, q, p = (
        draw.normal(size=(4, 4)),
        draw.normal(size=(2, 4)),
        *draw.normal(size=(3, 4)),
    )
    P, e = L @ L.T + np.eye(4), e[:2]
    program = QuadraticProgram(P, q, Polyhedron.of(np.zeros((0, 4)), np.zeros(0), E, e))
    both = np.linalg.solve(
        np.block([[P, E.T], [E, np.zeros((2, 2))]]), np.concatenate([-(q + p), e])
    )
    np.testing.assert_allclose(
        program.inverse @ (q + p) + program.origin, both[:4], atol=1e-12
    )


def test_the_active_set_method_solves_its_complementarity_problem():
    """w = (b - A k) - A K q + D u >= 0, u >= 0, u'w = 0; x = K (q + A'u) + k and w = b - A x."""
    draw = np.random.default_rng(1)
    for _ in range(20):
        L, A, E, x0, q = (
            draw.normal(size=size) for size in ((4, 4), (9, 4), (1, 4), 4, 4)
        )
        over = Polyhedron.of(A, A @ x0 + 0.1, E, E @ x0)
        program = QuadraticProgram(L @ L.T + np.eye(4), np.zeros(4), over)
        K, k, D, u, x = (
            program.inverse,
            program.origin,
            program.gram,
            np.zeros(9),
            np.zeros(4),
        )
        np.testing.assert_allclose(D, -over.A @ K @ over.A.T, atol=1e-12)
        assert minimise(K, k, program.image, program.slack, D, 5 * q, u, x) >= 0
        w = over.b - over.A @ k - over.A @ K @ (5 * q) + D @ u
        np.testing.assert_allclose(w, over.b - over.A @ x, atol=1e-11)
        np.testing.assert_allclose(x, K @ (5 * q + over.A.T @ u) + k, atol=1e-12)
        assert w.min() > -1e-10
        assert u.min() >= 0.0
        assert np.abs(u * w).max() < 1e-10


def test_dual_decomposition_is_the_ascent_on_the_multipliers_of_the_edges(parts):
    """v_i = sum_j (l_ij - l_ji), with l_ij <- l_ij + a_k (x_i - x_j); and sum_i v_i = 0."""
    step = lambda k: 0.3 / (k + 1) ** 0.6  # noqa: E731
    team = {i: DualDecomposition(part, step, 30) for i, part in enumerate(parts)}
    multipliers = {(i, j): np.zeros(3) for i in GRAPH.ids for j in GRAPH.neighbors(i)}
    for k in range(30):
        v = {
            i: sum(multipliers[i, j] - multipliers[j, i] for j in GRAPH.neighbors(i))
            for i in GRAPH.ids
        }
        x = {i: parts[i].argmin(v[i]) for i in GRAPH.ids}
        sent = {i: agent.message() for i, agent in team.items()}
        for i, agent in team.items():
            np.testing.assert_allclose(sent[i], x[i], atol=1e-11)
            agent.step({j: sent[j] for j in GRAPH.neighbors(i)})
        for i, j in multipliers:
            multipliers[i, j] = multipliers[i, j] + step(k) * (x[i] - x[j])
    np.testing.assert_allclose(sum(agent.v for agent in team.values()), 0.0, atol=1e-12)


def test_dual_decomposition_ascends_the_dual_function(parts):
    """With a constant step below s / (2 max degree), q(v) = sum_i min f_i(x) + v_i'x never falls."""
    degree = max(len(GRAPH.neighbors(i)) for i in GRAPH.ids)
    modulus = min(np.linalg.eigvalsh(part.form.P)[0] for part in parts)
    team = {
        i: DualDecomposition(part, 0.9 * modulus / (2 * degree))
        for i, part in enumerate(parts)
    }
    values = []
    for _ in range(40):
        run_in_step(team, GRAPH, 1)
        values.append(
            sum(
                part.value(team[i].x) + team[i].v @ team[i].x
                for i, part in enumerate(parts)
            )
        )
    assert np.diff(values).min() > -1e-12


def test_admm_is_the_one_with_a_multiplier_for_each_pair(parts):
    """The multiplier of x_i = z_j is l_ij: z_j = mean of x_i + l_ij / rho over M_j, L_i = sum_j l_ij."""
    rho, members = 0.7, {i: sorted({i, *GRAPH.neighbors(i)}) for i in GRAPH.ids}
    team = {i: ADMM(part, GRAPH.neighbors(i), rho, 6) for i, part in enumerate(parts)}
    z, pairs = (
        dict.fromkeys(GRAPH.ids, np.zeros(3)),
        {(i, j): np.zeros(3) for i in GRAPH.ids for j in members[i]},
    )
    for _ in range(6):
        x = {}
        for i, part in enumerate(parts):
            v = cp.Variable(3)
            moved = sum(
                pairs[i, j] @ v + rho / 2 * cp.sum_squares(v - z[j]) for j in members[i]
            )
            form = part.form
            own = 0.5 * cp.quad_form(v, form.P) + form.q @ v
            cp.Problem(cp.Minimize(own + moved), [v <= 1, v >= -1]).solve(
                solver=cp.CLARABEL
            )
            x[i] = v.value
        z = {
            j: np.mean([x[i] + pairs[i, j] / rho for i in members[j]], axis=0)
            for j in GRAPH.ids
        }
        pairs = {(i, j): nu + rho * (x[i] - z[j]) for (i, j), nu in pairs.items()}
        run_in_step(team, GRAPH, 1)
        for i, agent in team.items():
            np.testing.assert_allclose(agent.x, x[i], atol=1e-6)
        run_in_step(team, GRAPH, 1)
        for i in GRAPH.ids:
            np.testing.assert_allclose(team[i].z, z[i], atol=1e-6)
            np.testing.assert_allclose(
                sum(pairs[j, i] for j in members[i]), 0.0, atol=1e-9
            )


def test_a_step_of_the_dual_subgradient_method():
    x, step = cp.Variable(2), 0.3
    part = ConstraintCoupled(
        0,
        x,
        cp.sum_squares(x - 1),
        [x[0] + x[1], x[0] - x[1]],
        share=np.array([0.5, -0.1]),
    )
    weights = metropolis(path(2))[0]
    agent = DualSubgradient(part, weights, step)
    agent.prices = np.array([0.4, 0.2])
    agent.message()
    agent.step({1: [0.5, np.array([1.0, 0.6])]})
    v = 0.5 * np.array([0.4, 0.2]) + 0.5 * np.array([1.0, 0.6])
    G = np.array([[1.0, 1.0], [1.0, -1.0]])
    argmin = 1.0 - G.T @ v / 2
    np.testing.assert_allclose(agent.x, argmin, atol=1e-12)
    np.testing.assert_allclose(
        agent.prices, np.maximum(0, v + step * (G @ argmin - [0.5, -0.1])), atol=1e-12
    )


def test_the_running_average_is_weighted_by_the_step_size():
    x = cp.Variable()
    agent = DualSubgradient(
        ConstraintCoupled(0, x, cp.square(x - 1), x), {0: 1.0}, lambda k: 1.0 / (k + 1)
    )
    seen = []
    for _ in range(5):
        agent.message()
        agent.step({})
        seen.append(agent.x)
    weights = 1.0 / np.arange(1, 6)
    np.testing.assert_allclose(
        agent.average, weights @ np.array(seen) / weights.sum(), atol=1e-12
    )


def test_the_excess_is_a_subgradient_of_the_dual_function():
    """d/dmu min_x f(x) + mu'(g(x) - b) = g(x(mu)) - b, by differences."""
    x = cp.Variable(2)
    share = np.array([0.5, 0.2])
    part = ConstraintCoupled(
        0,
        x,
        cp.sum_squares(x - 1),
        [cp.sum_squares(x), x[0]],
        [x >= -1, x <= 0.9],
        share,
    )

    def dual(mu):
        found = part.argmin(mu)
        return part.local.value(found) + mu @ part.excess(found)

    mu = np.array([0.3, 0.2])
    slopes = [(dual(mu + h) - dual(mu - h)) / 2e-6 for h in 1e-6 * np.eye(2)]
    np.testing.assert_allclose(part.excess(part.argmin(mu)), slopes, atol=1e-6)


def test_the_cost_of_constraints_consensus_never_falls_and_its_basis_has_the_same_optimum():
    draw = np.random.default_rng(3)
    x, A = cp.Variable(3), draw.normal(size=(5, 4, 3))
    objective = cp.sum_squares(x - 2)
    parts = [
        CommonCost(i, x, objective, [A[i] @ x <= 0.1 + A[i] @ np.ones(3)])
        for i in range(5)
    ]
    team = {
        i: ConstraintsConsensus(part, GRAPH.diameter()) for i, part in enumerate(parts)
    }
    costs = []
    while run_in_step(team, GRAPH, 1):
        costs.append([part.value(team[i].x) for i, part in enumerate(parts)])
        for agent in team.values():
            rows = agent.basis
            problem = cp.Problem(
                cp.Minimize(objective),
                [rows[:, :-1] @ x <= rows[:, -1]] if len(rows) else [],
            )
            problem.solve(solver=cp.CLARABEL)
            np.testing.assert_allclose(agent.x, x.value, atol=1e-5)
    assert np.diff(costs, axis=0).min() > -1e-9


def test_the_gradient_of_asymm_is_that_of_its_augmented_lagrangian():
    f = SmoothFunction(
        lambda x: np.cos(x[0]) + x @ x, lambda x: np.array([-np.sin(x[0]), 0.0]) + 2 * x
    )
    h = SmoothFunction(
        lambda x: np.array([x[0] * x[1] - 1]), lambda x: np.array([[x[1], x[0]]])
    )
    g = SmoothFunction(
        lambda x: np.array([x[0] - 0.2, -x[1]]),
        lambda x: np.array([[1.0, 0.0], [0.0, -1.0]]),
    )
    own = ASYMM(
        0, (1,), 1, [0.0, 0.0], SmoothProblem(f, h, g), PenaltySchedule(penalty=3.0)
    )._own
    own.l, own.m, s = np.array([0.7]), np.array([0.4, 0.0]), 3.0

    def lagrangian(x):
        short = np.maximum(0, own.m + s * g.value(x))
        equal = own.l @ h.value(x) + s / 2 * h.value(x) @ h.value(x)
        return f.value(x) + equal + (short @ short - own.m @ own.m) / (2 * s)

    for x in np.random.default_rng(0).normal(size=(5, 2)):
        assert own.value(x) - own.value(0 * x) == pytest.approx(
            lagrangian(x) - lagrangian(0 * x), abs=1e-10
        )
        slopes = [
            (lagrangian(x + d) - lagrangian(x - d)) / 2e-6 for d in 1e-6 * np.eye(2)
        ]
        np.testing.assert_allclose(own.gradient(x), slopes, atol=1e-6)


def test_the_multipliers_of_asymm_are_those_of_the_method_of_multipliers():
    h = SmoothFunction(
        lambda x: np.array([x[0] - 1.0]), lambda x: np.array([[1.0, 0.0]])
    )
    g = SmoothFunction(
        lambda x: np.array([x[1] - 0.2, x[0] - 9.0]),
        lambda x: np.array([[0.0, 1.0], [1.0, 0.0]]),
    )
    own = ASYMM(
        0,
        (1,),
        1,
        [0.0, 0.0],
        SmoothProblem(SmoothFunction(lambda x: 0.0, np.zeros_like), h, g),
    )._own
    own.l, own.m, own.s, x = (
        np.array([0.7]),
        np.array([0.1, 0.3]),
        2.0,
        np.array([3.0, 1.0]),
    )
    own.ascend(x, growth=4.0, shrink=0.5, tolerance=1e-3)
    np.testing.assert_allclose(own.l, 0.7 + 2.0 * 2.0)
    np.testing.assert_allclose(own.m, [0.1 + 2.0 * 0.8, 0.0])
    assert own.s == 2.0  # there is nothing to compare with yet
    own.ascend(x, growth=4.0, shrink=0.5, tolerance=1e-3)
    assert own.s == 8.0  # missed by as much as before
    own.ascend(x, growth=4.0, shrink=0.5, tolerance=1e3)
    assert own.s == 8.0  # by no more than the tolerance explains


def test_asymm_descends_on_the_lagrangian_with_its_neighbors():
    """One step from x on f + (nu_ij - nu_ji)'x + (rho_ij + rho_ji)/2 |x - x_j|^2, here a quadratic: to its minimum."""
    q, nu, other = np.array([1.0, -2.0]), np.array([0.3, 0.1]), np.array([2.0, 5.0])
    agent = ASYMM(
        0,
        (1,),
        1,
        [0.0, 0.0],
        SmoothProblem(SmoothFunction(lambda x: x @ x + q @ x, lambda x: 2 * x + q)),
        PenaltySchedule(penalty=1.5),
    )
    agent.nu[1] = np.array([-0.2, 0.6])
    agent.step({1: [0, b"\x00", other, nu, 0.5]})
    np.testing.assert_allclose(
        agent.x, (2.0 * other - q - (agent.nu[1] - nu)) / 4.0, atol=1e-6
    )


def test_newtons_step_descends_also_where_the_function_is_not_convex():
    value = lambda x: np.sin(3 * x[0]) * np.cos(2 * x[1]) + 0.1 * x @ x  # noqa: E731

    def slope(x):
        return (
            np.array(
                [
                    3 * np.cos(3 * x[0]) * np.cos(2 * x[1]),
                    -2 * np.sin(3 * x[0]) * np.sin(2 * x[1]),
                ]
            )
            + 0.2 * x
        )

    for x in np.random.default_rng(0).normal(size=(30, 2)) * 2:
        for _ in range(60):
            new = descend_once(value, slope, x)
            assert value(new) <= value(x) + 1e-13
            x = new
        assert np.abs(slope(x)).max() < 1e-6
