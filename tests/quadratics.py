"""Random problems with a common variable, of the class of dual decomposition, and their optimum by cvxpy."""

import json

import cvxpy as cp
import numpy as np

from crazychoir.optimization.problems.problems import CostCoupled


def costs(count, n, seed):
    """P_i (n, n), positive definite, and q_i (n,)."""
    draw = np.random.default_rng(seed)
    L, q = draw.normal(size=(count, n, n)), 2 * draw.normal(size=(count, n))
    return [(a @ a.T + np.eye(n), b) for a, b in zip(L, q, strict=True)]


def problems(data, bound=1.0):
    """min sum_i x'P_i x + q_i'x, |x_k| <= bound: one a pair (P_i, q_i)."""
    x = cp.Variable(len(data[0][1]))
    return [
        CostCoupled(i, x, cp.quad_form(x, P) + q @ x, [x <= bound, x >= -bound])
        for i, (P, q) in enumerate(data)
    ]


def optimum(parts):
    """(n,) of all together, by cvxpy."""
    x = parts[0].x
    problem = cp.Problem(
        cp.Minimize(sum(part.objective for part in parts)),
        [c for p in parts for c in p.constraints],
    )
    problem.solve(solver=cp.CLARABEL)
    return np.atleast_1d(x.value).copy()


def recorded(folder, name):
    """A recorded run: its data, and the problems it was of."""
    data = json.loads((folder / f"{name}.json").read_text())
    return data, problems(
        [(np.array(P), np.array(q)) for P, q in zip(data["P"], data["q"], strict=True)]
    )
