"""Random problems of a team, repeatable by their seed.

The solution is included if it is known by construction.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, eq=False)
class Quadratics:
    """The costs f_i(x) = 1/2 x'P_i x + q_i'x of a team."""

    p: Mat
    """(N, n, n) P_i, positive definite."""
    q: Mat
    """(N, n) q_i."""

    @property
    def optimum(self) -> Vec:
        """(n,) argmin sum_i f_i(x)."""
        return -np.linalg.solve(self.p.sum(axis=0), self.q.sum(axis=0))

    @property
    def smoothness(self) -> float:
        """L, the greatest Lipschitz constant of the gradients."""
        return float(np.linalg.eigvalsh(self.p).max())

    def cost(self, x: Vec) -> float:
        """Return sum_i f_i(x)."""
        return float(0.5 * x @ self.p.sum(axis=0) @ x + self.q.sum(axis=0) @ x)

    def gradient(self, i: int) -> Callable[[Vec], Vec]:
        """Return the gradient of f_i as a function."""
        return lambda x: self.p[i] @ x + self.q[i]


def random_quadratics(agents: int, n: int, seed: int = 0) -> Quadratics:
    """Return quadratic costs of N agents in n variables.

    P_i = R R' + I/2, where the entries of R and q_i/2 are standard normal.
    """
    chance = _make_generator(seed, agents=agents, n=n)
    roots = chance.normal(size=(agents, n, n))
    return Quadratics(
        roots @ roots.transpose(0, 2, 1) + 0.5 * np.eye(n),
        2.0 * chance.normal(size=(agents, n)),
    )


@dataclass(frozen=True, eq=False)
class RandomLinearProgram:
    """A linear program with its unique solution.

    Inequality form: min c'x subject to A x <= b. Standard form: min c'x subject to A x = b, x >= 0.
    """

    c: Vec
    """(n,) costs."""
    a: Mat
    """(m, n) A."""
    b: Vec
    """(m,) right-hand side."""
    x: Vec
    """(n,) the solution."""
    dual: Vec
    """(m,) multipliers of the solution.

    Inequality form: c + A'dual = 0 with dual >= 0. Standard form: A'dual <= c.
    """
    parts: dict[int, tuple[int, ...]]
    """Rows of A of each agent; in standard form columns of A."""

    @property
    def cost(self) -> float:
        """Cost of the solution."""
        return float(self.c @ self.x)


def random_lp(
    agents: int, n: int, constraints: int, seed: int = 0
) -> RandomLinearProgram:
    """Return a bounded and feasible program  min c'x, a_r'x <= b_r.

    The solution x* is drawn first. At x*, n random rows are active and have multipliers above 0,
    which define c. So x* meets the conditions of Karush, Kuhn and Tucker. The other rows have
    slack.
    The rows are dealt out to the agents in turn.

    constraints: n or more
    """
    chance = _make_generator(seed, agents=agents, n=n)
    if constraints < n:
        raise ConfigError(
            "random LP: constraints", constraints, f"{n} or more, as many as variables"
        )
    a = chance.normal(size=(constraints, n))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    x = chance.normal(size=n)
    dual = np.zeros(constraints)
    slack = chance.uniform(0.2, 2.0, constraints)
    active = chance.permutation(constraints)[:n]
    dual[active] = chance.uniform(0.5, 1.5, n)
    slack[active] = 0.0
    return RandomLinearProgram(
        -a.T @ dual, a, a @ x + slack, x, dual, _deal_items(agents, constraints)
    )


def random_standard_lp(
    agents: int, columns: int, constraints: int, seed: int = 0
) -> RandomLinearProgram:
    """Return a bounded and feasible program  min c'x, A x = b, x >= 0.

    A random basis, its x and the multipliers y are drawn first. Then c = A'y + s, with s above 0
    outside the basis. The columns are dealt out to the agents in turn.

    columns: as many as constraints, or more
    """
    chance = _make_generator(seed, agents=agents, constraints=constraints)
    if columns < constraints:
        raise ConfigError(
            "random LP: columns",
            columns,
            f"{constraints} or more, as many as constraints",
        )
    a = chance.normal(size=(constraints, columns))
    y = chance.normal(size=constraints)
    x = np.zeros(columns)
    reduced = chance.uniform(0.2, 2.0, columns)
    basis = chance.permutation(columns)[:constraints]
    x[basis] = chance.uniform(0.5, 2.0, constraints)
    reduced[basis] = 0.0
    return RandomLinearProgram(
        a.T @ y + reduced, a, a @ x, x, y, _deal_items(agents, columns)
    )


@dataclass(frozen=True, eq=False)
class CoupledMixedIntegerProgram:
    """A mixed-integer linear program with common resources.

        min sum_i c_i'x_i subject to sum_i A_i x_i <= b, 0 <= x_i <= u

    The first entries of each x_i are integers.

    x = 0 is feasible.
    """

    c: Mat
    """(N, n) costs c_i."""
    a: Mat
    """(N, S, n) A_i."""
    b: Vec
    """(S,) b."""
    upper: Vec
    """(n,) upper bounds u, the same for all agents."""
    integers: int
    """Number of integer entries of x_i."""


def random_milp(
    agents: int,
    n: int = 5,
    integers: int = 3,
    coupling: int = 3,
    tightness: float = 0.4,
    seed: int = 0,
) -> CoupledMixedIntegerProgram:
    """Return a resource allocation in which all agents want much of scarce resources.

    coupling: number of resources
    tightness: b as a part of the use of all agents at their upper bounds, above 0, below 1
    """
    chance = _make_generator(seed, agents=agents, n=n, coupling=coupling)
    if not (0.0 < tightness < 1.0 and 0 <= integers <= n):
        found = f"tightness {tightness}, {integers} integers"
        raise ConfigError(
            "random MILP", found, f"a tightness between 0 and 1, 0 to {n} integers"
        )
    upper = np.where(np.arange(n) < integers, 5.0, 3.0)
    a = chance.uniform(0.0, 1.0, (agents, coupling, n))
    b = tightness * (a @ upper).sum(axis=0)
    return CoupledMixedIntegerProgram(
        -chance.uniform(0.1, 5.0, (agents, n)), a, b, upper, integers
    )


def _make_generator(seed: int, **sizes: int) -> np.random.Generator:
    for name, size in sizes.items():
        if size < 1:
            raise ConfigError(f"random problem: {name}", size, "1 or more")
    return np.random.default_rng(seed)


def _deal_items(agents: int, items: int) -> dict[int, tuple[int, ...]]:
    return {i: tuple(range(i, items, agents)) for i in range(agents)}
