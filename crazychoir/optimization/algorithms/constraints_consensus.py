"""Constraints consensus: agents exchange the few constraints that matter, and agree in finite time."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from scipy.optimize import nnls

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.problems.linear import LinearProgram
from crazychoir.optimization.problems.problems import CommonCost, require_problem
from crazychoir.optimization.problems.quadratic import (
    Polyhedron,
    QuadraticProgram,
    positive,
)
from crazychoir.optimization.rounds.iteration import Iteration
from crazychoir.optimization.rounds.messages import INTEGER, parts
from crazychoir.types import Mat, Vec

TOLERANCE: Final = 1e-7
"""What a row a'x <= b with |a| = 1 may be missed by, relative to its own terms, |a|'|x| + |b|, and to 1 + |b|."""
NEGLIGIBLE: Final = 1e-12
"""In the units of x: a row that is missed by less is met, whatever its terms are."""
TIE: Final = 1e-5
"""Weight of 1/2 |x|^2 beside a linear objective of length one."""
CERTAIN: Final = 1e-8
"""What multipliers may leave of an entry of the gradient, relative to its own terms."""
BATCH: Final = 4
"""Violated rows that the local solution takes in at a time, in dimensions of x."""


class ConstraintsConsensus(Iteration):
    """Finite-time solution of  min f(x)  s.t.  x in the intersection of the X_i, by bases of active constraints.

        B_i <- basis of  min f(x)  s.t.  x in X_i, and the rows of B_i and of B_j for all j heard

    A basis is the rows a'x <= b of an optimum that have a positive multiplier, at most n; it is all that travels.
    f(x_i) never falls, and where no x_i violates what its agent hears, all are the optimum of the team's problem.
    Static or time-varying graphs, directed too, (jointly, strongly) connected. No step size.
    f is strictly convex quadratic; to one that is not, as a linear one, TIE |x|^2 / 2 is added, with f scaled to length
    one: it makes the optimum unique, the one closest to 0. In the last round each checks, by the multipliers of f
    alone, that TIE has not moved it: that it is small beside them.
    diameter: D of a static graph: all are done in the same round, 2 D after the last change, as each counts the rounds
    since the last change that it has heard of;  rounds: at most, or where no diameter is given.
    x: (n,);  basis: (m, n + 1), rows [a', b] with |a| = 1;  unchanged: that count.
    Raises SolverError as soon as an agent knows constraints that exclude each other, and, in the last round, where f
    has no minimum, or TIE has moved it.
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
        self._P, self._q, self._flat = _strictly_convex(problem)
        self._own = _inequalities(problem)
        self.x = np.zeros(problem.n)
        self.basis = np.zeros((0, problem.n + 1))

    @property
    def done(self) -> bool:
        """Whether nothing has changed anywhere for long enough, or the rounds are over."""
        return (
            self.diameter is not None and self.unchanged >= max(1, 2 * self.diameter)
        ) or super().done

    def message(self) -> list[Any]:
        """[rounds without a change, basis]."""
        if self.k == 0:
            self._take(self.basis)
            self._improve(self._own)
        return [self.unchanged, self.basis]

    def update(self, heard: Mapping[int, Any]) -> None:
        """Take the others' bases; if x violates one of their rows, find the new optimum and its basis."""
        for j, (_, basis) in parts(self.i, self.k, heard, INTEGER, object).items():
            if getattr(basis, "ndim", 0) != 2 or basis.shape[1] != self.basis.shape[1]:
                allowed = f"(m, {self.basis.shape[1]}), as its own"
                raise ConfigError(
                    f"agent {self.i}: message of agent {j}",
                    f"a basis {np.shape(basis)}",
                    allowed,
                )
        changed = self._improve(
            np.vstack([self._own, *(basis for _, basis in heard.values())])
        )
        fewest = min([self.unchanged, *(int(count) for count, _ in heard.values())])
        self.unchanged = 0 if changed else fewest + 1

    def step(self, heard: Mapping[int, Any]) -> None:
        """A round; after the last, whether f itself is least at x."""
        super().step(heard)
        if self.done and self._flat:
            self._require_least()

    def _require_least(self) -> None:
        """Of f without the tie-break: -grad f(x) = A'u over the basis, with some u >= 0."""
        pull = self._q + self._P @ self.x - TIE * self.x
        rows = self.basis[:, :-1]
        # Each entry in its own unit: beside a large one a small one, of an x in small units, would not be seen.
        unit = np.abs(self._q) + np.abs(self._P) @ np.abs(self.x)
        unit = np.where(
            unit > 0.0, unit, np.maximum(np.abs(rows).max(axis=0, initial=0.0), CERTAIN)
        )
        pull = pull / unit
        missing = (
            nnls((rows / unit).T, -pull)[1]
            if len(rows)
            else float(np.linalg.norm(pull))
        )
        if missing > CERTAIN:
            k = int(np.argmax(np.abs(self.x)))
            found = f"x[{k}] = {self.x[k]:.6g} is held by the tie-break {TIE:g} |x|^2 / 2, not by constraints"
            do = "the optimum is farther away, or there is none; bound x, take larger units, or DualDistributedSimplex"
            raise SolverError(
                f"agent {self.i}: constraints consensus", f"{found}: {do}"
            )

    def _improve(self, rows: Mat) -> bool:
        """Take in what x violates of the rows until it violates nothing; whether it did."""
        steps = 0
        while len(worst := self._violated(rows)):
            steps += 1
            if steps > len(rows):
                found = f"{steps} steps without an optimum: rows that double precision cannot tell apart"
                do = "take units in which x is near 1, or use DualDistributedSimplex"
                raise SolverError(
                    f"agent {self.i}: constraints consensus", f"{found}; {do}"
                )
            self._take(np.vstack([self.basis, worst]))
        return steps > 0

    def _violated(self, rows: Mat) -> Mat:
        """The worst of the rows that x violates."""
        a = rows[:, :-1]
        b = rows[:, -1]
        terms = np.minimum(np.abs(a) @ np.abs(self.x), 1.0) + np.abs(b)
        excess = a @ self.x - b - TOLERANCE * terms - NEGLIGIBLE
        worst = np.argsort(-excess, kind="stable")[: BATCH * self.problem.n]
        return np.asarray(rows[worst[excess[worst] > 0.0]])

    def _take(self, rows: Mat) -> None:
        """The optimum over these rows, and its basis."""
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
        self.basis = rows[program.u > 0.0] if len(rows) else rows
        self.x = self._corner(found)

    def _corner(self, near: Vec) -> Vec:
        """x from its basis alone: P x + A'u + q = 0, A x = b; free of the rounding of a far start."""
        A = self.basis[:, :-1]
        b = self.basis[:, -1]
        if not len(b):
            return near
        zero = np.zeros((len(b), len(b)))
        both = np.linalg.solve(
            np.block([[self._P, A.T], [A, zero]]), np.concatenate([-self._q, b])
        )
        return np.ascontiguousarray(both[: self.problem.n])

    def _why(self, status: str, rows: Mat) -> str:
        """Of rows that exclude each other, the one that is missed when all together are missed by the least."""
        if status != "infeasible":
            return status
        m = len(rows)
        n = self.problem.n
        size = (
            float(np.abs(rows[:, -1]).max()) or 1.0
        )  # the tolerances of HiGHS are those of numbers near 1
        elastic = np.hstack([rows[:, :-1], -np.eye(m)]), rows[:, -1] / size
        bounds = np.r_[np.full(n, -np.inf), np.zeros(m)], np.full(n + m, np.inf)
        missed = LinearProgram(
            np.r_[np.zeros(n), np.ones(m)], elastic, bounds=bounds
        ).solve(np.zeros(n + m))
        if isinstance(missed, str):
            return status
        r = int(np.argmax(missed[n:]))
        row = " ".join(f"{a:+.4g} x[{k}]" for k, a in enumerate(rows[r, :-1]) if a)
        return f"infeasible: row {row} <= {rows[r, -1]:.4g}: violated by {size * missed[n + r]:.4g}, at best"


def _strictly_convex(problem: CommonCost) -> tuple[Mat, Vec, bool]:
    """P and q of f, with the tie-break where it needs one, and whether it does."""
    form = problem.cost
    try:
        return positive(form.P), form.q, False
    except np.linalg.LinAlgError:
        length = max(float(np.abs(form.P).max()), float(np.linalg.norm(form.q))) or 1.0
        return form.P / length + TIE * np.eye(problem.n), form.q / length, True


def _inequalities(problem: CommonCost) -> Mat:
    """X_i as rows [a', b]; an equality as two of them."""
    over = problem.polyhedron
    equal = np.column_stack([over.E, over.e])
    return np.vstack([np.column_stack([over.A, over.b]), equal, -equal])
