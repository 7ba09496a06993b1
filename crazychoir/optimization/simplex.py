"""Distributed simplex: agents exchange bases of a linear program until all hold the same optimal one."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.agreement import greatest, same_everywhere
from crazychoir.optimization.arrays import matrix, vector
from crazychoir.optimization.lexicographic import ZERO, Basis, Columns, optimal_basis, union
from crazychoir.optimization.program import Exchange, Program
from crazychoir.optimization.stillness import Stillness
from crazychoir.types import Mat, Vec

Status = Literal["optimal", "infeasible", "unbounded"]
ROUNDS = 10_000
FEASIBLE = 1e-7
"""What an artificial column may be worth at the end, relative to the right-hand side."""


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """The team's optimum, as one agent knows it.

    x: (n_i,) of the agent's own columns;  cost: of all agents;  prices: (m,), dual, of the rows;  ids: (m, 2) owner and
    number of the basic columns, the owner -1 is a row that others imply;  level: (m,) their values;  rounds: so far.
    """

    x: Vec
    cost: float
    prices: Vec
    ids: list[tuple[int, int]]
    level: Vec
    rounds: int


class BasisExchange:
    """One agent's part in finding the optimal basis of all columns; what DistributedSimplex and others are made of.

        B_i <- the lexicographically optimal basis of (own columns, B_i, B_j of the neighbours j that it hears)

    B_i starts as the identity, of artificial columns. The optimum only falls, and equal optima are the same basis, so
    that after finitely many rounds all bases are the one of all columns. A column that may grow for ever while the
    cost falls tells that there is no least cost; from then on c counts as 0 everywhere, and what is left to find out is
    whether there is a feasible point.
    entries: (m, n_i), c: (n_i,), b: (m,) the same at all.
    """

    def __init__(self, agent: int, c: Vec, entries: Mat, b: Vec, diameter: int) -> None:
        sign = np.where(b < 0, -1.0, 1.0)
        self._sign, self._b, self._agent = sign, b * sign, agent
        self._own = Columns.own(agent, c, entries * sign[:, None])
        self._stillness = Stillness(diameter)
        self._ray: list[int] | None = None
        start = Columns.artificial(len(b))
        self.basis = self._best([start, self._own], start)

    def message(self) -> list[Any]:
        """Whether all are still, the ray, the basis with its columns packed."""
        return [self._stillness.message(), self._ray, *_packed(self.basis.columns)]

    def step(self, heard: Mapping[int, Any]) -> None:
        """Take the neighbours' bases; None from who is not at this problem yet."""
        received = [self._unpacked(j, message) for j, message in heard.items() if message is not None]
        still = {j: b"" if message is None else message[0] for j, message in heard.items()}
        heard = {j: message for j, message in heard.items() if message is not None}
        before, ray = self.basis.columns.ids, self._ray
        self._ray = min((r for r in [ray, *(m[1] for m in heard.values())] if r is not None), default=None)
        columns = self.basis.columns
        self.basis = self._best([columns, self._own, *received], columns)
        changed = self._ray != ray or not np.array_equal(before, self.basis.columns.ids)
        self._stillness.step(changed, still)

    def _unpacked(self, j: int, message: Any) -> Columns:
        try:
            still, ray, *packed = message
            if not (isinstance(still, bytes) and isinstance(ray, list | None)):
                raise TypeError(f"{type(still).__name__} and {type(ray).__name__} before it")
            return _unpacked(packed, len(self._b))
        except (TypeError, ValueError, LookupError) as error:
            allowed = f"flags, a ray, and {len(self._b)} columns: ids, costs, entries"
            where = f"agent {self._agent}: message of agent {j}"
            raise ConfigError(where, "no basis", allowed, "", str(error)) from error

    def _best(self, parts: list[Columns], start: Columns) -> Basis:
        if self._ray is None:
            basis = optimal_basis(union(parts), start, self._b)
            if basis.ray is None:
                return basis
            self._ray = list(basis.ray)
        return optimal_basis(union(parts).free(), start.free(), self._b)

    @property
    def settled(self) -> bool:
        """Whether all agents hold the same basis, and all know it: in the same round."""
        return self._stillness.reached

    @property
    def status(self) -> Status:
        """What the basis says, once settled; an infeasible program may be unbounded too."""
        if self.violation.max(initial=0.0) > FEASIBLE * (1.0 + np.abs(self._b).max(initial=0.0)):
            return "infeasible"
        return "optimal" if self._ray is None else "unbounded"

    @property
    def ray(self) -> list[int] | None:
        """Owner and number of a column that may grow for ever: once settled, the same at all."""
        return self._ray

    @property
    def violation(self) -> Vec:
        """(m,) what remains of each row: the artificial columns."""
        ids = self.basis.columns.ids
        left = np.zeros(len(self._b))
        artificial = ids[:, 0] < 0
        left[ids[artificial, 1]] = self.basis.level[artificial]
        return left

    @property
    def certificate(self) -> Vec:
        """(m,) y with y'A <= 0 for all columns and y'b = the sum of what remains: why a program is infeasible."""
        return np.asarray(self.basis.prices[0] * self._sign)

    @property
    def x(self) -> Vec:
        """(n_i,) of the own columns."""
        ids = self.basis.columns.ids
        mine = ids[:, 0] == self._agent
        x = np.zeros(len(self._own))
        x[ids[mine, 1]] = self.basis.level[mine]
        return x

    @property
    def cost(self) -> float:
        """c'x of all agents."""
        return float(self.basis.columns.cost[1] @ self.basis.level)

    @property
    def has_artificial(self) -> bool:
        """Whether a row is implied by others, so that prices of two levels must be added up."""
        return bool((self.basis.columns.ids[:, 0] < 0).any())

    def penalty(self) -> float:
        """The least M for which no own column has a negative reduced cost at the prices y1 + M y0."""
        reduced = self._own.cost - self.basis.prices @ self._own.entries
        short = (reduced[0] > ZERO) & (reduced[1] < 0.0)
        return float((-reduced[1, short] / reduced[0, short]).max(initial=0.0))

    def prices(self, penalty: float) -> Vec:
        """(m,) y1 + penalty y0."""
        return np.asarray((self.basis.prices[1] + penalty * self.basis.prices[0]) * self._sign)


def _exchange(bases: BasisExchange, where: str, diameter: int) -> Exchange[float]:
    """Rounds until all hold the same basis; then the least M that makes its prices dual feasible, the same at all."""
    rounds = 0
    while not bases.settled:
        if rounds == ROUNDS:
            raise SolverError(where, f"no common basis after {ROUNDS} rounds; is {diameter} the diameter of the graph?")
        bases.step((yield bases.message()))
        rounds += 1
    if bases.status != "optimal" or not bases.has_artificial:
        return 0.0
    return float((yield from greatest(np.array([bases.penalty()]), diameter))[0])


class DistributedSimplex(Program[LinearSolution]):
    """A standard-form linear program whose columns are split over the agents.

        min  sum_i c_i'x_i   s.t.  sum_i A_i x_i = b,  x_i >= 0

    Every round an agent sends its basis, m columns, to its neighbours, and keeps the lexicographically optimal basis
    of what it has and hears; there is no step size. It ends, in the same round at all, when nobody has changed for
    2 D + 1 rounds.
    c: (n_i,), A: (m, n_i), own columns, n_i may be 0;  b: (m,), the same at all;  diameter: D, rounds in which a
    message of each agent reaches all: of a (directed) graph its diameter, of a graph sequence the longest such time.
    Raises ConfigError for data that do not fit, and SolverError, in the last round at every agent: infeasible, with
    the rows that remain; unbounded, with a column that may grow for ever.
    Source: Buerger, Notarstefano, Bullo & Allgoewer 2012, Automatica 48, 2298-2304.
    """

    heavy = True
    connected = True
    common = False

    def __init__(self, agent: int, c: Vec, A: Mat, b: Vec, diameter: int) -> None:
        where = f"agent {agent}: distributed simplex"
        b = vector(b, where, "b")
        if not len(b):
            do = "Without rows each column is 0, or grows for ever, whatever the others do."
            raise ConfigError(f"{where}: b", "no rows", "one row or more, the same at all agents", do)
        self._where, self._b, self._agent, self.diameter = where, b, agent, diameter
        c = vector(c, where, "c")
        self._bases = BasisExchange(agent, c, matrix(A, where, "A", (len(b), len(c))), b, diameter)
        super().__init__()

    @property
    def cost(self) -> float:
        """c'x at the agent's present basis; artificial columns cost nothing."""
        return self._bases.cost

    @property
    def x(self) -> Vec:
        """(n_i,) of the own columns at the present basis."""
        return self._bases.x

    def run(self) -> Exchange[LinearSolution]:
        """Compare b, exchange bases, end together."""
        yield from same_everywhere(self._b.tolist(), self._where, "b")
        bases = self._bases
        penalty = yield from _exchange(bases, self._where, self.diameter)
        if bases.status == "infeasible":
            raise SolverError(self._where, f"infeasible: {_remaining(bases.violation)}")
        if bases.ray is not None:
            owner, column = bases.ray
            raise SolverError(self._where, f"unbounded: column {column} of agent {owner} may grow for ever")
        columns = bases.basis.columns
        ids = [(int(owner), int(number)) for owner, number in columns.ids]
        return LinearSolution(bases.x, bases.cost, bases.prices(penalty), ids, bases.basis.level, self.k)


@dataclass(frozen=True, eq=False)
class CommonSolution:
    """The common optimum. x: (d,);  cost: c'x;  active: agent and row of constraints that hold it there;  rounds."""

    x: Vec
    cost: float
    active: list[tuple[int, int]]
    rounds: int


class DualDistributedSimplex(Program[CommonSolution]):
    """A linear program with common variables, whose constraints are split over the agents.

        max  c'x   s.t.  A_i x <= b_i  for all i            by its dual, a DistributedSimplex:
        min  sum_i b_i'l_i   s.t.  sum_i A_i'l_i = c,  l_i >= 0

    x are the prices of the dual's rows at the common basis, the same at all agents.
    c: (d,), the same at all;  A: (n_i, d), b: (n_i,), own constraints, n_i may be 0;  diameter: D, as there.
    Raises ConfigError for data that do not fit, and SolverError, in the last round at every agent: infeasible, with a
    constraint that contradicts others; unbounded, with the variables that no constraint holds.
    Source: Buerger, Notarstefano, Bullo & Allgoewer 2012, Automatica 48, 2298-2304, section on duality.
    """

    heavy = True
    connected = True

    def __init__(self, agent: int, c: Vec, A: Mat, b: Vec, diameter: int) -> None:
        where = f"agent {agent}: dual distributed simplex"
        self._c, b = vector(c, where, "c"), vector(b, where, "b")
        if not len(self._c):
            raise ConfigError(f"{where}: c", "no variables", "one variable or more, the same at all agents")
        rows = matrix(A, where, "A", (len(b), len(self._c)))
        self._where, self.diameter = where, diameter
        self._bases = BasisExchange(agent, b, rows.T, self._c, diameter)
        super().__init__()

    @property
    def x(self) -> Vec:
        """(d,) the prices at the present basis."""
        return self._bases.prices(0.0)

    def run(self) -> Exchange[CommonSolution]:
        """Compare c, exchange bases, end together."""
        yield from same_everywhere(self._c.tolist(), self._where, "c")
        bases = self._bases
        penalty = yield from _exchange(bases, self._where, self.diameter)
        if bases.ray is not None:
            owner, row = bases.ray
            raise SolverError(self._where, f"infeasible: constraint {row} of agent {owner} contradicts others")
        if bases.status == "infeasible":
            raise SolverError(self._where, f"unbounded: {_remaining(bases.violation, 'variable')} without a limit")
        x = bases.prices(penalty)
        active = [(int(owner), int(row)) for owner, row in bases.basis.columns.ids if owner >= 0]
        return CommonSolution(x, float(self._c @ x), active, self.k)


def _remaining(violation: Vec, what: str = "row") -> str:
    """The rows that are not met, with by how much."""
    rows = np.flatnonzero(violation > ZERO)
    return ", ".join(f"{what} {r} ({violation[r]:.6g} left)" for r in rows[:10])


def _packed(columns: Columns) -> list[Any]:
    """Owners and numbers, c, and the entries that are not zero: how many a column, their rows, their values."""
    number, row = np.nonzero(columns.entries.T)
    counts = np.bincount(number, minlength=len(columns))
    ids = columns.ids.astype(np.int32).ravel()
    return [ids, columns.cost[1], counts.astype(np.int32), row.astype(np.int32), columns.entries[row, number]]


def _unpacked(packed: list[Any], m: int) -> Columns:
    """Columns of m rows; raises ValueError, IndexError, TypeError for what is none."""
    ids, c, counts, row, value = (np.asarray(part) for part in packed)
    if len(c) != m or min(row, default=0) < 0 or not (np.isfinite(c).all() and np.isfinite(value).all()):
        raise ValueError(f"{len(c)} columns for {m} rows, or not finite")
    ids = ids.astype(np.int64).reshape(-1, 2)
    entries = np.zeros((m, len(ids)))
    entries[row, np.repeat(np.arange(len(ids)), counts)] = value
    return Columns(ids, np.vstack([ids[:, 0] < 0, c]), entries)
