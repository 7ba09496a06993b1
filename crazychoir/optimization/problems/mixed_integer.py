"""One agent's part of a mixed-integer linear program with common resources, as plain arrays."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import highspy
import numpy as np

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.problems.linear import (
    HIGHS_STATUS_TEXTS,
    MOST_BRANCH_NODES,
    LinearProgram,
    Mask,
    demand_tolerance,
    make_quiet_highs,
)
from crazychoir.optimization.rounds.arrays import copy_matrix, copy_vector
from crazychoir.types import Mat, Vec

MILP_TOLERANCE = 1e-6
"""Tolerance of a solution of the team: a resource may be exceeded by this part of its largest number."""
LOCAL_TOLERANCE = 1e-9
"""Tolerance of one agent's solution, relative to 1 + |bound|: a thousand agents may add up theirs."""

BoxBounds = tuple[Vec, Vec]
"""(low, high), each (n,): bounds of x."""


class MixedIntegerBlock:
    """One agent's part of  min sum_i c_i'x_i  s.t.  sum_i A_i x_i <= sum_i b_i,  x_i in X_i.

        X_i = {x : D x <= d,  low <= x <= high,  x_k integer for k in `integer`},   bounded

    agent: id of the agent, for error messages
    c: (n,) costs c_i
    A: (S, n) use of S resources, A_i
    share: b_i (S,); with a common bound b, each of N agents may take b/N
    rows: (D (m, n), d (m,)), or None for no rows
    bounds: (low, high), each (n,) or a number
    integer: indices of the entries of x that are integers
    Raises ConfigError if an array is not finite or of a wrong shape.
    Raises SolverError when it solves a problem and X_i is empty or has no bound.
    Both errors name the agent, the row and the value.
    """

    def __init__(
        self,
        agent: int,
        c: Vec,
        A: Mat,
        share: Vec,
        *,
        rows: tuple[Mat, Vec] | None = None,
        bounds: tuple[Any, Any] = (0.0, np.inf),
        integer: Sequence[int] = (),
    ) -> None:
        self.agent = agent
        self.where = f"agent {agent}"
        self.c = copy_vector(c, self.where, "c")
        self.n = len(self.c)
        self.share = copy_vector(share, self.where, "share")
        self.S = len(self.share)
        if not self.S:
            do = "Without a common resource each agent solves its problem alone."
            raise ConfigError(
                f"{self.where}: share",
                "no rows",
                "one row or more, the same number at all agents",
                do,
            )
        self.A = copy_matrix(A, self.where, "A", (self.S, self.n))
        self.scale = find_scale(
            np.maximum(np.abs(self.A).max(axis=1, initial=0.0), np.abs(self.share))
        )
        D, d = (np.zeros((0, self.n)), np.zeros(0)) if rows is None else rows
        d = copy_vector(d, self.where, "d")
        self.rows = _scale_near_one(
            copy_matrix(D, self.where, "D", (len(d), self.n)), d
        )
        low = self._bound(bounds[0], "low")
        high = self._bound(bounds[1], "high")
        self.bounds = low, high
        crossed = np.flatnonzero(low > high)
        if len(crossed):
            k = int(crossed[0])
            raise ConfigError(
                f"{self.where}: low[{k}]", f"{low[k]}", f"at most high[{k}] = {high[k]}"
            )
        self.integer = self._mask(integer)

    def _bound(self, bound: Any, name: str) -> Vec:
        every = np.full(self.n, float(bound)) if np.ndim(bound) == 0 else bound
        return copy_vector(every, self.where, name, self.n, infinite=True)

    def _mask(self, integer: Sequence[int]) -> Mask:
        for k in integer:
            if not 0 <= k < self.n:
                raise ConfigError(
                    f"{self.where}: integer", k, f"indices 0 to {self.n - 1}"
                )
        mask = np.zeros(self.n, dtype=bool)
        mask[list(integer)] = True
        return mask

    @cached_property
    def _over(self) -> LinearProgram:
        program = LinearProgram(
            np.zeros(self.n), self.rows, bounds=self.bounds, integer=self.integer
        )
        program.demand(LOCAL_TOLERANCE)
        return program

    @cached_property
    def _boxed(self) -> LinearProgram:
        """The same program, for boxes within the bounds."""
        program = LinearProgram(
            np.zeros(self.n), self.rows, bounds=self.bounds, integer=self.integer
        )
        program.demand(LOCAL_TOLERANCE)
        return program

    def corner(self, cost: Vec) -> Vec:
        """Return argmin cost'x over X_i, (n,)."""
        return self._exact(self._require(self._over.solve(cost)))

    def least(self, cost: Vec, box: BoxBounds) -> tuple[Vec | None, float]:
        """Return argmin cost'x over the x of X_i in a box, and a proven lower bound of cost'x.

        Returns (None, inf) if no x of X_i is in the box.
        """
        if (box[0] > box[1]).any():
            return None, np.inf
        self._boxed.restrict(*box)
        found = self._boxed.solve(cost)
        if isinstance(found, str) and found == "infeasible":
            return None, np.inf
        return self._exact(self._require(found)), self._boxed.proven

    def box_of(self, x: Vec) -> BoxBounds:
        """Return the box of all x that have the integers of a given x."""
        low, high = self.bounds
        return np.where(self.integer, x, low), np.where(self.integer, x, high)

    def find_fraction(self, x: Vec) -> tuple[int, float]:
        """Return the integer variable that is farthest from an integer, and its distance.

        x: (n,) a mixture of points of X_i
        """
        distance = np.where(self.integer, np.abs(x - np.round(x)), 0.0)
        k = int(np.argmax(distance))
        return k, float(distance[k])

    def cut(self, box: BoxBounds, k: int, value: float) -> tuple[BoxBounds, BoxBounds]:
        """Return the parts of a box with x_k <= floor(value), and with x_k > floor(value)."""
        low, high = box
        most = high.copy()
        most[k] = np.floor(value)
        least = low.copy()
        least[k] = np.floor(value) + 1.0
        return (low, most), (least, high)

    @cached_property
    def _elastic(self) -> "_ElasticProgram":
        return _ElasticProgram(self)

    def within(self, y: Vec) -> tuple[Vec, Vec]:
        """Return (x, v): first the least sum of v >= 0 with A x <= y + v, then the least c'x.

        y: (S,)
        Returns x (n,) and v (S,).
        """
        x = self._exact(self._require(self._elastic.solve(y)))
        return x, np.maximum(self.A @ x - y, 0.0)

    def tightening(self) -> Vec:
        """Return the change (S,) of each resource use that may make x a point of X_i.

            min(U - L, r 1),   L, U = min, max of A x over X_i
            r = min r s.t. A x <= L + r 1, x in X_i, r >= 0

        Source: Camisa, Notarnicola & Notarstefano 2022, the restriction of the coupling
        constraints.
        """
        low = np.array([row @ self.corner(row) for row in self.A])
        high = np.array([row @ self.corner(-row) for row in self.A])
        D, d = self.rows
        left = np.vstack(
            [
                np.hstack([self.A, -np.ones((self.S, 1))]),
                np.hstack([D, np.zeros((len(d), 1))]),
            ]
        )
        bounds = np.append(self.bounds[0], 0.0), np.append(self.bounds[1], np.inf)
        c = np.append(np.zeros(self.n), 1.0)
        program = LinearProgram(
            c, (left, np.append(low, d)), None, bounds, np.append(self.integer, False)
        )
        return np.asarray(
            np.minimum(high - low, self._require(program.solve(np.zeros_like(c)))[-1])
        )

    def _exact(self, x: Vec) -> Vec:
        x[self.integer] = np.round(x[self.integer])
        return x

    def _require(self, found: Vec | str) -> Vec:
        if isinstance(found, str):
            raise SolverError(
                f"{self.where}: local problem", f"{found}: {self._why(found)}"
            )
        return found

    def _why(self, status: str) -> str:
        """Return a hint which part of the model to check."""
        low, high = self.bounds
        if status == "unbounded":
            free = np.flatnonzero(~np.isfinite(low) | ~np.isfinite(high))
            return f"x[{', '.join(map(str, free[:10]))}] without a bound; give low and high"
        return f"{len(self.rows[1])} rows D x <= d, low <= x <= high, {int(self.integer.sum())} integers"


def _scale_near_one(rows: Mat, bounds: Vec) -> tuple[Mat, Vec]:
    """Return the rows in units in which their largest entry is 1 to 2.

    The tolerances of HiGHS are absolute, so rows of other sizes would be judged wrongly.
    The factors are powers of two, so that nothing is rounded.
    """
    scale = find_scale(np.abs(rows).max(axis=1, initial=0.0))
    return rows * scale[:, None], bounds * scale


def find_scale(sizes: Vec) -> Vec:
    """Return powers of two, with which each size becomes 1 to 2; 1 where the size is 0.

    sizes: (m,), 0 or more
    """
    exponents = np.where(sizes > 0.0, 1 - np.frexp(sizes)[1], 0)
    return np.ldexp(np.ones(len(sizes)), exponents)


def require_block(block: Any, algorithm: str) -> None:
    """Raise ConfigError unless `block` is an agent's part of a mixed-integer program."""
    if not isinstance(block, MixedIntegerBlock):
        allowed = "a MixedIntegerBlock, such as a MixedIntegerConstraintCoupled"
        raise ConfigError(f"{algorithm}: block", type(block).__name__, allowed)


class _ElasticProgram:
    """min c'x over X with A x <= y + v, in the variables (x, v), for many y.

    Resources are in units in which their largest number is 1 to 2, like all rows.
    """

    def __init__(self, block: MixedIntegerBlock) -> None:
        n = block.n
        S = block.S
        D, d = block.rows
        self._n = n
        self._S = S
        self._index = np.arange(n + S, dtype=np.int32)
        self._zero = np.zeros(S)
        self._high = np.concatenate([block.bounds[1], np.zeros(S)])
        self._cost = np.concatenate([block.c, self._zero])
        self._short = np.concatenate([np.zeros(n), np.ones(S)])
        self._low = np.concatenate([block.bounds[0], np.zeros(S)])
        self._highs = make_quiet_highs()
        self._highs.addVars(n + S, self._low, self._high)
        self._scale = block.scale
        for s, row in enumerate(block.A * block.scale[:, None]):
            self._add(np.concatenate([row, -np.eye(S)[s]]), 0.0)
        for row, most in zip(D, d, strict=True):
            self._add(np.concatenate([row, self._zero]), most)
        kinds = np.zeros(n + S, np.uint8)
        kinds[:n][block.integer] = int(highspy.HighsVarType.kInteger)
        self._highs.changeColsIntegrality(n + S, self._index, kinds)
        self._highs.setOptionValue("mip_max_nodes", MOST_BRANCH_NODES)
        self._highs.setOptionValue("mip_rel_gap", 0.0)
        demand_tolerance(self._highs, LOCAL_TOLERANCE)

    def solve(self, y: Vec) -> Vec | str:
        """Return the x (n,) with the least sum of v, and then the least c'x.

        Returns the reason as a text if there is none.
        """
        most = y * self._scale
        for s in range(self._S):
            self._highs.changeRowBounds(s, -np.inf, float(most[s]))
        within = self._minimise(self._cost, self._zero)
        if not isinstance(within, str):
            return within[: self._n]
        missing = self._minimise(self._short, np.full(self._S, np.inf))
        if isinstance(missing, str):
            return missing
        found = self._minimise(
            self._cost,
            missing[self._n :] + 10.0 * LOCAL_TOLERANCE * (1.0 + np.abs(most)),
        )
        # Rounding may leave no x with exactly this v. Then the x that has it is taken.
        return (missing if isinstance(found, str) else found)[: self._n]

    def _minimise(self, cost: Vec, most: Vec) -> Vec | str:
        """Return the (x, v) of least cost.

        cost: (n + S,) of x and v
        most: (S,) upper bounds of v
        """
        self._high[self._n :] = most
        self._highs.changeColsBounds(
            len(self._index), self._index, self._low, self._high
        )
        self._highs.changeColsCost(len(self._index), self._index, cost)
        self._highs.run()
        status = self._highs.getModelStatus()
        if status != highspy.HighsModelStatus.kOptimal:
            return HIGHS_STATUS_TEXTS.get(status, str(status.name))
        return np.array(self._highs.getSolution().col_value)

    def _add(self, row: Vec, most: float) -> None:
        at = np.flatnonzero(row).astype(np.int32)
        self._highs.addRow(-np.inf, float(most), len(at), at, row[at])
