import cvxpy as cp
import numpy as np
import pytest

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.problems import CommonCost, ConstraintCoupled, CostCoupled, MixedIntegerConstraintCoupled

X = cp.Variable(2, name="x")
T = cp.Variable(name="t")
P = np.array([[2.0, 0.3], [0.3, 1.0]])
Q = np.array([1.0, 2.0])
LINEAR, PRICE, POINT = np.array([0.3, -4.0]), np.array([0.3, 0.2]), np.array([0.1, -0.2])
BOX = [X >= -1, X <= 1]
FUNCTIONS = {
    "closed form": (cp.quad_form(X, P) + Q @ X, [X[0] + X[1] == 1]),
    "active set": (cp.quad_form(X, P) + Q @ X, BOX),
    "least squares": (cp.sum_squares(P @ X - Q), BOX),
    "HiGHS": (Q @ X, [*BOX, X[0] + X[1] <= 0.5]),
    "flat": (cp.square(X[0]) + X[1], BOX),
    "disc": (cp.quad_form(X, P), [cp.norm(X) <= 0.5]),
    "sum of sizes": (cp.norm1(X - Q), BOX),
    "logarithm": (-cp.log(X[0]) + cp.square(X[1]), BOX),
    "own slack": (cp.quad_form(X, P) + 3 * T, [X[0] + T >= 2, T >= 0, *BOX]),
}
SOLVERS = {"closed form": "closed form", "active set": "active set", "least squares": "active set", "HiGHS": "HiGHS"}


def reference(objective, constraints):
    """By cvxpy."""
    problem = cp.Problem(cp.Minimize(objective), constraints)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11)
    return np.array(X.value)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_structure_says_who_solves_it(name):
    assert CostCoupled(0, X, *FUNCTIONS[name]).solver() == SOLVERS.get(name, "Clarabel")
    assert CostCoupled(0, X, *FUNCTIONS[name]).is_fast() == (SOLVERS.get(name) in ("closed form", "active set"))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_minimum_is_that_of_cvxpy(name):
    objective, constraints = FUNCTIONS[name]
    problem = CostCoupled(0, X, objective, constraints)
    np.testing.assert_allclose(problem.argmin(LINEAR), reference(objective + LINEAR @ X, constraints), atol=2e-5)
    found = problem.argmin(LINEAR, POINT, 3.0)
    expected = reference(objective + LINEAR @ X + 1.5 * cp.sum_squares(X - POINT), constraints)
    np.testing.assert_allclose(found, expected, atol=2e-5)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_projection_is_the_closest_point(name):
    objective, constraints = FUNCTIONS[name]
    z = np.array([1.4, 0.7])
    expected = reference(cp.sum_squares(X - z), constraints)
    np.testing.assert_allclose(CostCoupled(0, X, objective, constraints).project(z), expected, atol=2e-5)


def test_with_a_penalty_a_linear_cost_is_a_small_quadratic_program():
    assert CostCoupled(0, X, *FUNCTIONS["HiGHS"]).solver(0.5) == "active set"


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name != "own slack"])
def test_values_and_gradients_are_those_of_the_expression(name):
    objective, constraints = FUNCTIONS[name]
    problem, x = CostCoupled(0, X, objective, constraints), np.array([0.4, -0.7])
    X.value = np.array([7.0, 7.0])
    value, gradient = problem.value(x), problem.gradient(x)
    assert X.value.tolist() == [7.0, 7.0]
    X.value = x
    assert value == pytest.approx(float(objective.value), abs=1e-12)
    slopes = [(problem.value(x + h) - problem.value(x - h)) / 2e-6 for h in 1e-6 * np.eye(2)]
    np.testing.assert_allclose(gradient, slopes, atol=1e-6)


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0, 10000.0])
def test_a_cone_is_solved_to_the_end_whatever_the_cost(size):
    """argmin x'p + rho/2 |x - z|^2 over the unit ball is z - p / rho, on the sphere if that is outside."""
    x = cp.Variable(10)
    problem = CostCoupled(0, x, 0, [cp.norm(x) <= 1])
    for p, z in size * np.random.default_rng(0).normal(size=(20, 2, 10)):
        nearest = z - p / 3.0
        expected = nearest / max(1.0, np.linalg.norm(nearest))
        np.testing.assert_allclose(problem.argmin(p, z, 3.0), expected, atol=1e-6)


def test_outside_of_its_domain_the_cost_is_infinite_and_has_no_gradient():
    problem, outside = CostCoupled(4, X, *FUNCTIONS["logarithm"]), np.array([-1.0, 0.0])
    assert problem.value(outside) == np.inf
    with pytest.raises(SolverError, match=r"agent 4: gradient of the objective at \[-1\.  0\.\]: .* not finite"):
        problem.gradient(outside)


def test_bounds_of_the_variable_count():
    y = cp.Variable(3, bounds=[0, np.array([1.0, 2.0, np.inf])])
    np.testing.assert_allclose(CostCoupled(0, y, cp.sum_squares(y - 5)).argmin(), [1, 2, 5], atol=1e-12)
    z = cp.Variable(2, nonneg=True)
    np.testing.assert_allclose(CostCoupled(0, z, cp.norm1(z - 1)).argmin(np.array([0, 3.0])), [1, 0], atol=1e-9)
    w = cp.Variable(nonpos=True)
    np.testing.assert_allclose(CostCoupled(0, w, cp.square(w - 1)).argmin(), [0.0], atol=1e-12)


def test_parameters_are_read_anew_when_asked():
    centre = cp.Parameter(2, value=np.zeros(2))
    for objective in (cp.sum_squares(X - centre), cp.norm(X - centre) + cp.sum_squares(X)):
        centre.value = np.zeros(2)
        problem = CostCoupled(0, X, objective, BOX)
        np.testing.assert_allclose(problem.argmin(), 0.0, atol=1e-5)
        centre.value = np.array([0.5, -3.0])
        problem.refresh()
        np.testing.assert_allclose(problem.argmin(), reference(objective, BOX), atol=2e-5)


COUPLINGS = {
    "affine": [X[0] + X[1], X[0] - 2],
    "quadratic": [cp.sum_squares(X), X[0] - 2],
    "other": [cp.norm(X), cp.exp(X[0])],
    "a vector": P @ X - Q,
}


@pytest.mark.parametrize("name", COUPLINGS)
def test_the_answer_to_prices_is_that_of_cvxpy(name):
    problem = ConstraintCoupled(0, X, cp.sum_squares(X - 1), COUPLINGS[name], BOX, share=np.array([0.5, 0.0]))
    for prices in (PRICE, 4 * PRICE):
        expected = reference(cp.sum_squares(X - 1) + prices @ problem.coupling, BOX)
        np.testing.assert_allclose(problem.argmin(prices), expected, atol=2e-5)


@pytest.mark.parametrize("name", COUPLINGS)
def test_excess_and_jacobian_are_those_of_the_coupling(name):
    problem, x = ConstraintCoupled(0, X, X[0], COUPLINGS[name], share=np.array([0.5, 0.0])), np.array([0.4, -0.7])
    X.value = x
    np.testing.assert_allclose(problem.excess(x), problem.coupling.value - [0.5, 0.0], atol=1e-12)
    slopes = [(problem.excess(x + h) - problem.excess(x - h)) / 2e-6 for h in 1e-6 * np.eye(2)]
    np.testing.assert_allclose(problem.jacobian(x).T, slopes, atol=1e-6)


BROKEN = np.array([0.0, np.nan])
BAD_MODELS = {
    "not convex": (lambda: CostCoupled(3, X, -cp.norm(X)), r"agent 3: objective: found .* convex"),
    "a vector": (lambda: CostCoupled(3, X, X), r"agent 3: objective: found shape \(2,\); allowed: one number"),
    "nan in the cost": (lambda: CostCoupled(3, X, BROKEN @ X), r"agent 3: objective: data\[1\]: found nan"),
    "nan in a row": (
        lambda: CostCoupled(3, X, 0, [X >= 0, X <= BROKEN]),
        r"agent 3: constraints\[1\]: data\[1\]: found nan",
    ),
    "not a set": (lambda: CostCoupled(3, X, 0, [cp.norm(X) >= 1]), r"agent 3: constraints\[0\]: .* convex set"),
    "not a constraint": (lambda: CostCoupled(3, X, 0, [True]), r"agent 3: constraints\[0\]: found True"),
    "no variable": (lambda: CostCoupled(3, P, 0), "agent 3: x: found ndarray"),
    "a matrix": (lambda: CostCoupled(3, cp.Variable((2, 2)), 0), r"agent 3: .* shape \(2, 2\); allowed: a scalar"),
    "integers": (lambda: CostCoupled(3, cp.Variable(2, integer=True), 0), r"agent 3: .* attributes \['integer'\]"),
    "other integers": (
        lambda: CostCoupled(3, X, X[0], [cp.Variable(name="k", boolean=True) >= X]),
        "agent 3: k: found an integer variable",
    ),
    "an empty parameter": (lambda: CostCoupled(3, X, cp.Parameter(name="a") * X[0]), "parameter a: found no value"),
    "not DPP": (
        lambda: CostCoupled(3, X, cp.Parameter(value=1.0) * cp.Parameter(value=2.0) * X[0]),
        "agent 3: objective: .* rules of DPP",
    ),
    "a coupling": (lambda: ConstraintCoupled(3, X, 0, [X[0], -cp.norm(X)]), r"agent 3: coupling\[1\]: .* convex"),
    "a coupling of others": (lambda: ConstraintCoupled(3, X, 0, [X[0] + T]), r"agent 3: coupling: found variables"),
    "a share": (lambda: ConstraintCoupled(3, X, 0, X, share=np.zeros(3)), r"agent 3: share: found shape \(3,\)"),
    "a common disc": (lambda: CommonCost(3, X, Q @ X, [X <= 1, cp.norm(X) <= 1]), r"agent 3: constraints\[1\]"),
    "a common norm": (lambda: CommonCost(3, X, cp.norm(X)), "agent 3: objective: .* quadratic"),
}


@pytest.mark.parametrize("name", BAD_MODELS)
def test_a_bad_model_is_refused_when_it_is_made(name):
    make, text = BAD_MODELS[name]
    with pytest.raises(ConfigError, match=text):
        make()


@pytest.mark.parametrize("objective", [cp.sum_squares(X), Q @ X, cp.norm(X)])
def test_an_infeasible_problem_names_constraint_row_and_value(objective):
    problem = CostCoupled(3, X, objective, [X <= 1, X[1] >= 2.5, X >= -7])
    with pytest.raises(SolverError, match=r"agent 3: .*(\[0\] \(x <= 1.0\), row 1|row 0): violated by \d\.\d"):
        problem.argmin()


@pytest.mark.parametrize("objective", [Q @ X, cp.norm1(X) + 2 * Q @ X])
def test_an_unbounded_problem_names_the_entry(objective):
    problem = CostCoupled(3, X, objective, [X <= 1, X[0] >= 0])
    with pytest.raises(SolverError, match=r"agent 3: local problem: .* unbounded: x\[1\] goes to -inf"):
        problem.argmin()


def test_what_is_asked_is_checked():
    problem = CostCoupled(3, X, cp.sum_squares(X), BOX)
    with pytest.raises(ConfigError, match=r"agent 3: linear term: found shape \(3,\); allowed: shape \(2,\), as x"):
        problem.argmin(np.zeros(3))
    with pytest.raises(SolverError, match=r"agent 3: local problem: .* entry 1 .* is nan"):
        problem.argmin(np.array([0.0, np.nan]))
    with pytest.raises(ConfigError, match="agent 3: penalty: found -1"):
        problem.argmin(penalty=-1.0)
    with pytest.raises(ConfigError, match=r"agent 3: value of the objective: .*; allowed: x alone"):
        CostCoupled(3, X, *FUNCTIONS["own slack"]).value(POINT)
    with pytest.raises(SolverError, match=r"agent 3: prices\[1\] = nan"):
        ConstraintCoupled(3, X, cp.sum_squares(X), X).argmin(np.array([0.0, np.nan]))


def test_only_so_many_penalties_are_kept():
    problem = CostCoupled(3, X, cp.sum_squares(X), BOX)
    for penalty in np.linspace(0.1, 5.0, 50):
        problem.argmin(LINEAR, POINT, penalty)
    assert len(problem._programs) <= 8


def test_a_mixed_integer_model_has_the_optimum_of_cvxpy():
    draw = np.random.default_rng(4)
    for _ in range(5):
        x = cp.Variable(4, integer=([0, 2],), bounds=[0, 5])
        c, A, D = draw.normal(size=4), draw.uniform(0, 1, (2, 4)), draw.uniform(0.2, 1, (3, 4))
        own = [D @ x <= 4, x[1] + x[3] == 1.5]
        block = MixedIntegerConstraintCoupled(0, x, c @ x + 7, A @ x + 1, own, share=np.array([3.0, 3.0]))
        for cost in (block.c, c + A.T @ draw.uniform(0, 1, 2)):
            problem = cp.Problem(cp.Minimize(cost @ x), own)
            problem.solve(solver=cp.HIGHS)
            found = block.corner(cost)
            assert cost @ found == pytest.approx(problem.value, abs=1e-7)
            assert found[[0, 2]].tolist() == np.round(found[[0, 2]]).tolist()
        np.testing.assert_allclose(block.A, A)
        np.testing.assert_allclose(block.share, [2.0, 2.0])


def test_binary_entries_are_integers_from_0_to_1():
    x = cp.Variable(2, boolean=True)
    block = MixedIntegerConstraintCoupled(0, x, -x[0] - x[1], x[0] + x[1])
    np.testing.assert_allclose(block.corner(block.c), [1.0, 1.0])
    assert block.integer.all()


INTEGERS = {
    "a square": (lambda x: (cp.sum_squares(x), x), "agent 3: objective: found .* a linear function of n"),
    "a norm": (lambda x: (x[0], cp.norm(x)), "agent 3: coupling: found .* a linear function of n"),
    "a disc": (lambda x: (x[0], x, [x >= 0, cp.norm(x) <= 2]), r"agent 3: constraints\[1\]: found .* linear"),
    "a share": (lambda x: (x[0], x, [], np.zeros(3)), r"agent 3: share: found shape \(3,\)"),
}


@pytest.mark.parametrize("name", INTEGERS)
def test_a_mixed_integer_model_is_linear(name):
    x = cp.Variable(2, integer=True, name="n")
    make, text = INTEGERS[name]
    with pytest.raises(ConfigError, match=text):
        MixedIntegerConstraintCoupled(3, x, *make(x))
