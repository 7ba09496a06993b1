"""Random linear programs in units of any size, beside the same programs in units for which HiGHS can be trusted.

A program is drawn with entries near 1 and solved there by HiGHS. Then each row is multiplied by its own power of ten,
r_i, and each column by its own, s_j: A' = R A S, b' = R b, c' = S c. Its optimum is x' = S^-1 x, of the same value.
HiGHS is not asked about the scaled program: its tolerances are absolute, and it answers some of these wrongly.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

DIGITS = 6
"""Powers of ten of a row and of a column, from -DIGITS to DIGITS."""
FAMILIES = (
    "dense",
    "degenerate",
    "sparse",
    "any right-hand side",
    "any cost",
    "redundant rows",
    "free variables",
    "rows of zeros",
    "tiny or huge right-hand side",
    "equal columns",
    "nothing to do",
    "columns without rows",
)
STATUS = {0: "optimal", 2: "infeasible", 3: "unbounded"}


@dataclass
class Scaled:
    """min c'x s.t. A x = b, x >= 0 in units near 1, its truth, and the same with rows r and columns s.

    status: optimal, infeasible or unbounded;  value: c'x of the optimum;  parts: columns of each agent.
    """

    family: str
    c: np.ndarray
    A: np.ndarray
    b: np.ndarray
    r: np.ndarray
    s: np.ndarray
    status: str
    value: float
    parts: list[np.ndarray]

    @property
    def scaled(self):
        """c', A', b'."""
        return self.c * self.s, self.r[:, None] * self.A * self.s, self.b * self.r


def draw(seed, base=10.0):
    """One program. base: of the powers; 2.0 for scalings that are exact."""
    chance = np.random.default_rng(seed)
    family = FAMILIES[seed % len(FAMILIES)]
    c, A, b = _program(family, chance)
    if family == "tiny or huge right-hand side":
        b = b * 10.0 ** chance.uniform(-6, 6)
    m, n = A.shape
    digits = DIGITS / np.log10(base)
    r = base ** np.round(chance.uniform(-digits, digits, m), 3 if base == 10.0 else 0)
    s = base ** np.round(chance.uniform(-digits, digits, n), 3 if base == 10.0 else 0)
    status, value = truth(c, A, b)
    cuts = np.sort(chance.integers(0, n + 1, int(chance.integers(1, 5))))
    return Scaled(family, c, A, b, r, s, status, value, np.split(np.arange(n), cuts))


def truth(c, A, b):
    """Status and value by HiGHS, with b near 1."""
    size = np.abs(b).max(initial=0.0) or 1.0
    if linprog(0.0 * c, A_eq=A, b_eq=b / size).status:
        return "infeasible", np.nan
    central = linprog(c, A_eq=A, b_eq=b / size)
    return STATUS[3 if central.status in (3, 4) else central.status], size * (
        central.fun or 0.0
    )


def _program(family, chance):
    m = int(chance.integers(1, 7))
    n = int(chance.integers(1, 13))
    A = chance.normal(size=(m, n))
    if (
        family in ("degenerate", "equal columns", "redundant rows")
        and chance.random() < 0.7
    ):
        A = chance.integers(-1, 3, (m, n)).astype(float)
    if family == "sparse":
        A = A * (chance.random((m, n)) < 0.4)
    c = chance.normal(size=n) if family == "any cost" else chance.random(n)
    if family in ("degenerate", "free variables", "columns without rows"):
        c = chance.integers(-1, 4, n).astype(float)
    if family == "columns without rows":
        A[:, chance.random(n) < 0.3] = 0.0
    if family == "equal columns":
        k = chance.integers(0, n, n)
        A, c = A[:, k], c[k]
    if family == "free variables":
        A, c = np.hstack([A, -A[:, : n // 2]]), np.r_[c, -c[: n // 2]]
    if family == "redundant rows":
        mix = chance.integers(-2, 3, (int(chance.integers(1, 4)), m)).astype(float)
        A = np.vstack([A, mix @ A])
    if family == "rows of zeros":
        A[chance.random(m) < 0.4] = 0.0
    b = A @ (chance.integers(1, 4, A.shape[1]) * (chance.random(A.shape[1]) < 0.5))
    if family == "nothing to do":
        b = 0.0 * b
    if family == "any right-hand side" or chance.random() < 0.15:
        b = chance.normal(size=len(A))
    return c, A, b
