"""Projections onto convex sets, in closed form where one exists."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.rounds.arrays import is_number
from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.types import Vec


class ConvexSet(Protocol):
    """A closed convex set that can project a point and describe itself to cvxpy."""

    def project(self, x: Vec) -> Vec:
        """Return the nearest point of the set."""
        ...

    def constraints(self, x: Any) -> list[Any]:
        """Return cvxpy's constraints for x in the set."""
        ...


@dataclass(frozen=True, eq=False)
class Box:
    """The box {x: low <= x <= high}, entry by entry; bounds may be infinite.

    P(x) = min(max(x, low), high)
    """

    low: ArrayLike
    """Lower bounds: an array, or a number for all entries."""
    high: ArrayLike
    """Upper bounds: an array, or a number for all entries."""
    shape: tuple[int, ...] = field(init=False, repr=False)
    """Shape of the points; () if low and high are numbers and hold for points of any shape."""

    def __post_init__(self) -> None:
        low = _read_bound("low", self.low)
        high = _read_bound("high", self.high)
        found = f"low {low.tolist()}, high {high.tolist()}"
        if low.ndim and high.ndim and low.shape != high.shape:
            raise ConfigError(
                "box", found, "low and high of one shape, or a number for all entries"
            )
        if not np.all(low <= high):
            raise ConfigError("box", found, "low at most high in each entry")
        object.__setattr__(self, "shape", low.shape or high.shape)

    def project(self, x: Vec) -> Vec:
        """Return the nearest point of the set."""
        if self.shape and np.shape(x) != self.shape:
            raise _build_size_error("box", np.shape(x), self.shape)
        return np.minimum(np.maximum(x, self.low), self.high)

    def constraints(self, x: Any) -> list[Any]:
        """Return low <= x <= high, for the bounds that are finite."""
        low, high = (
            np.broadcast_to(np.asarray(bound, dtype=float), x.shape)
            for bound in (self.low, self.high)
        )
        below = np.flatnonzero(np.isfinite(low))
        above = np.flatnonzero(np.isfinite(high))
        return [x[below] >= low[below]] * bool(below.size) + [
            x[above] <= high[above]
        ] * bool(above.size)


@dataclass(frozen=True, eq=False)
class Strip:
    """The strip {x: |a'x - b| <= width / 2}.

    It holds every x that agrees with a measurement b of a'x with an error of at most
    width / 2.

    P(x) = x - a (r - min(max(r, -width/2), width/2)) / a'a,   r = a'x - b
    """

    a: ArrayLike
    """(n,) direction of the measurement, not zero."""
    b: float
    """Measured value of a'x."""
    width: float
    """Width of the strip: twice the largest error."""
    shape: tuple[int, ...] = field(init=False, repr=False)
    """Shape of the points."""

    def __post_init__(self) -> None:
        a = copy_state("strip: a", self.a)
        if a.ndim != 1:
            raise ConfigError("strip: a", f"shape {a.shape}", "a vector")
        for name, value in (("b", self.b), ("width", self.width)):
            if not is_number(value):
                raise ConfigError(f"strip: {name}", repr(value), "a number")
        object.__setattr__(self, "shape", a.shape)
        if not (a @ a > 0.0 and np.isfinite(self.b) and self.width >= 0.0):
            found = f"a {a.tolist()}, b {self.b}, width {self.width}"
            raise ConfigError("strip", found, "a not zero, b finite, width 0 or more")

    def project(self, x: Vec) -> Vec:
        """Return the nearest point of the set."""
        if np.shape(x) != self.shape:
            raise _build_size_error("strip", np.shape(x), self.shape)
        a = np.atleast_1d(np.asarray(self.a, dtype=float))
        r = float(a @ x - self.b)
        beyond = r - min(max(r, -self.width / 2), self.width / 2)
        return np.asarray(x - a * (beyond / (a @ a)))

    def constraints(self, x: Any) -> list[Any]:
        """Return -width/2 <= a'x - b <= width/2."""
        r = np.atleast_1d(np.asarray(self.a, dtype=float)) @ x - self.b
        return [r <= self.width / 2, r >= -self.width / 2]


@dataclass(frozen=True, eq=False)
class Disc:
    """The ball {x: |x - c| <= radius}, in any dimension: what a measured distance allows.

    P(x) = c + (x - c) min(1, radius / |x - c|)
    """

    c: ArrayLike
    """(n,) centre."""
    radius: float
    """Radius, 0 or more."""
    shape: tuple[int, ...] = field(init=False, repr=False)
    """Shape of the points."""

    def __post_init__(self) -> None:
        c = copy_state("disc: c", self.c)
        if c.ndim != 1:
            raise ConfigError("disc: c", f"shape {c.shape}", "a vector")
        object.__setattr__(self, "shape", c.shape)
        if not is_number(self.radius):
            raise ConfigError("disc: radius", repr(self.radius), "a number")
        if not 0.0 <= self.radius < np.inf:
            raise ConfigError("disc: radius", self.radius, "0 or more")

    def project(self, x: Vec) -> Vec:
        """Return the nearest point of the set."""
        if np.shape(x) != self.shape:
            raise _build_size_error("disc", np.shape(x), self.shape)
        c = np.atleast_1d(np.asarray(self.c, dtype=float))
        away = x - c
        distance = float(np.linalg.norm(away))
        return np.asarray(
            x if distance <= self.radius else c + away * (self.radius / distance)
        )

    def constraints(self, x: Any) -> list[Any]:
        """Return |x - c| <= radius."""
        return [
            _import_cvxpy().norm2(x - np.atleast_1d(np.asarray(self.c, dtype=float)))
            <= self.radius
        ]


class Convex:
    """A set that is given by cvxpy's constraints on a variable.

        P(z) = argmin |x - z|^2  subject to the constraints

    The projection is a problem that is compiled once, see solver_choice.py.

    x: cvxpy.Variable with one dimension
    constraints: cvxpy's constraints on x
    where: name of the set in error texts, such as "agent 3: set"
    """

    def __init__(self, x: Any, constraints: Sequence[Any], where: str = "set") -> None:
        # Imported here, as they import cvxpy, which closed forms do not need.
        from crazychoir.optimization.problems import expressions
        from crazychoir.optimization.problems import (
            solver_choice as programs,
        )

        n = expressions.require_decision_variable(x, where)
        self.x = x
        self.where = where
        self.shape = (n,)
        self._given = [
            *expressions.list_constraints(constraints, where),
            *expressions.list_domain_constraints(x, where),
        ]
        over = expressions.build_polyhedron(self._given, x)
        zero = expressions.Quadratic.zero(n)
        nothing = _import_cvxpy().Constant(0.0)
        self._program = programs.compile_problem(
            zero, over, x, nothing, self._given, penalty=1.0
        )

    def project(self, x: Vec) -> Vec:
        """Return the nearest point of the set; raise SolverError if the set is empty."""
        if np.shape(x) != self.shape:
            raise _build_size_error(self.where, np.shape(x), self.shape)
        found = self._program.solve(-np.asarray(x, float))
        if isinstance(found, str):
            from crazychoir.optimization.problems import diagnosis

            why = diagnosis.explain_no_point(found, self._given, self.x)
            raise SolverError(
                f"{self.where}: projection of {np.asarray(x).tolist()}", why
            )
        return found

    def constraints(self, x: Any) -> list[Any]:
        """Return the given constraints and x = the given variable."""
        return [*self._given, x == self.x]


class Intersection:
    """The points that are in all of the given sets.

    With one set, its own projection is used. Several boxes become their common box. All other
    combinations are projected by cvxpy, compiled when a set is added.

    n: length of x
    sets: the sets; a single set counts as a list of one
    where: name of the intersection in error texts
    Raises SolverError if no point is in all sets.
    """

    def __init__(self, n: int, sets: Sequence[ConvexSet], where: str = "set") -> None:
        self.n = n
        self.where = where
        self.sets = [
            self._checked(one, f"{where}[{r}]")
            for r, one in enumerate(_list_sets(sets, where))
        ]
        self._whole = self._joined()

    def add(self, one: ConvexSet) -> None:
        """Add a set, which makes the intersection smaller."""
        self.sets.append(self._checked(one, f"{self.where}[{len(self.sets)}]"))
        self._whole = self._joined()

    def project(self, x: Vec) -> Vec:
        """Return the nearest point of the set."""
        return x if self._whole is None else self._whole.project(x)

    def constraints(self, x: Any) -> list[Any]:
        """Return the constraints of all sets."""
        return [constraint for one in self.sets for constraint in one.constraints(x)]

    def _checked(self, one: Any, where: str) -> ConvexSet:
        """Return the set; raise ConfigError unless its points have shape (n,)."""
        if not (
            callable(getattr(one, "project", None))
            and callable(getattr(one, "constraints", None))
        ):
            raise ConfigError(
                where,
                repr(one),
                "a set: Box, Strip, Disc, Convex, or another ConvexSet",
            )
        shape = getattr(one, "shape", ())
        if shape and shape != (self.n,):
            found = f"a {type(one).__name__} of points of shape {shape}"
            raise ConfigError(where, found, f"a set of points of shape ({self.n},)")
        kept: ConvexSet = one
        return kept

    def _joined(self) -> ConvexSet | None:
        if len(self.sets) <= 1:
            return self.sets[0] if self.sets else None
        boxes = [one for one in self.sets if isinstance(one, Box)]
        if len(boxes) == len(self.sets):
            return self._box(boxes)
        x = _import_cvxpy().Variable(self.n)
        return Convex(x, self.constraints(x), self.where)

    def _box(self, boxes: Sequence[Box]) -> Box:
        low = np.max([np.broadcast_to(box.low, self.n) for box in boxes], axis=0)
        high = np.min([np.broadcast_to(box.high, self.n) for box in boxes], axis=0)
        empty = np.flatnonzero(low > high)
        if empty.size:
            row = int(empty[0])
            raise SolverError(
                f"{self.where}: row {row}",
                f"infeasible: from {low[row]:g} to {high[row]:g}",
            )
        return Box(low, high)


def _list_sets(sets: Any, where: str) -> Sequence[Any]:
    """Return the sets as a list; a single set counts as a list of one."""
    if callable(getattr(sets, "project", None)):
        return [sets]
    if isinstance(sets, (str, Mapping)) or not isinstance(sets, Iterable):
        raise ConfigError(where, repr(sets), "a list of sets")
    return list(sets)


def _read_bound(name: str, value: ArrayLike) -> Vec:
    """Return the lower or upper bound of a box as an array of numbers, which may be infinite."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"box: {name}", repr(value), "a number, or an array of them"
        ) from error


def _build_size_error(
    where: str, found: tuple[int, ...], shape: tuple[int, ...]
) -> ConfigError:
    """Return the error for a point of another shape than the points of the set."""
    return ConfigError(
        f"{where}: point", f"shape {found}", f"shape {shape}, as the set's points"
    )


def _import_cvxpy() -> Any:
    """Import cvxpy when it is first needed: it takes 1 s, and closed forms do without it."""
    import cvxpy

    return cvxpy
