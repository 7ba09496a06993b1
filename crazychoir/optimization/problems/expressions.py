"""Check cvxpy expressions, and read affine and quadratic ones into matrices."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.quadratic import Polyhedron
from crazychoir.types import Mat, Vec

ALLOWED_EXPRESSION = "a cvxpy expression, or numbers"


def require_decision_variable(x: Any, where: str) -> int:
    """Return the dimension n of the decision variable x.

    Raises ConfigError unless x is a cvxpy variable, a scalar or a vector.
    """
    if not isinstance(x, cp.Variable):
        raise ConfigError(f"{where}: x", type(x).__name__, "a cvxpy.Variable")
    if x.ndim > 1:
        do = "Use a vector, and cvxpy.reshape."
        raise ConfigError(
            f"{where}: {x.name()}", f"shape {x.shape}", "a scalar or a vector", do
        )
    if x.size == 0:
        raise ConfigError(
            f"{where}: {x.name()}", f"shape {x.shape}", "one entry or more"
        )
    return int(x.size)


def list_domain_constraints(
    x: cp.Variable, where: str, whole: bool = False
) -> list[cp.Constraint]:
    """Return the attributes of x, such as nonneg or bounds, as constraints.

    whole: accept the attributes integer and boolean
    Raises ConfigError for other attributes.
    """
    said = {
        name
        for name, value in x.attributes.items()
        if value is not None and value is not False
    }
    said -= {"integer", "boolean"} if whole else set()
    if said - {"nonneg", "pos", "nonpos", "neg", "bounds"}:
        do = "Integers are for MixedIntegerConstraintCoupled."
        raise ConfigError(
            f"{where}: {x.name()}",
            f"attributes {sorted(said)}",
            "a real vector, perhaps bounded",
            do,
        )
    found: list[cp.Constraint] = [x >= 0] if said & {"nonneg", "pos"} else []
    found += [x <= 0] if said & {"nonpos", "neg"} else []
    for low in (True, False) if "bounds" in said else ():
        bound = np.broadcast_to(x.attributes["bounds"][0 if low else 1], x.shape)
        at = np.flatnonzero(np.isfinite(np.atleast_1d(bound)))
        if len(at):
            flat = cp.vec(x, order="F")[at]
            limit = np.atleast_1d(bound)[at]
            found.append(flat >= limit if low else flat <= limit)
    return found


def require_continuous(expressions: Sequence[Any], where: str) -> None:
    """Raise ConfigError that names a variable which must be an integer."""
    for variable in [v for expression in expressions for v in expression.variables()]:
        if any(variable.attributes[name] for name in ("integer", "boolean")):
            do = "Integers are for MixedIntegerConstraintCoupled."
            raise ConfigError(
                f"{where}: {variable.name()}",
                "an integer variable",
                "continuous variables",
                do,
            )


def find_integer_entries(x: cp.Variable) -> tuple[list[int], list[int]]:
    """Return the indices of the integer entries of x, and the indices of the entries in {0, 1}.

    The first list contains the second.
    """
    found = []
    for name, places in (("integer", x.integer_idx), ("boolean", x.boolean_idx)):
        everywhere = x.attributes[name] is True
        found.append(
            list(range(x.size))
            if everywhere
            else [int(k) for k in np.ravel(np.array(places, dtype=int))]
        )
    return sorted({*found[0], *found[1]}), found[1]


def require_convex(expression: Any, where: str) -> cp.Expression:
    """Return a scalar objective f that is convex by the rules of DCP and DPP, with finite data.

    cp.Minimize(f) is accepted and gives f. Raises ConfigError for all other input.
    """
    if isinstance(expression, cp.Minimize):
        expression = expression.args[0]
    if isinstance(expression, cp.Maximize):
        do = "Give the cost -f instead of the gain f."
        raise ConfigError(where, str(expression), "a cost, which is minimised", do)
    if isinstance(expression, (list, tuple)):
        raise ConfigError(
            where,
            f"a {type(expression).__name__}",
            "one cvxpy expression",
            "Sum it up.",
        )
    found = _convert_to_expression(expression, where)
    if found.size != 1:
        raise ConfigError(where, f"shape {found.shape}", "one number", "Sum it up.")
    return _require_convex_by_rules(found, where)


def build_coupling(expression: Any, where: str) -> cp.Expression:
    """Return a vector g of convex expressions, built from one expression or a list of them."""
    listed = isinstance(expression, (list, tuple))
    given = list(expression) if isinstance(expression, (list, tuple)) else [expression]
    parts = [
        _convert_to_expression(part, f"{where}[{s}]" if listed else where)
        for s, part in enumerate(given)
    ]
    if not sum(part.size for part in parts):
        do = "Without a common resource each agent solves its problem alone."
        raise ConfigError(
            where, "no rows", "one row or more, the same number at all agents", do
        )
    ruled = [
        _require_convex_by_rules(part, f"{where}[{s}]" if listed else where)
        for s, part in enumerate(parts)
    ]
    return cp.hstack([cp.vec(part, order="F") for part in ruled])


def _convert_to_expression(given: Any, where: str) -> cp.Expression:
    """Return the given expression, or the given numbers as a constant expression."""
    if isinstance(given, cp.Expression):
        found = given
    elif isinstance(given, cp.constraints.constraint.Constraint):
        do = "A comparison belongs to the constraints; of g <= b, give g here and b as the share."
        raise ConfigError(where, str(given), ALLOWED_EXPRESSION, do)
    elif isinstance(given, cp.Problem):
        do = "Give its objective and its constraints apart."
        raise ConfigError(where, "a cvxpy problem", ALLOWED_EXPRESSION, do)
    elif given is None or isinstance(given, (bool, np.bool_, str, bytes)):
        raise ConfigError(where, repr(given), ALLOWED_EXPRESSION)
    else:
        try:
            found = cp.Expression.cast_to_const(given)
        except (TypeError, ValueError) as error:
            raise ConfigError(
                where, type(given).__name__, ALLOWED_EXPRESSION
            ) from error
    if found.is_complex():
        raise ConfigError(
            where, str(found), "real numbers", "Take real and imaginary parts apart."
        )
    return found


def _require_convex_by_rules(expression: cp.Expression, where: str) -> cp.Expression:
    require_finite(expression, where)
    if not expression.is_convex():
        raise ConfigError(
            where,
            str(expression),
            "a convex expression, by the rules of cvxpy (dcp.stanford.edu)",
        )
    if not expression.is_dpp():
        raise ConfigError(
            where,
            str(expression),
            "parameters by the rules of DPP",
            "Multiply no two parameters.",
        )
    return expression


def list_constraints(constraints: Any, where: str) -> list[cp.Constraint]:
    """Return the constraints as a list, each convex and with finite data.

    A single constraint counts as a list of one.
    """
    if isinstance(constraints, cp.constraints.constraint.Constraint):
        constraints = [constraints]
    elif constraints is None:
        constraints = []
    elif isinstance(constraints, (str, bytes, Mapping, Set)) or not isinstance(
        constraints, Iterable
    ):
        do = _advise_on_entry(constraints)
        raise ConfigError(
            f"{where}: constraints",
            repr(constraints),
            "a list of cvxpy constraints",
            do,
        )
    listed = list(constraints)
    for r, constraint in enumerate(listed):
        at = f"{where}: constraints[{r}]"
        if not isinstance(constraint, cp.constraints.constraint.Constraint):
            raise ConfigError(
                at, repr(constraint), "a cvxpy constraint", _advise_on_entry(constraint)
            )
        if any(part.is_complex() for part in constraint.args):
            raise ConfigError(
                at,
                str(constraint),
                "real numbers",
                "Take real and imaginary parts apart.",
            )
        require_finite(constraint, at)
        if not constraint.is_dcp():
            raise ConfigError(
                at,
                str(constraint),
                "a convex set, by the rules of cvxpy (dcp.stanford.edu)",
            )
        if not constraint.is_dcp(dpp=True):
            raise ConfigError(
                at,
                str(constraint),
                "parameters by the rules of DPP",
                "Multiply no two parameters.",
            )
    return listed


def _advise_on_entry(found: Any) -> str:
    """Return advice about an entry of a list of constraints that is not a constraint."""
    if isinstance(found, (bool, np.bool_)):
        return "Compare expressions of cvxpy variables."
    if isinstance(found, (list, tuple)):
        return "Give one list, without lists in it."
    if callable(getattr(found, "constraints", None)):
        return f"A {type(found).__name__} has them: constraints(x), a list."
    return ""


def require_finite(expression: Any, where: str) -> None:
    """Raise ConfigError for a number that is not finite, or a parameter without a value.

    The error names the first one.
    """
    for data in [*expression.constants(), *expression.parameters()]:
        with _suppress_sparse_warning():
            given = data.value
        if given is None:
            raise ConfigError(
                f"{where}: parameter {data.name()}",
                "no value",
                "a value",
                "Set its `value`.",
            )
        value = _convert_to_dense(given)
        bad = np.argwhere(~np.isfinite(value))
        if len(bad):
            at = tuple(int(k) for k in bad[0])
            entry = ", ".join(str(k) for k in at)
            raise ConfigError(
                f"{where}: data[{entry}]",
                f"{value[at]}",
                "finite numbers",
                f"It is in {expression}.",
            )


def is_function_of(expression: Any, x: cp.Variable) -> bool:
    """Return True if the expression depends on no variable but x."""
    return all(variable.id == x.id for variable in expression.variables())


@contextmanager
def _suppress_sparse_warning() -> Iterator[None]:
    """Suppress cvxpy's warning about reading a sparse parameter.

    The warning does not matter: the parameter becomes a dense matrix in any case.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message="Reading from a sparse CVXPY expression"
        )
        yield


@contextmanager
def _place_variable(x: cp.Variable, point: Vec) -> Iterator[None]:
    """Set the value of x to a point, and restore the user's value at the end."""
    before = x.value
    x.save_value(point.reshape(x.shape))
    try:
        with _suppress_sparse_warning():
            yield
    finally:
        x.save_value(before)


def evaluate_at(expression: cp.Expression, x: cp.Variable, point: Vec) -> Vec:
    """Return the values (S,) of the expression at x = point."""
    with _place_variable(x, point), np.errstate(all="ignore"):
        return _convert_to_dense(expression.value).reshape(-1, order="F")


def compute_slope(expression: cp.Expression, x: cp.Variable, point: Vec) -> Mat:
    """Return a (sub)gradient (S, n) of each entry of the expression at x = point.

    Entries are nan if the point is outside the domain.
    """
    if not np.isfinite(
        evaluate_at(expression, x, point)
    ).all():  # cvxpy does not report a sum outside its domain
        return np.full((expression.size, x.size), np.nan)
    with _place_variable(x, point):
        found = expression.grad
    if x not in found:
        return np.zeros((expression.size, x.size))
    if found[x] is None:
        return np.full((expression.size, x.size), np.nan)
    return _convert_to_dense(found[x]).reshape(x.size, expression.size).T


def decompose_affine(expression: cp.Expression, x: cp.Variable) -> tuple[Mat, Vec]:
    """Return G (S, n) and h (S,) of an affine expression G x + h."""
    zero = np.zeros(x.size)
    return compute_slope(expression, x, zero), evaluate_at(expression, x, zero)


def _convert_to_dense(value: Any) -> Vec:
    """Return the numbers of cvxpy, a float, an array or a sparse matrix, as a dense array."""
    return np.atleast_1d(
        np.asarray(value.toarray() if hasattr(value, "toarray") else value, float)
    )


@dataclass(frozen=True)
class Quadratic:
    """The function 1/2 x'Px + q'x + r."""

    P: Mat
    """(n, n), symmetric."""
    q: Vec
    """(n,) linear term."""
    r: float
    """Constant term."""

    @classmethod
    def zero(cls, n: int) -> "Quadratic":
        """Return the function of n variables that is 0 everywhere."""
        return cls(np.zeros((n, n)), np.zeros(n), 0.0)

    def value(self, x: Vec) -> float:
        """Return the value at x (n,)."""
        return float(x @ (0.5 * (self.P @ x) + self.q) + self.r)

    def gradient(self, x: Vec) -> Vec:
        """Return the gradient P x + q."""
        return self.P @ x + self.q

    def __add__(self, other: "Quadratic") -> "Quadratic":
        return Quadratic(self.P + other.P, self.q + other.q, self.r + other.r)

    def times(self, factor: float) -> "Quadratic":
        """Return this function, scaled by a factor."""
        return Quadratic(factor * self.P, factor * self.q, factor * self.r)


def decompose_linear(
    expression: cp.Expression, x: cp.Variable, where: str
) -> tuple[Mat, Vec]:
    """Return G and h as `decompose_affine` does.

    Raises ConfigError unless the expression is affine in x alone.
    """
    if not (expression.is_affine() and is_function_of(expression, x)):
        raise ConfigError(where, str(expression), f"a linear function of {x.name()}")
    return decompose_affine(expression, x)


def decompose_quadratics(
    expression: cp.Expression, x: cp.Variable
) -> list[Quadratic] | None:
    """Return the entries of the expression if all are quadratic functions of x alone, else None.

    The matrices are read from the gradients, which are linear for a quadratic function.
    """
    if not is_function_of(expression, x) or not expression.is_quadratic():
        return None
    zero = np.zeros(x.size)
    r = evaluate_at(expression, x, zero)
    q = compute_slope(expression, x, zero)
    hessians = np.array(
        [compute_slope(expression, x, e) - q for e in np.eye(x.size)]
    ).transpose(1, 0, 2)
    return [
        Quadratic((P + P.T) / 2, *rest)
        for P, *rest in zip(hessians, q, r.tolist(), strict=True)
    ]


def require_polyhedral(
    constraints: Sequence[cp.Constraint], x: cp.Variable, where: str
) -> None:
    """Raise ConfigError unless all constraints are linear (in)equalities of x alone.

    The error names the first constraint that is not.
    """
    for r, c in enumerate(constraints):
        if not is_polyhedral([c], x):
            raise ConfigError(
                f"{where}: constraints[{r}]",
                str(c),
                f"linear (in)equalities of {x.name()}",
            )


def is_polyhedral(constraints: Sequence[cp.Constraint], x: cp.Variable) -> bool:
    """Return True if all constraints are linear (in)equalities of x alone."""
    return all(
        isinstance(c, LINEAR_CONSTRAINT_TYPES)
        and c.expr.is_affine()
        and is_function_of(c, x)
        for c in constraints
    )


def build_polyhedron(
    constraints: Sequence[cp.Constraint], x: cp.Variable
) -> Polyhedron | None:
    """Return the set that the constraints describe.

    Returns None if it is not a polyhedron, or if it involves variables other than x.
    """
    return (
        Polyhedron.of(*decompose_rows(constraints, x))
        if is_polyhedral(constraints, x)
        else None
    )


def decompose_rows(
    constraints: Sequence[cp.Constraint], x: cp.Variable
) -> tuple[Mat, Vec, Mat, Vec]:
    """Return A, b, E, e of linear constraints: A x <= b, E x = e."""
    found: dict[bool, list[tuple[Mat, Vec]]] = {False: [], True: []}
    for c in constraints:
        G, h = decompose_affine(c.expr, x)
        sign = -1.0 if isinstance(c, NONNEGATIVITY_TYPES) else 1.0
        found[isinstance(c, EQUALITY_TYPES)].append((sign * G, -sign * h))
    empty = (np.zeros((0, x.size)), np.zeros(0))
    upper, equal = ([empty, *found[kind]] for kind in (False, True))
    return (
        np.vstack([G for G, _ in upper]),
        np.concatenate([h for _, h in upper]),
        np.vstack([G for G, _ in equal]),
        np.concatenate([h for _, h in equal]),
    )


EQUALITY_TYPES = (cp.constraints.zero.Equality, cp.constraints.zero.Zero)
"""Types of constraints expr = 0."""
NONNEGATIVITY_TYPES = (cp.constraints.nonpos.NonNeg,)
"""Types of constraints expr >= 0."""
LINEAR_CONSTRAINT_TYPES = (
    *EQUALITY_TYPES,
    *NONNEGATIVITY_TYPES,
    cp.constraints.nonpos.Inequality,
    cp.constraints.nonpos.NonPos,
)
"""Types of linear (in)equalities."""
