"""Random problems of a team, with their solutions where those are known by construction; the same for the same seed."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, eq=False)
class Quadratics:
    """f_i(x) = 1/2 x'P_i x + q_i'x, P_i positive definite.

    p: (N, n, n);  q: (N, n).
    """

    p: Mat
    q: Mat

    @property
    def optimum(self) -> Vec:
        """(n,) argmin sum_i f_i(x)."""
        return -np.linalg.solve(self.p.sum(axis=0), self.q.sum(axis=0))

    @property
    def smoothness(self) -> float:
        """L, the greatest Lipschitz constant of the gradients."""
        return float(np.linalg.eigvalsh(self.p).max())

    def cost(self, x: Vec) -> float:
        """sum_i f_i(x)."""
        return float(0.5 * x @ self.p.sum(axis=0) @ x + self.q.sum(axis=0) @ x)

    def gradient(self, i: int) -> Callable[[Vec], Vec]:
        """Of f_i."""
        return lambda x: self.p[i] @ x + self.q[i]


def random_quadratics(agents: int, n: int, seed: int = 0) -> Quadratics:
    """Quadratic costs of N agents in n variables: P_i = R R' + I/2, entries of R and q_i/2 standard normal."""
    chance = _chance(seed, agents=agents, n=n)
    roots = chance.normal(size=(agents, n, n))
    return Quadratics(
        roots @ roots.transpose(0, 2, 1) + 0.5 * np.eye(n),
        2.0 * chance.normal(size=(agents, n)),
    )


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """min c'x subject to A x <= b, or, in standard form, A x = b, x >= 0; with its unique solution.

    c: (n,);  a: (m, n);  b: (m,);  x: (n,), the solution;  dual: (m,), its multipliers: c + A'dual = 0 with dual >= 0
    of the inequalities, A'dual <= c in standard form;  parts: whose rows of A, or, in standard form, whose columns.
    """

    c: Vec
    a: Mat
    b: Vec
    x: Vec
    dual: Vec
    parts: dict[int, tuple[int, ...]]

    @property
    def cost(self) -> float:
        """Of the solution."""
        return float(self.c @ self.x)


def random_lp(agents: int, n: int, constraints: int, seed: int = 0) -> LinearProgram:
    """min c'x, a_r'x <= b_r: bounded and feasible; the rows are dealt out to the agents in turn.

    The solution x* is drawn first; n random rows are active there, with multipliers above 0 that make c, and so x*
    meets the conditions of Karush, Kuhn and Tucker; the others are slack. constraints: n or more.
    """
    chance = _chance(seed, agents=agents, n=n)
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
    return LinearProgram(
        -a.T @ dual, a, a @ x + slack, x, dual, _dealt(agents, constraints)
    )


def random_standard_lp(
    agents: int, columns: int, constraints: int, seed: int = 0
) -> LinearProgram:
    """min c'x, A x = b, x >= 0: bounded and feasible; the columns are dealt out to the agents in turn.

    A random basis, its x and the multipliers y are drawn first; c = A'y + s, with s above 0 outside the basis.
    columns: constraints or more.
    """
    chance = _chance(seed, agents=agents, constraints=constraints)
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
    return LinearProgram(a.T @ y + reduced, a, a @ x, x, y, _dealt(agents, columns))


@dataclass(frozen=True, eq=False)
class CoupledMixedIntegerProgram:
    """min sum_i c_i'x_i subject to sum_i A_i x_i <= b, 0 <= x_i <= u_i, the first entries of x_i integer.

    c: (N, n);  a: (N, S, n);  b: (S,);  upper: (n,);  integers: how many entries are. x = 0 is feasible.
    """

    c: Mat
    a: Mat
    b: Vec
    upper: Vec
    integers: int


def random_milp(
    agents: int,
    n: int = 5,
    integers: int = 3,
    coupling: int = 3,
    tightness: float = 0.4,
    seed: int = 0,
) -> CoupledMixedIntegerProgram:
    """A resource allocation: all want much, and share `coupling` resources that are scarce.

    tightness: b as a share of what all would use at their upper bounds, above 0, below 1.
    """
    chance = _chance(seed, agents=agents, n=n, coupling=coupling)
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


def _chance(seed: int, **sizes: int) -> np.random.Generator:
    for name, size in sizes.items():
        if size < 1:
            raise ConfigError(f"random problem: {name}", size, "1 or more")
    return np.random.default_rng(seed)


def _dealt(agents: int, items: int) -> dict[int, tuple[int, ...]]:
    return {i: tuple(range(i, items, agents)) for i in range(agents)}
