"""Distributed simplex: agents exchange bases until all hold the same optimum."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.problems.basis_pricing import BasisPricing
from crazychoir.optimization.problems.equilibration import ROUNDING_DECIDES_TEXT
from crazychoir.optimization.problems.lexicographic import (
    FEASIBILITY_TOLERANCE,
    OptimalBasis,
    ProgramColumns,
    find_optimal_basis,
    unite_columns,
)
from crazychoir.optimization.rounds.agreement import (
    find_greatest,
    require_same_everywhere,
)
from crazychoir.optimization.rounds.arrays import copy_matrix, copy_vector
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.optimization.rounds.stillness import Stillness
from crazychoir.types import Mat, Vec

Status = Literal["optimal", "infeasible", "unbounded"]
"""Result of a linear program."""
MOST_EXCHANGE_ROUNDS = 10_000
LARGEST_NUMBER = 1e60
"""Numbers beyond this, or nearer to 0 than its inverse: their products leave the range of double precision."""


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """The optimum of the team, as one agent knows it."""

    x: Vec
    """(n_i,) of the agent's own columns."""
    cost: float
    """Cost of all agents."""
    prices: Vec
    """(m,) dual prices of the rows."""
    ids: list[tuple[int, int]]
    """(m, 2) owner and number of the basic columns. Owner -1 is a row that other rows imply."""
    level: Vec
    """(m,) values of the basic columns."""
    rounds: int
    """Number of rounds so far."""


class BasisExchange:
    """One agent's part in finding the optimal basis of all columns.

    DistributedSimplex and other algorithms are built on it.

    The basis B_i of an agent starts as the identity, of artificial columns. Its cost never rises, and
    bases with equal (lexicographic) cost are equal. Therefore, after finitely many rounds, all agents
    hold the optimal basis of all columns.
    A column that may grow for ever while the cost falls shows that the program is unbounded. From then
    on all agents set c to 0, to find out whether there is a feasible point.
    If two numbers are so close that rounding decides, agents may prefer different bases. If a basis
    returns, or neighbours still hold different bases long after the last change, all agents stop
    pivoting. They keep the least basis that they hear of, in an order that depends only on the bases
    (_rank).
    A failure at one agent (a singular basis, pivots without an end) spreads in the same way, and all
    agents raise it.
    Numbers are sent unchanged, and what an agent computes from a basis depends only on the basis.
    Therefore all agents have the same numbers bit by bit, in any units of rows and columns.

    agent: id of this agent
    c: (n_i,), costs of its columns
    entries: (m, n_i), its columns
    b: (m,), the same at all agents
    diameter: D, rounds until a message of any agent has reached all
    first: (n_i,) >= 0, a cost that comes before c, or None
    common: columns that all agents know from the start, own ones included; needs b >= 0
    """

    def __init__(
        self,
        agent: int,
        c: Vec,
        entries: Mat,
        b: Vec,
        diameter: int,
        first: Vec | None = None,
        common: ProgramColumns | None = None,
    ) -> None:
        sign = np.where(b < 0, -1.0, 1.0)
        self._sign = sign
        self._b = b * sign
        self._agent = agent
        own = ProgramColumns.own(agent, c, entries * sign[:, None], first)
        self._n = len(own)
        self._own = own if common is None else unite_columns([own, common])
        self._stillness = Stillness(diameter)
        self._ray: list[int] | None = None
        self._weighed: set[tuple[int, int]] = set()
        self._held: set[bytes] = set()
        self._patience = 3 * diameter + 3
        self._calm = 0
        self.undecided = False
        self.failure: str | None = None
        identity = ProgramColumns.artificial(len(b))
        self.basis = OptimalBasis.of(identity, self._b)
        self._improve([identity, self._own])
        self._held.add(self._fingerprint)

    def message(self) -> list[Any]:
        """Return whether all are still, the ray, whether bases are undecided, the failure, the columns of the basis."""
        flags = [self._stillness.message(), self._ray, self.undecided, self.failure]
        return [*flags, *_pack_columns(self.basis.columns)]

    def step(self, heard: Mapping[int, Any]) -> None:
        """Take the neighbours' bases; None from a neighbour that is not at this problem yet."""
        messages = {j: message for j, message in heard.items() if message is not None}
        received = [self._unpacked(j, message) for j, message in messages.items()]
        still = {
            j: b"" if message is None else message[0] for j, message in heard.items()
        }
        before = self._state
        self._take_flags(list(messages.values()))
        if self.failure is None:
            if self.undecided:
                self._keep_the_least(received)
            else:
                self._weigh(received, is_new_ray=self._ray != before[1])
        is_changed = self._state != before
        self._calm = 0 if is_changed else self._calm + 1
        is_common = all(
            np.array_equal(columns.ids, self.basis.columns.ids) for columns in received
        )
        if self.failure is None and not is_common:
            is_changed = True
            self.undecided |= self._calm > self._patience
        self._stillness.step(is_changed, still)

    @property
    def _state(self) -> tuple[Any, ...]:
        """What the neighbours must know before the team may end."""
        return self._fingerprint, self._ray, self.undecided, self.failure

    @property
    def _fingerprint(self) -> bytes:
        """The basis, and whether c counts."""
        return self.basis.columns.ids.tobytes() + bytes([self._ray is None])

    def _take_flags(self, messages: list[Any]) -> None:
        """Take the least of the known rays, and the least of the known failures."""
        rays = [self._ray, *(message[1] for message in messages)]
        self._ray = min((ray for ray in rays if ray is not None), default=None)
        self.undecided |= any(message[2] for message in messages)
        failures = [self.failure, *(message[3] for message in messages)]
        self.failure = min(
            (text for text in failures if text is not None), default=None
        )

    def _weigh(self, received: list[ProgramColumns], is_new_ray: bool) -> None:
        """Find the best basis of own and received columns, unless all have been weighed before."""
        before = self._fingerprint
        news = {key for columns in received for key in columns.id_pairs()}
        if is_new_ray or not news <= self._weighed:
            self._improve([self.basis.columns, self._own, *received])
        # The basis is the best of these columns: of any part of them too, so that they need not be weighed again.
        if is_new_ray or self._fingerprint != before:
            self._weighed = news
            # The optimum only falls, so that a basis comes back only where rounding hides which is better.
            self.undecided |= self._fingerprint in self._held
            self._held.add(self._fingerprint)
        else:
            self._weighed |= news

    def _improve(self, parts: list[ProgramColumns]) -> None:
        """Find the best basis, or keep the failure."""
        try:
            self.basis = self._best(parts, self.basis)
        except SolverError as error:
            self.failure = error.status

    def _keep_the_least(self, received: list[ProgramColumns]) -> None:
        """Keep the least of own and received bases."""
        try:
            others = [
                OptimalBasis.of(columns, self._b)
                for columns in received
                if not np.array_equal(columns.ids, self.basis.columns.ids)
            ]
        except SolverError as error:
            self.failure = error.status
            return
        self.basis = min([self.basis, *others], key=self._rank)

    def _rank(self, basis: OptimalBasis) -> tuple[Any, ...]:
        """Return the place of a basis in an order of all agents: certain, feasible, cheap ones first."""
        cost = float(basis.columns.cost[1] @ basis.level) if self._ray is None else 0.0
        is_doubtful = basis.doubt is not None
        return (
            is_doubtful,
            len(basis.unmet),
            cost,
            basis.columns.ids.tolist(),
        )

    def _unpacked(self, j: int, message: Any) -> ProgramColumns:
        try:
            still, ray, undecided, failure, *packed = message
            flags = [still, ray, undecided, failure]
            kinds = [bytes, list | None, bool, str | None]
            if not all(map(isinstance, flags, kinds)):
                found = ", ".join(type(flag).__name__ for flag in flags)
                raise TypeError(f"{found} before it")
            return _unpack_columns(packed, len(self._b))
        except (TypeError, ValueError, LookupError) as error:
            allowed = f"flags, a ray, and {len(self._b)} columns: ids, costs, entries"
            where = f"agent {self._agent}: message of agent {j}"
            raise ConfigError(where, "no basis", allowed, "", str(error)) from error

    def _best(self, parts: list[ProgramColumns], start: OptimalBasis) -> OptimalBasis:
        if self._ray is None:
            basis = find_optimal_basis(unite_columns(parts), start, self._b)
            if basis.ray is None:
                return basis
            self._ray = list(basis.ray)
        return find_optimal_basis(unite_columns(parts).free(), start, self._b)

    @property
    def settled(self) -> bool:
        """True if all agents hold the same basis and know it; true in the same round at all."""
        return self._stillness.reached

    @property
    def status(self) -> Status:
        """The result, once settled. An infeasible program may be unbounded as well."""
        if self.unmet:
            return "infeasible"
        return "optimal" if self._ray is None else "unbounded"

    @property
    def ray(self) -> list[int] | None:
        """Owner and number of a column that may grow for ever, or None.

        Once settled, it is the same at all agents.
        """
        return self._ray

    @property
    def violation(self) -> Vec:
        """(m,) what remains of each row: the values of the artificial columns."""
        ids = self.basis.columns.ids
        left = np.zeros(len(self._b))
        artificial = ids[:, 0] < 0
        left[ids[artificial, 1]] = self.basis.level[artificial]
        return left

    @property
    def unmet(self) -> list[int]:
        """Return the rows with a residual too large for errors of FEASIBILITY_TOLERANCE in right-hand sides."""
        return self.basis.unmet

    @property
    def certificate(self) -> Vec:
        """(m,) y, the prices of the first cost.

        If no other row holds an artificial column, y'A <= 0 for all columns with first cost 0, and
        y'b is the sum of what remains. This proves that the remaining rows cannot be met.
        """
        return np.asarray(self.basis.prices[0] * self._sign)

    @property
    def x(self) -> Vec:
        """(n_i,) values of the own columns."""
        ids = self.basis.columns.ids
        mine = ids[:, 0] == self._agent
        x = np.zeros(self._n)
        x[ids[mine, 1]] = self.basis.level[mine]
        return x

    @property
    def cost(self) -> float:
        """c'x of all agents."""
        return float(self.basis.columns.cost[1] @ self.basis.level)

    def pricing(self) -> BasisPricing:
        """Return the prices of the present basis, and how the own columns judge them."""
        return BasisPricing(self.basis, self._own, self._sign, self._ray is None)


def _exchange_bases(bases: BasisExchange, where: str, diameter: int) -> Exchange[Vec]:
    """Exchange bases until all agents hold the same basis.

    Returns the penalties that make its prices dual feasible.
    """
    rounds = 0
    while not bases.settled:
        if rounds == MOST_EXCHANGE_ROUNDS:
            raise SolverError(
                where,
                f"no common basis after {MOST_EXCHANGE_ROUNDS} rounds; is {diameter} the diameter of the graph?",
            )
        bases.step((yield bases.message()))
        rounds += 1
    pricing = bases.pricing()
    problem = bases.failure or bases.basis.doubt
    if problem is not None:
        raise SolverError(where, problem)
    if bases.undecided and bases.unmet:
        found = f"agents find different bases, and row {bases.unmet[0]} is not met"
        raise SolverError(where, f"{found}: {ROUNDING_DECIDES_TEXT}")
    if bases.undecided:
        excess = yield from find_greatest(np.array([pricing.excess()]), diameter)
        if excess[0] > FEASIBILITY_TOLERANCE:
            found = f"agents find different bases, and a column would lower the cost by {excess[0]:.1g} of its terms"
            raise SolverError(where, f"{found}: {ROUNDING_DECIDES_TEXT}")
    M = np.zeros(pricing.left_over)
    for _ in range(len(M)):
        before = M
        agreed = yield from find_greatest(
            np.concatenate([pricing.penalties(before), pricing.doubts()]), diameter
        )
        M, doubts = np.split(agreed, 2)
        pricing.require_distinct(doubts, where)
        if np.array_equal(M, before) or bases.status != "optimal":
            break
    return M


class DistributedSimplex(Program[LinearSolution]):
    """A standard-form linear program with its columns split over the agents.

        min  sum_i c_i'x_i   s.t.  sum_i A_i x_i = b,  x_i >= 0

    In each round an agent sends its basis, m columns, to its neighbours. It keeps the lexicographically
    optimal basis of three sets of columns: its own, its basis, and the bases that it receives.
    There is no step size. All agents end in the same round, after no agent has changed its basis
    for 2 D + 1 rounds.

    agent: id of this agent
    c: (n_i,), costs of its columns; n_i may be 0
    A: (m, n_i), its columns
    b: (m,), the same at all agents
    diameter: D, rounds until a message of any agent has reached all: the diameter of a (directed)
        graph, or the longest such time in a graph sequence
    Raises ConfigError for data that do not fit.
    Raises SolverError at every agent, in the last round: infeasible, with the rows that remain;
    unbounded, with a column that may grow for ever; or undecidable in double precision.

    Rows and columns may have any units, because each number is compared only with its own terms. A
    row that equals a sum of others up to 1e-9 of its terms counts as this sum, so data may be
    rounded. All agents refuse a basis that is singular up to LEAST_DISTINCTNESS (1e-6) of its terms.
    Source: Buerger, Notarstefano, Bullo & Allgoewer 2012, Automatica 48, 2298-2304.
    """

    heavy = True
    connected = True
    common = False

    def __init__(self, agent: int, c: Vec, A: Mat, b: Vec, diameter: int) -> None:
        where = f"agent {agent}: distributed simplex"
        b = copy_vector(b, where, "b")
        if not len(b):
            do = "Without rows each column is 0, or grows for ever, whatever the others do."
            raise ConfigError(
                f"{where}: b", "no rows", "one row or more, the same at all agents", do
            )
        self._where = where
        self._b = b
        self._agent = agent
        self.diameter = diameter
        c = copy_vector(c, where, "c")
        A = copy_matrix(A, where, "A", (len(b), len(c)))
        _require_range(where, c=c, A=A, b=b)
        self._bases = BasisExchange(agent, c, A, b, diameter)
        super().__init__()

    @property
    def cost(self) -> float:
        """c'x at the agent's present basis; artificial columns cost nothing."""
        return self._bases.cost

    @property
    def x(self) -> Vec:
        """(n_i,) values of the own columns at the present basis."""
        return self._bases.x

    def run(self) -> Exchange[LinearSolution]:
        """Compare b, exchange bases, end together."""
        yield from require_same_everywhere(self._b.tolist(), self._where, "b")
        bases = self._bases
        penalties = yield from _exchange_bases(bases, self._where, self.diameter)
        if bases.status == "infeasible":
            raise SolverError(self._where, f"infeasible: {_describe_remainder(bases)}")
        if bases.ray is not None:
            owner, column = bases.ray
            raise SolverError(
                self._where,
                f"unbounded: column {column} of agent {owner} may grow for ever",
            )
        columns = bases.basis.columns
        ids = [(int(owner), int(number)) for owner, number in columns.ids]
        return LinearSolution(
            bases.x,
            bases.cost,
            bases.pricing().prices(penalties),
            ids,
            bases.basis.level,
            self.k,
        )


@dataclass(frozen=True, eq=False)
class CommonSolution:
    """The optimum of a program with common variables."""

    x: Vec
    """(d,) the optimum."""
    cost: float
    """c'x."""
    active: list[tuple[int, int]]
    """Agent and row of the constraints that hold x at the optimum."""
    rounds: int
    """Number of rounds."""


class DualDistributedSimplex(Program[CommonSolution]):
    """A linear program in common variables, with its constraints split over the agents.

        max  c'x   s.t.  A_i x <= b_i  for all i            by its dual, a DistributedSimplex:
        min  sum_i b_i'l_i   s.t.  sum_i A_i'l_i = c,  l_i >= 0

    x are the prices of the rows of the dual at the common basis, the same at all agents.
    Constraints and variables may have any units.

    agent: id of the agent
    c: (d,) objective, the same at all agents
    A: (n_i, d) own constraints; n_i may be 0
    b: (n_i,) bounds of the own constraints
    diameter: D, see DistributedSimplex
    Raises ConfigError for data that do not fit.
    Raises SolverError, in the last round at every agent, if the program is infeasible (with a
    constraint that contradicts others), unbounded (with the variables that no constraint holds), or
    beyond double precision.
    Source: Buerger, Notarstefano, Bullo & Allgoewer 2012, Automatica 48, 2298-2304, section on
    duality.
    """

    heavy = True
    connected = True

    def __init__(self, agent: int, c: Vec, A: Mat, b: Vec, diameter: int) -> None:
        where = f"agent {agent}: dual distributed simplex"
        self._c, b = copy_vector(c, where, "c"), copy_vector(b, where, "b")
        if not len(self._c):
            raise ConfigError(
                f"{where}: c",
                "no variables",
                "one variable or more, the same at all agents",
            )
        rows = copy_matrix(A, where, "A", (len(b), len(self._c)))
        _require_range(where, c=self._c, A=rows, b=b)
        self._where = where
        self.diameter = diameter
        self._bases = BasisExchange(agent, b, rows.T, self._c, diameter)
        super().__init__()

    @property
    def x(self) -> Vec:
        """(d,) the prices at the present basis; they meet the own constraints if any prices do."""
        return self.result.x if self.done else self._bases.pricing().own_prices()

    def run(self) -> Exchange[CommonSolution]:
        """Compare c, exchange bases, end together."""
        yield from require_same_everywhere(self._c.tolist(), self._where, "c")
        bases = self._bases
        penalties = yield from _exchange_bases(bases, self._where, self.diameter)
        if bases.ray is not None:
            owner, row = bases.ray
            raise SolverError(
                self._where,
                f"infeasible: constraint {row} of agent {owner} contradicts others",
            )
        if bases.status == "infeasible":
            raise SolverError(
                self._where,
                f"unbounded: {_describe_remainder(bases, 'variable')} without a limit",
            )
        x = bases.pricing().prices(penalties)
        active = [
            (int(owner), int(row))
            for owner, row in bases.basis.columns.ids
            if owner >= 0
        ]
        return CommonSolution(x, float(self._c @ x), active, self.k)


def _require_range(where: str, **arrays: npt.NDArray[np.float64]) -> None:
    """Raise ConfigError for the first number that is too large or too small.

    Products of such numbers may overflow or vanish.
    """
    for name, array in arrays.items():
        size = np.abs(array)
        beyond = np.argwhere(
            (size > LARGEST_NUMBER) | ((size > 0.0) & (size < 1.0 / LARGEST_NUMBER))
        )
        if len(beyond):
            place = tuple(int(k) for k in beyond[0])
            allowed = (
                f"0, or a size from {1.0 / LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}"
            )
            do = "Take other units."
            raise ConfigError(
                f"{where}: {name}[{', '.join(map(str, place))}]",
                f"{array[place]:g}",
                allowed,
                do,
            )


def _describe_remainder(bases: BasisExchange, what: str = "row") -> str:
    """Return a text with the rows that are not met, and how much remains of each."""
    violation = bases.violation
    return ", ".join(f"{what} {r} ({violation[r]:.6g} left)" for r in bases.unmet[:10])


def _pack_columns(columns: ProgramColumns) -> list[Any]:
    """Return the columns as a list for a message.

    It contains the ids, c, the entries that are not zero, and a, which is empty if it is zero. The
    entries are three arrays: their number in each column, their rows, and their values.
    """
    number, row = np.nonzero(columns.entries.T)
    counts = np.bincount(number, minlength=len(columns))
    ids = columns.ids.astype(np.int32).ravel()
    first = np.where(columns.ids[:, 0] < 0, 0.0, columns.cost[0])
    first = first if first.any() else first[:0]
    entries = [
        counts.astype(np.int32),
        row.astype(np.int32),
        columns.entries[row, number],
    ]
    return [ids, columns.cost[1], *entries, first]


def _unpack_columns(packed: list[Any], m: int) -> ProgramColumns:
    """Return the columns of a message, with m rows.

    Raises ValueError, IndexError or TypeError if the message does not contain such columns.
    """
    ids, c, counts, row, value, first = (np.asarray(part) for part in packed)
    numbers = np.concatenate([c, value, first])
    if (
        len(c) != m
        or min(row, default=0) < 0
        or not np.isfinite(numbers).all()
        or len(first) not in (0, m)
    ):
        raise ValueError(f"{len(c)} columns for {m} rows, or not finite")
    ids = ids.astype(np.int64).reshape(-1, 2)
    entries = np.zeros((m, len(ids)))
    entries[row, np.repeat(np.arange(len(ids)), counts)] = value
    before = np.where(ids[:, 0] < 0, 1.0, first if len(first) else 0.0)
    return ProgramColumns(ids, np.vstack([before, c]), entries)
