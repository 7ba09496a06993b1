import cvxpy as cp
import numpy as np
import pytest

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.admm import ADMM
from crazychoir.optimization.algorithms.allocation import Allocation
from crazychoir.optimization.algorithms.constraints_consensus import (
    ConstraintsConsensus,
)
from crazychoir.optimization.algorithms.convexified import Convexified
from crazychoir.optimization.algorithms.dual_decomposition import DualDecomposition
from crazychoir.optimization.algorithms.dual_subgradient import DualSubgradient
from crazychoir.optimization.algorithms.mixed_integer_decomposition import (
    PrimalDecompositionMILP,
)
from crazychoir.optimization.problems.mixed_integer import MixedIntegerBlock
from crazychoir.optimization.problems.problems import (
    CommonCost,
    ConstraintCoupled,
    CostCoupled,
    MixedIntegerConstraintCoupled,
)
from crazychoir.optimization.problems.projection import Box, Convex

X = cp.Variable(2, name="x")
T = cp.Variable(name="t")
P = np.array([[2.0, 0.3], [0.3, 1.0]])
Q = np.array([1.0, 2.0])
LINEAR, PRICE, POINT = (
    np.array([0.3, -4.0]),
    np.array([0.3, 0.2]),
    np.array([0.1, -0.2]),
)
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
SOLVERS = {
    "closed form": "closed form",
    "active set": "active set",
    "least squares": "active set",
    "HiGHS": "HiGHS",
}


def reference(objective, constraints):
    """By cvxpy."""
    problem = cp.Problem(cp.Minimize(objective), constraints)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11)
    return np.array(X.value)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_structure_selects_the_solver(name):
    assert CostCoupled(0, X, *FUNCTIONS[name]).solver() == SOLVERS.get(name, "Clarabel")
    assert CostCoupled(0, X, *FUNCTIONS[name]).is_fast() == (
        SOLVERS.get(name) in ("closed form", "active set")
    )


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_minimum_is_that_of_cvxpy(name):
    objective, constraints = FUNCTIONS[name]
    problem = CostCoupled(0, X, objective, constraints)
    np.testing.assert_allclose(
        problem.argmin(LINEAR),
        reference(objective + LINEAR @ X, constraints),
        atol=2e-5,
    )
    found = problem.argmin(LINEAR, POINT, 3.0)
    expected = reference(
        objective + LINEAR @ X + 1.5 * cp.sum_squares(X - POINT), constraints
    )
    np.testing.assert_allclose(found, expected, atol=2e-5)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_projection_is_the_closest_point(name):
    objective, constraints = FUNCTIONS[name]
    z = np.array([1.4, 0.7])
    expected = reference(cp.sum_squares(X - z), constraints)
    np.testing.assert_allclose(
        CostCoupled(0, X, objective, constraints).project(z), expected, atol=2e-5
    )


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
    slopes = [
        (problem.value(x + h) - problem.value(x - h)) / 2e-6 for h in 1e-6 * np.eye(2)
    ]
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
    with pytest.raises(
        SolverError,
        match=r"agent 4: gradient of the objective at \[-1\.  0\.\]: .* not finite",
    ):
        problem.gradient(outside)


def test_bounds_of_the_variable_count():
    y = cp.Variable(3, bounds=[0, np.array([1.0, 2.0, np.inf])])
    np.testing.assert_allclose(
        CostCoupled(0, y, cp.sum_squares(y - 5)).argmin(), [1, 2, 5], atol=1e-12
    )
    z = cp.Variable(2, nonneg=True)
    np.testing.assert_allclose(
        CostCoupled(0, z, cp.norm1(z - 1)).argmin(np.array([0, 3.0])), [1, 0], atol=1e-9
    )
    w = cp.Variable(nonpos=True)
    np.testing.assert_allclose(
        CostCoupled(0, w, cp.square(w - 1)).argmin(), [0.0], atol=1e-12
    )


def test_parameters_are_read_anew_when_asked():
    centre = cp.Parameter(2, value=np.zeros(2))
    for objective in (
        cp.sum_squares(X - centre),
        cp.norm(X - centre) + cp.sum_squares(X),
    ):
        centre.value = np.zeros(2)
        problem = CostCoupled(0, X, objective, BOX)
        np.testing.assert_allclose(problem.argmin(), 0.0, atol=1e-5)
        centre.value = np.array([0.5, -3.0])
        problem.refresh()
        np.testing.assert_allclose(
            problem.argmin(), reference(objective, BOX), atol=2e-5
        )


COUPLINGS = {
    "affine": [X[0] + X[1], X[0] - 2],
    "quadratic": [cp.sum_squares(X), X[0] - 2],
    "other": [cp.norm(X), cp.exp(X[0])],
    "a vector": P @ X - Q,
}


@pytest.mark.parametrize("name", COUPLINGS)
def test_the_answer_to_prices_is_that_of_cvxpy(name):
    problem = ConstraintCoupled(
        0, X, cp.sum_squares(X - 1), COUPLINGS[name], BOX, share=np.array([0.5, 0.0])
    )
    for prices in (PRICE, 4 * PRICE):
        expected = reference(cp.sum_squares(X - 1) + prices @ problem.coupling, BOX)
        np.testing.assert_allclose(problem.argmin(prices), expected, atol=2e-5)


@pytest.mark.parametrize("name", COUPLINGS)
def test_excess_and_jacobian_are_those_of_the_coupling(name):
    problem, x = (
        ConstraintCoupled(0, X, X[0], COUPLINGS[name], share=np.array([0.5, 0.0])),
        np.array([0.4, -0.7]),
    )
    X.value = x
    np.testing.assert_allclose(
        problem.excess(x), problem.coupling.value - [0.5, 0.0], atol=1e-12
    )
    slopes = [
        (problem.excess(x + h) - problem.excess(x - h)) / 2e-6 for h in 1e-6 * np.eye(2)
    ]
    np.testing.assert_allclose(problem.jacobian(x).T, slopes, atol=1e-6)


BROKEN = np.array([0.0, np.nan])
BAD_MODELS = {
    "not convex": (
        lambda: CostCoupled(3, X, -cp.norm(X)),
        r"agent 3: objective: found .* convex",
    ),
    "a vector": (
        lambda: CostCoupled(3, X, X),
        r"agent 3: objective: found shape \(2,\); allowed: one number",
    ),
    "nan in the cost": (
        lambda: CostCoupled(3, X, BROKEN @ X),
        r"agent 3: objective: data\[1\]: found nan",
    ),
    "nan in a row": (
        lambda: CostCoupled(3, X, 0, [X >= 0, X <= BROKEN]),
        r"agent 3: constraints\[1\]: data\[1\]: found nan",
    ),
    "not a set": (
        lambda: CostCoupled(3, X, 0, [cp.norm(X) >= 1]),
        r"agent 3: constraints\[0\]: .* convex set",
    ),
    "not a constraint": (
        lambda: CostCoupled(3, X, 0, [True]),
        r"agent 3: constraints\[0\]: found True",
    ),
    "no variable": (lambda: CostCoupled(3, P, 0), "agent 3: x: found ndarray"),
    "a matrix": (
        lambda: CostCoupled(3, cp.Variable((2, 2)), 0),
        r"agent 3: .* shape \(2, 2\); allowed: a scalar",
    ),
    "integers": (
        lambda: CostCoupled(3, cp.Variable(2, integer=True), 0),
        r"agent 3: .* attributes \['integer'\]",
    ),
    "other integers": (
        lambda: CostCoupled(3, X, X[0], [cp.Variable(name="k", boolean=True) >= X]),
        "agent 3: k: found an integer variable",
    ),
    "an empty parameter": (
        lambda: CostCoupled(3, X, cp.Parameter(name="a") * X[0]),
        "parameter a: found no value",
    ),
    "not DPP": (
        lambda: CostCoupled(
            3, X, cp.Parameter(value=1.0) * cp.Parameter(value=2.0) * X[0]
        ),
        "agent 3: objective: .* rules of DPP",
    ),
    "a coupling": (
        lambda: ConstraintCoupled(3, X, 0, [X[0], -cp.norm(X)]),
        r"agent 3: coupling\[1\]: .* convex",
    ),
    "a coupling of others": (
        lambda: ConstraintCoupled(3, X, 0, [X[0] + T]),
        r"agent 3: coupling: found variables",
    ),
    "a share": (
        lambda: ConstraintCoupled(3, X, 0, X, share=np.zeros(3)),
        r"agent 3: share: found shape \(3,\)",
    ),
    "a common disc": (
        lambda: CommonCost(3, X, Q @ X, [X <= 1, cp.norm(X) <= 1]),
        r"agent 3: constraints\[1\]",
    ),
    "a common norm": (
        lambda: CommonCost(3, X, cp.norm(X)),
        "agent 3: objective: .* quadratic",
    ),
}


@pytest.mark.parametrize("name", BAD_MODELS)
def test_a_bad_model_is_refused_when_it_is_made(name):
    make, text = BAD_MODELS[name]
    with pytest.raises(ConfigError, match=text):
        make()


@pytest.mark.parametrize("objective", [cp.sum_squares(X), Q @ X, cp.norm(X)])
def test_an_infeasible_problem_names_constraint_row_and_value(objective):
    problem = CostCoupled(3, X, objective, [X <= 1, X[1] >= 2.5, X >= -7])
    with pytest.raises(
        SolverError,
        match=r"agent 3: .*(\[0\] \(x <= 1.0\), row 1|row 0): violated by \d\.\d",
    ):
        problem.argmin()


def test_constraints_by_their_class_are_rows_too():
    at_least, cost = cp.constraints.NonNeg(X[0] - 2), cp.sum_squares(X)
    np.testing.assert_allclose(
        CostCoupled(3, X, cost, [at_least]).argmin(), [2.0, 0.0], atol=1e-12
    )
    with pytest.raises(SolverError, match=r"agent 3: .*row 0: violated by"):
        CostCoupled(3, X, cost, [at_least, cp.constraints.NonNeg(1 - X[0])]).argmin()


@pytest.mark.parametrize("objective", [Q @ X, cp.norm1(X) + 2 * Q @ X])
def test_an_unbounded_problem_names_the_entry(objective):
    problem = CostCoupled(3, X, objective, [X <= 1, X[0] >= 0])
    with pytest.raises(
        SolverError, match=r"agent 3: local problem: .* unbounded: x\[1\] goes to -inf"
    ):
        problem.argmin()


def test_what_is_asked_is_checked():
    problem = CostCoupled(3, X, cp.sum_squares(X), BOX)
    with pytest.raises(
        ConfigError,
        match=r"agent 3: linear term: found shape \(3,\); allowed: shape \(2,\), as x",
    ):
        problem.argmin(np.zeros(3))
    with pytest.raises(
        SolverError, match=r"agent 3: local problem: .* entry 1 .* is nan"
    ):
        problem.argmin(np.array([0.0, np.nan]))
    with pytest.raises(ConfigError, match="agent 3: penalty: found -1"):
        problem.argmin(penalty=-1.0)
    with pytest.raises(
        ConfigError, match=r"agent 3: value of the objective: .*; allowed: x alone"
    ):
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
        c, A, D = (
            draw.normal(size=4),
            draw.uniform(0, 1, (2, 4)),
            draw.uniform(0.2, 1, (3, 4)),
        )
        own = [D @ x <= 4, x[1] + x[3] == 1.5]
        block = MixedIntegerConstraintCoupled(
            0, x, c @ x + 7, A @ x + 1, own, share=np.array([3.0, 3.0])
        )
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
    "a square": (
        lambda x: (cp.sum_squares(x), x),
        "agent 3: objective: found .* a linear function of n",
    ),
    "a norm": (
        lambda x: (x[0], cp.norm(x)),
        "agent 3: coupling: found .* a linear function of n",
    ),
    "a disc": (
        lambda x: (x[0], x, [x >= 0, cp.norm(x) <= 2]),
        r"agent 3: constraints\[1\]: found .* linear",
    ),
    "a share": (
        lambda x: (x[0], x, [], np.zeros(3)),
        r"agent 3: share: found shape \(3,\)",
    ),
}


@pytest.mark.parametrize("name", INTEGERS)
def test_a_mixed_integer_model_is_linear(name):
    x = cp.Variable(2, integer=True, name="n")
    make, text = INTEGERS[name]
    with pytest.raises(ConfigError, match=text):
        MixedIntegerConstraintCoupled(3, x, *make(x))


def coupled(objective, constraints=()):
    return ConstraintCoupled(3, X, objective, X[0], constraints)


def mixed(objective, constraints=()):
    return MixedIntegerConstraintCoupled(3, X, objective, X[0], constraints)


KINDS = {
    "cost": lambda *given: CostCoupled(3, X, *given),
    "common": lambda *given: CommonCost(3, X, *given),
    "coupled": coupled,
    "mixed": mixed,
}
NO_OBJECTIVE = {
    "a maximisation": (
        cp.Maximize(X[0]),
        "objective: found maximize .*; allowed: a cost.* Give the cost -f",
    ),
    "a problem": (
        cp.Problem(cp.Minimize(X[0])),
        "objective: found a cvxpy problem; .* Give its objective and",
    ),
    "a comparison": (
        X >= 0,
        "objective: found .*; allowed: a cvxpy expression.* belongs to the constraints",
    ),
    "a list": (
        [X[0], X[1]],
        "objective: found a list; allowed: one cvxpy expression. Sum it up",
    ),
    "nothing": (None, "objective: found None; allowed: a cvxpy expression"),
    "a word": ("abc", "objective: found 'abc'; allowed: a cvxpy expression"),
    "a truth value": (True, "objective: found True; allowed: a cvxpy expression"),
    "a function": (
        lambda x: x,
        "objective: found function; allowed: a cvxpy expression",
    ),
    "an array of words": (
        np.array(["a"]),
        "objective: found ndarray; allowed: a cvxpy expression",
    ),
    "complex numbers": (1j * X[0], "objective: found .*; allowed: real numbers"),
}
NO_CONSTRAINTS = {
    "a number": (3, "constraints: found 3; allowed: a list of cvxpy constraints"),
    "a word": (
        "x >= 0",
        "constraints: found 'x >= 0'; allowed: a list of cvxpy constraints",
    ),
    "a dictionary": (
        {"a": X >= 0},
        "constraints: found .*; allowed: a list of cvxpy constraints",
    ),
    "a set": ({X >= 0}, "constraints: found .*; allowed: a list of cvxpy constraints"),
    "a box": (
        Box(0, 1),
        "constraints: found Box.*; allowed: a list of cvxpy constraints. A Box has them",
    ),
    "a box in a list": (
        [Box(0, 1)],
        r"constraints\[0\]: found Box.*; allowed: a cvxpy constraint. A Box has them",
    ),
    "a list in a list": (
        [[X >= 0]],
        r"constraints\[0\]: found .*; allowed: a cvxpy constraint. Give one list",
    ),
    "nothing in a list": (
        [None],
        r"constraints\[0\]: found None; allowed: a cvxpy constraint",
    ),
    "an expression": (
        X,
        "constraints: found .*; allowed: a list of cvxpy constraints|constraints.0.: found",
    ),
    "complex numbers": (
        [1j * X == 0],
        r"constraints\[0\]: found .*; allowed: real numbers",
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NO_OBJECTIVE)
def test_what_is_no_objective_is_refused(kind, name):
    objective, text = NO_OBJECTIVE[name]
    with pytest.raises(ConfigError, match=rf"agent 3: {text}"):
        KINDS[kind](objective)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NO_CONSTRAINTS)
def test_what_is_no_list_of_constraints_is_refused(kind, name):
    constraints, text = NO_CONSTRAINTS[name]
    with pytest.raises(ConfigError, match=rf"agent 3: ({text})"):
        KINDS[kind](X[0], constraints)


def test_a_minimisation_is_its_cost_and_a_bare_constraint_a_list_of_one():
    given = cp.Minimize(cp.sum_squares(X - 2))
    for constraints in (X <= 1, [X <= 1], (X <= 1,), (c for c in [X <= 1])):
        np.testing.assert_allclose(
            CostCoupled(3, X, given, constraints).argmin(), [1.0, 1.0], atol=1e-12
        )
    np.testing.assert_allclose(
        CommonCost(3, X, given, X == 1).argmin(), [1.0, 1.0], atol=1e-12
    )
    np.testing.assert_allclose(
        coupled(given, X == 1).argmin(np.zeros(1)), [1.0, 1.0], atol=1e-12
    )
    np.testing.assert_allclose(
        mixed(cp.Minimize(X[0]), X == 1).corner(np.ones(2)), [1.0, 1.0], atol=1e-12
    )
    np.testing.assert_allclose(
        CostCoupled(3, X, given, None).argmin(), [2.0, 2.0], atol=1e-12
    )
    np.testing.assert_allclose(
        Convex(X, X <= 1).project(np.full(2, 3.0)), [1.0, 1.0], atol=1e-12
    )


NO_COUPLING = {
    "an empty list": ([], "coupling: found no rows; allowed: one row or more"),
    "an empty tuple": ((), "coupling: found no rows; allowed: one row or more"),
    "an empty array": (
        np.zeros((0, 2)),
        "coupling: found no rows; allowed: one row or more",
    ),
    "nothing": (None, "coupling: found None; allowed: a cvxpy expression"),
    "nothing in a list": (
        [X[0], None],
        r"coupling\[1\]: found None; allowed: a cvxpy expression",
    ),
    "a comparison": (X <= 1, "coupling: found .* give g here and b as the share"),
    "a comparison in a list": (
        [X <= 1],
        r"coupling\[0\]: found .* give g here and b as the share",
    ),
    "a minimisation": (
        cp.Minimize(X[0]),
        "coupling: found Minimize; allowed: a cvxpy expression",
    ),
    "a word": ("a", "coupling: found 'a'; allowed: a cvxpy expression"),
    "a dictionary": ({"a": X[0]}, "coupling: found dict; allowed: a cvxpy expression"),
    "a list in a list": (
        [[X[0]]],
        r"coupling\[0\]: found list; allowed: a cvxpy expression",
    ),
    "a truth value": (True, "coupling: found True; allowed: a cvxpy expression"),
}


@pytest.mark.parametrize("kind", [ConstraintCoupled, MixedIntegerConstraintCoupled])
@pytest.mark.parametrize("name", NO_COUPLING)
def test_what_is_no_coupling_is_refused(kind, name):
    coupling, text = NO_COUPLING[name]
    with pytest.raises(ConfigError, match=f"agent 3: {text}"):
        kind(3, X, X[0], coupling, BOX)


def test_a_variable_without_entries_is_refused():
    for make in (
        lambda x: CostCoupled(3, x, 0),
        lambda x: CommonCost(3, x, 0),
        lambda x: Convex(x, []),
    ):
        with pytest.raises(
            ConfigError, match=r"found shape \(0,\); allowed: one entry or more"
        ):
            make(cp.Variable(0))


@pytest.mark.parametrize("bad", ["a", [1, "a"], {}])
def test_a_point_that_is_no_numbers_is_refused(bad):
    problem = CostCoupled(3, X, cp.sum_squares(X))
    for ask in (problem.argmin, problem.project, problem.value, problem.gradient):
        with pytest.raises(
            ConfigError,
            match=r"agent 3: .*: found (str|list|dict); allowed: an array of numbers",
        ):
            ask(bad)
    with pytest.raises(ConfigError, match="agent 3: prices: found"):
        ConstraintCoupled(3, X, cp.sum_squares(X), X).argmin(bad)


@pytest.mark.parametrize("bad", ["a", None, [1], True])
def test_a_penalty_that_is_no_number_is_refused(bad):
    with pytest.raises(
        ConfigError, match=r"agent 3: penalty: found .*; allowed: a finite number >= 0"
    ):
        CostCoupled(3, X, cp.sum_squares(X)).argmin(penalty=bad)


ALGORITHMS = {
    "ADMM": lambda problem: ADMM(problem, [1], 1.0),
    "DualDecomposition": lambda problem: DualDecomposition(problem, 0.1),
    "DualSubgradient": lambda problem: DualSubgradient(problem, {3: 1.0}, 0.1),
    "ConstraintsConsensus": lambda problem: ConstraintsConsensus(problem, 1),
    "Allocation": lambda problem: Allocation(problem, 10.0),
    "Convexified": lambda problem: Convexified(problem, 10.0),
    "PrimalDecompositionMILP": lambda problem: PrimalDecompositionMILP(
        problem, {3: 1.0}, 1, 1, 0.1
    ),
}


@pytest.mark.parametrize("name", ALGORITHMS)
def test_an_algorithm_says_which_problem_it_solves(name):
    for other in (cp.Problem(cp.Minimize(X[0])), cp.Minimize(X[0]), None):
        with pytest.raises(
            ConfigError,
            match=rf"{name}: (problem|block): found {type(other).__name__}; allowed: a ",
        ):
            ALGORITHMS[name](other)


def test_resources_of_a_mixed_integer_block_are_one_or_more():
    with pytest.raises(
        ConfigError, match="agent 3: share: found no rows; allowed: one row or more"
    ):
        MixedIntegerBlock(3, np.ones(2), np.zeros((0, 2)), np.zeros(0))
