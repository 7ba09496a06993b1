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


def central(blocks, relaxed=False):
    """The least cost of all together."""
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
