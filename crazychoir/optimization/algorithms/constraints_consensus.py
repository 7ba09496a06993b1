"""Constraints consensus: agents exchange the constraints that matter.

They agree in finite time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.optimize import nnls

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.problems.linear import LinearProgram
from crazychoir.optimization.problems.problems import CommonCost, require_problem
from crazychoir.optimization.problems.quadratic import (
    Polyhedron,
    QuadraticProgram,
    require_positive_definite,
)
from crazychoir.optimization.rounds.iteration import Iteration
from crazychoir.optimization.rounds.messages import INTEGER_TYPES, check_parts
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class ConstraintTolerances:
    """Tolerances of the rows and of the optimality of a local solution."""

    row: float = 1e-7
    """Tolerance of a row a'x <= b with |a| = 1.

    It is relative to the row's own terms, |a|'|x| + |b|, and to 1 + |b|.
    """
    negligible_miss: float = 1e-12
    """In the units of z: a row that is missed by less counts as met, whatever its terms are."""
    least_share: float = 1e-9
    """A curvature or slope below this share of the largest one does not choose the unit of its entry."""
    tie_break_weight: float = 1e-5
    """Weight of the tie-break 1/2 |z|^2 beside a linear objective of length one."""
    gradient: float = 1e-8
    """Largest part of a gradient entry without multipliers, relative to the entry's own terms.
    """


CONSTRAINT_TOLERANCES = ConstraintTolerances()


VIOLATED_ROW_BATCH: Final = 4
"""Violated rows that a local solution takes in at once, in multiples of the size of x."""


class ConstraintsConsensus(Iteration):
    """Finite-time solution of  min f(x)  s.t.  x in the intersection of the X_i.

    Agents exchange bases of active constraints:

        B_i <- basis of  min f(x)  s.t.  x in X_i, and the rows of B_i and of B_j for all j heard

    A basis consists of the rows a'x <= b of an optimum that have a positive multiplier, at most n.
    Only bases travel. f(x_i) never falls. When no x_i violates a row that its agent receives, all
    x_i are the optimum of the team's problem.
    The graph is static or time-varying, directed or not, and (jointly, strongly) connected. There
    is no step size.
    f is strictly convex quadratic. If f is not strictly convex, for example linear, f is scaled to
    length one and w |z|^2 / 2 is added, with w = CONSTRAINT_TOLERANCES.tie_break_weight. The tie-break makes the
    optimum unique: the z nearest to 0. In the last round each agent checks, by the multipliers of f alone,
    that the tie-break has not moved the optimum.
    Each agent counts the rounds since the last change that it knows of. With a diameter D all
    agents are done in the same round, 2 D after the last change.

    Agents compute with z = x / unit, where each entry of z has a curvature or a slope near 1 in f. So
    the units of x do not matter, except those of entries that are not in f.

    problem: f and X_i
    diameter: D of a static graph, or None
    rounds: largest number of rounds; needed without a diameter
    unchanged: number of rounds since the last known change
    Raises SolverError as soon as an agent knows constraints that exclude each other. In the last
    round, raises SolverError if f has no minimum, or if the tie-break has moved it.
    Source: Notarstefano & Bullo 2011, IEEE Trans. Autom. Control 56(10), 2247-2261.
    """

    connected = True

    def __init__(
        self,
        problem: CommonCost,
        diameter: int | None = None,
        rounds: int | None = None,
    ) -> None:
        require_problem(problem, CommonCost, "ConstraintsConsensus")
        super().__init__(problem.agent, rounds)
        if diameter is None and rounds is None:
            raise ConfigError(
                f"agent {self.i}: diameter, rounds",
                "None, None",
                "one of them, the same at all agents",
            )
        self.problem = problem
        self.diameter = diameter
        self.unchanged = 0
        self._unit = _choose_units(problem)
        self._P, self._q, self._flat = _make_strictly_convex(problem, self._unit)
        self._own = _normalise(self._scale(_list_inequalities(problem)))
        self._z = np.zeros(problem.n)
        self._basis = np.zeros((0, problem.n + 1))

    @property
    def x(self) -> Vec:
        """(n,) the optimum of all rows known so far."""
        return np.asarray(self._unit * self._z)

    @property
    def basis(self) -> Mat:
        """(m, n + 1), rows [a', b] of the optimum that have a positive multiplier."""
        return np.asarray(self._basis / np.append(self._unit, 1.0))

    def _scale(self, rows: Mat) -> Mat:
        """Return the rows [a', b] for z instead of x. Powers of two round nothing."""
        return np.asarray(rows * np.append(self._unit, 1.0))

    @property
    def done(self) -> bool:
        """True if no agent has changed for long enough, or if the rounds are over."""
        return (
            self.diameter is not None and self.unchanged >= max(1, 2 * self.diameter)
        ) or super().done

    def message(self) -> list[Any]:
        """Return [rounds without a change, basis]."""
        if self.k == 0:
            self._take(self._basis)
            self._improve(self._own)
        return [self.unchanged, self.basis]

    def update(self, heard: Mapping[int, Any]) -> None:
        """Take the bases of the neighbours.

        If x violates one of their rows, find the new optimum and its basis.
        """
        for j, (_, basis) in check_parts(
            self.i, self.k, heard, INTEGER_TYPES, object
        ).items():
            width = self.problem.n + 1
            if getattr(basis, "ndim", 0) != 2 or basis.shape[1] != width:
                allowed = f"(m, {width}), as its own"
                raise ConfigError(
                    f"agent {self.i}: message of agent {j}",
                    f"a basis {np.shape(basis)}",
                    allowed,
                )
        changed = self._improve(
            np.vstack([self._own, *(self._scale(basis) for _, basis in heard.values())])
        )
        fewest = min([self.unchanged, *(int(count) for count, _ in heard.values())])
        self.unchanged = 0 if changed else fewest + 1

    def step(self, heard: Mapping[int, Any]) -> None:
        """Compute one round; after the last one, check that the tie-break did not move x."""
        super().step(heard)
        if self.done and self._flat:
            self._require_least()

    def _require_least(self) -> None:
        """Raise SolverError unless x minimises f without the tie-break.

        The condition is -grad f(x) = A'u over the basis, with some u >= 0.
        """
        pull = (
            self._q
            + self._P @ self._z
            - CONSTRAINT_TOLERANCES.tie_break_weight * self._z
        )
        rows = self._basis[:, :-1]
        # Each entry is measured in its own unit. Otherwise a small entry, of an x in small units,
        # would vanish beside a large one.
        unit = np.abs(self._q) + np.abs(self._P) @ np.abs(self._z)
        unit = np.where(
            unit > 0.0,
            unit,
            np.maximum(
                np.abs(rows).max(axis=0, initial=0.0), CONSTRAINT_TOLERANCES.gradient
            ),
        )
        pull = pull / unit
        missing = (
            nnls((rows / unit).T, -pull)[1]
            if len(rows)
            else float(np.linalg.norm(pull))
        )
        if missing > CONSTRAINT_TOLERANCES.gradient:
            k = int(np.argmax(np.abs(self._z)))
            found = (
                f"x[{k}] = {self.x[k]:.6g} is held by the tie-break "
                f"{CONSTRAINT_TOLERANCES.tie_break_weight:g} |z|^2 / 2, not by constraints"
            )
            do = "the optimum is farther away, or there is none; bound x, take larger units, or DualDistributedSimplex"
            raise SolverError(
                f"agent {self.i}: constraints consensus", f"{found}: {do}"
            )

    def _improve(self, rows: Mat) -> bool:
        """Take in violated rows until x violates none; return True if there were any."""
        steps = 0
        while len(worst := self._violated(rows)):
            steps += 1
            if steps > len(rows):
                found = f"{steps} steps without an optimum: rows that double precision cannot tell apart"
                do = "take units in which x is near 1, or use DualDistributedSimplex"
                raise SolverError(
                    f"agent {self.i}: constraints consensus", f"{found}; {do}"
                )
            self._take(np.vstack([self._basis, worst]))
        return steps > 0

    def _violated(self, rows: Mat) -> Mat:
        """Return the rows that x violates most."""
        a = rows[:, :-1]
        b = rows[:, -1]
        terms = np.minimum(np.abs(a) @ np.abs(self._z), 1.0) + np.abs(b)
        excess = (
            a @ self._z
            - b
            - CONSTRAINT_TOLERANCES.row * terms
            - CONSTRAINT_TOLERANCES.negligible_miss
        )
        worst = np.argsort(-excess, kind="stable")[
            : VIOLATED_ROW_BATCH * self.problem.n
        ]
        return np.asarray(rows[worst[excess[worst] > 0.0]])

    def _take(self, rows: Mat) -> None:
        """Find the optimum over these rows, and its basis."""
        n = self.problem.n
        over = Polyhedron(
            np.ascontiguousarray(rows[:, :-1]),
            rows[:, -1],
            np.zeros((0, n)),
            np.zeros(0),
        )
        program = QuadraticProgram(self._P, self._q, over)
        found = program.solve(np.zeros(n))
        if isinstance(found, str):
            raise SolverError(
                f"agent {self.i}: constraints that it knows", self._why(found, rows)
            )
        self._basis = rows[program.u > 0.0] if len(rows) else rows
        self._z = self._corner(found)

    def _corner(self, near: Vec) -> Vec:
        """Return z computed from its basis alone: P z + A'u + q = 0, A z = b.

        This removes the rounding of a start that is far away.
        """
        A = self._basis[:, :-1]
        b = self._basis[:, -1]
        if not len(b):
            return near
        zero = np.zeros((len(b), len(b)))
        both = np.linalg.solve(
            np.block([[self._P, A.T], [A, zero]]), np.concatenate([-self._q, b])
        )
        return np.ascontiguousarray(both[: self.problem.n])

    def _why(self, status: str, rows: Mat) -> str:
        """Explain a status. If rows exclude each other, name the row with the largest violation.

        The violations are those of the x with the least sum of violations.
        """
        if status != "infeasible":
            return status
        m = len(rows)
        n = self.problem.n
        # Scale to numbers near 1, where the tolerances of HiGHS apply.
        size = float(np.abs(rows[:, -1]).max()) or 1.0
        elastic = np.hstack([rows[:, :-1], -np.eye(m)]), rows[:, -1] / size
        bounds = np.r_[np.full(n, -np.inf), np.zeros(m)], np.full(n + m, np.inf)
        missed = LinearProgram(
            np.r_[np.zeros(n), np.ones(m)], elastic, bounds=bounds
        ).solve(np.zeros(n + m))
        if isinstance(missed, str):
            return status
        r = int(np.argmax(missed[n:]))
        written = rows[r, :-1] / self._unit
        row = " ".join(f"{a:+.4g} x[{k}]" for k, a in enumerate(written) if a)
        return f"infeasible: row {row} <= {rows[r, -1]:.4g}: violated by {size * missed[n + r]:.4g}, at best"


def _normalise(rows: Mat) -> Mat:
    """Return the rows [a', b] with |a| = 1."""
    length = np.linalg.norm(rows[:, :-1], axis=1, keepdims=True)
    return np.asarray(rows / np.where(length > 0.0, length, 1.0))


def _choose_units(problem: CommonCost) -> Vec:
    """Return the units (n,) of x in which each entry counts alike in f: powers of two.

    In them a curvature, or else a slope, is 1 to 4. An entry that is not in f keeps its unit; a number
    of f that is tiny beside the largest one is a rounded zero.
    """
    curvature = _drop_rounded_zeros(np.abs(np.diag(problem.cost.P)))
    slope = _drop_rounded_zeros(np.abs(problem.cost.q))
    size = np.where(curvature > 0.0, np.sqrt(curvature), slope)
    return 1.0 / _floor_to_power_of_two(np.where(size > 0.0, size, 1.0))


def _drop_rounded_zeros(sizes: Vec) -> Vec:
    least = CONSTRAINT_TOLERANCES.least_share * sizes.max(initial=0.0)
    return np.where(sizes > least, sizes, 0.0)


def _floor_to_power_of_two(size: Vec) -> Vec:
    return np.asarray(np.ldexp(np.ones(len(size)), np.frexp(size)[1] - 1))


def _make_strictly_convex(problem: CommonCost, unit: Vec) -> tuple[Mat, Vec, bool]:
    """Return P and q of f(unit z), with a tie-break if f needs one, and whether it does."""
    P = problem.cost.P * np.outer(unit, unit)
    q = problem.cost.q * unit
    try:
        return require_positive_definite(P), q, False
    except np.linalg.LinAlgError:
        length = max(float(np.abs(P).max()), float(np.linalg.norm(q))) or 1.0
        return (
            P / length + CONSTRAINT_TOLERANCES.tie_break_weight * np.eye(problem.n),
            q / length,
            True,
        )


def _list_inequalities(problem: CommonCost) -> Mat:
    """Return X_i as rows [a', b]; an equality becomes two rows."""
    over = problem.polyhedron
    equal = np.column_stack([over.E, over.e])
    return np.vstack([np.column_stack([over.A, over.b]), equal, -equal])
