"""Mixed-integer programs coupled by resources, for tests: random ones, and their central optimum."""

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import Bounds, LinearConstraint, milp

from crazychoir.optimization.problems.mixed_integer import MixedIntegerBlock

HIGH = [5.0, 5.0, 5.0, 3.0, 3.0]


def random_blocks(agents, seed, tightness=0.8):
    """A knapsack of several resources each: three integer goods, two that are divisible, two own limits."""
    chance = np.random.default_rng(seed)
    costs, uses = -5 * chance.random((agents, 5)), chance.random((agents, 3, 5))
    rows, limits = chance.random((agents, 2, 5)), chance.uniform(5, 10, (agents, 2))
    share = tightness * uses.sum(axis=(0, 2)) / agents
    return [
        MixedIntegerBlock(
            i,
            costs[i],
            uses[i],
            share,
            rows=(rows[i], limits[i]),
            bounds=(0.0, HIGH),
            integer=range(3),
        )
        for i in range(agents)
    ]


def random_mixed_blocks(seed):
    """Two to five agents with no, some or only integers, and resources that are used or made."""
    chance = np.random.default_rng(seed)
    agents = int(chance.integers(2, 6))
    resources = int(chance.integers(1, 4))
    kind = chance.integers(3)
    parts = []
    for _ in range(agents):
        n = int(chance.integers(1, 5))
        c = chance.normal(size=n)
        made_or_used = chance.normal(size=(resources, n))
        used = chance.uniform(0, 1, (resources, n))
        A = made_or_used if chance.random() < 0.5 else used
        if chance.random() < 0.3:
            c = np.round(2 * c)
            A = np.round(2 * A)
        high = chance.integers(1, 5, n).astype(float)
        integer = [[], list(range(n // 2)), list(range(n))][kind]
        D = chance.normal(size=(2, n))
        d = np.abs(chance.normal(size=2)) + 0.1
        rows = (D, d) if chance.random() < 0.5 else None
        parts.append((c, A, rows, high, integer))
    wanted = sum(A @ (high * (c < 0)) for c, A, _, high, _ in parts)
    b = np.abs(wanted) * chance.uniform(0.2, 0.9, resources)
    return [
        MixedIntegerBlock(
            i, c, A, b / agents, rows=rows, bounds=(0.0, high), integer=integer
        )
        for i, (c, A, rows, high, integer) in enumerate(parts)
    ]


def central(blocks, relaxed=False):
    """The least cost of all together; None if there is no solution."""
    c, A = (
        np.concatenate([block.c for block in blocks]),
        np.hstack([block.A for block in blocks]),
    )
    D, d = (
        block_diag(*[block.rows[0] for block in blocks]),
        np.concatenate([block.rows[1] for block in blocks]),
    )
    low, high = (
        np.concatenate([block.bounds[side] for block in blocks]) for side in (0, 1)
    )
    integer = np.concatenate([block.integer for block in blocks]) & (not relaxed)
    rows = [
        LinearConstraint(A, ub=sum(block.share for block in blocks)),
        LinearConstraint(D, ub=d),
    ]
    options = {"mip_rel_gap": 1e-6}
    return milp(
        c,
        constraints=rows,
        bounds=Bounds(low, high),
        integrality=integer.astype(int),
        options=options,
    ).fun
