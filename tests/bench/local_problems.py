"""What an agent's local problem costs: ours, beside cvxpy solving it again with another cost (a DPP parameter).

python tests/bench/local_problems.py prints microseconds of CPU a solve, and cvxpy's as a multiple of ours.
"""

import statistics
import time
from collections.abc import Callable

import cvxpy as cp
import numpy as np

from crazychoir.optimization.problems.problems import CostCoupled

N = 10
"""Entries of x."""
SOLVES = {"ours": 200, "cvxpy": 10}
CVXPY = {
    "closed form": "OSQP",
    "active set": "OSQP",
    "HiGHS": "HIGHS",
    "Clarabel": "CLARABEL",
}
"""For each of our solvers, the solver of cvxpy: its own choice for quadratic and linear problems."""


def problems() -> dict[str, tuple[cp.Variable, cp.Expression, list[cp.Constraint]]]:
    """x, f and X of each structure."""
    draw = np.random.default_rng(0)
    x, L, A, a = (
        cp.Variable(N),
        draw.normal(size=(N, N)),
        draw.normal(size=(3 * N, N)),
        draw.normal(size=N),
    )
    quadratic, box = cp.quad_form(x, L @ L.T + np.eye(N)) + a @ x, [x >= -1, x <= 1]
    return {
        "quadratic, one equality": (x, quadratic, [cp.sum(x) == 1]),
        "quadratic, a box": (x, quadratic, box),
        "quadratic, 30 rows": (x, quadratic, [A @ x <= 1]),
        "least squares, a box": (x, cp.sum_squares(A @ x - 1), box),
        "linear, a box and 30 rows": (x, a @ x, [*box, A @ x <= 1]),
        "1-norm, a box": (x, cp.norm1(A @ x - 1), box),
        "quadratic, a ball": (x, quadratic, [cp.norm(x) <= 1]),
        "logarithm, a box": (x, -cp.sum(cp.log(x + 2)), box),
    }


def microseconds(
    solve: Callable[[np.ndarray], object], costs: np.ndarray, n: int
) -> float:
    """Median over five repetitions of n solves, us of CPU a solve."""
    solve(costs[0])
    took = []
    for repetition in range(5):
        start = time.process_time()
        for k in range(n):
            solve(costs[(repetition * n + k) % len(costs)])
        took.append((time.process_time() - start) / n * 1e6)
    return statistics.median(took)


def run() -> list[tuple[str, str, float, float]]:
    """Return (name, our solver, us of our solver, us of cvxpy) for each problem."""
    costs, rows = np.random.default_rng(1).normal(size=(500, N)), []
    for name, (x, objective, constraints) in problems().items():
        problem, p = CostCoupled(0, x, objective, constraints), cp.Parameter(N)
        again = cp.Problem(cp.Minimize(objective + p @ x), constraints)
        solver = CVXPY[problem.solver()]

        def cvxpy(
            cost: np.ndarray,
            again: cp.Problem = again,
            p: cp.Parameter = p,
            solver: str = solver,
        ) -> None:
            p.value = cost
            again.solve(solver=solver)

        ours, theirs = (
            microseconds(solve, costs, SOLVES[who])
            for who, solve in (("ours", problem.argmin), ("cvxpy", cvxpy))
        )
        rows.append((name, problem.solver(), ours, theirs))
    return rows


if __name__ == "__main__":
    for name, solver, ours, theirs in run():
        print(
            f"{name:28} {solver:12} {ours:8.1f} us   cvxpy {theirs:8.1f} us   x {theirs / ours:6.1f}"
        )
