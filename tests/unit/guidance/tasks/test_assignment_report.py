"""The costs of generations beside those of a central solver."""

from itertools import permutations

import numpy as np
import pytest

from crazychoir.guidance.tasks.assignment_report import compute_optimum
from crazychoir.guidance.tasks.task_assignment import measure_distance
from crazychoir.guidance.tasks.task_book import Task
from crazychoir.types import State

DRAW = np.random.default_rng(2)


def test_the_central_solver_serves_as_many_as_can_be_at_the_least_cost():
    for _ in range(30):
        costs = DRAW.uniform(0.0, 9.0, (4, 3))
        costs[DRAW.random((4, 3)) < 0.5] = np.inf
        pairs = [
            sum(
                (
                    costs[i, k]
                    for k, i in enumerate(order)
                    if i is not None and np.isfinite(costs[i, k])
                ),
                0.0,
            )
            for order in permutations([0, 1, 2, 3], 3)
        ]
        served = [
            sum(np.isfinite(costs[i, k]) for k, i in enumerate(order))
            for order in permutations([0, 1, 2, 3], 3)
        ]
        best = min(
            cost for cost, n in zip(pairs, served, strict=True) if n == max(served)
        )
        assert compute_optimum(costs) == pytest.approx(best)
    assert compute_optimum(np.zeros((3, 0))) is None
    assert measure_distance(
        State.at((0.0, 3.0, 9.0)), Task(0, 0, False, (4.0, 0.0), (4.0, 0.0))
    ) == pytest.approx(5.0)
