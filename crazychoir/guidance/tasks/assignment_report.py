"""The generations of a task assignment, from the results of all robots, beside a central solver."""

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from crazychoir.guidance.mission_report import Results
from crazychoir.types import Mat

Pair = tuple[int, int]
"""A task, and the generation in which it was done."""


def list_rows(results: Results) -> dict[int, dict[int, dict[str, Any]]]:
    """Return the rows of each generation, by robot."""
    found: dict[int, dict[int, dict[str, Any]]] = {}
    for i, result in results.items():
        for table in result.get("tables", []):
            found.setdefault(table["number"], {})[i] = table
    return found


def join_generation(
    number: int, rows: dict[int, dict[str, Any]], done: list[Pair]
) -> dict[str, Any]:
    """Return one generation with the rows of all its robots.

    optimum: cost of a central solver. None if robots are lost, and their costs with them.
    """
    first = next(iter(rows.values()))
    costs = np.array(
        [[np.inf if c is None else c for c in row["costs"]] for row in rows.values()]
    )
    whole = list(rows) == first["team"]
    return {
        "number": number,
        "filled": first["filled"],
        "tasks": first["tasks"],
        "assigned": {
            i: row["mine"] for i, row in rows.items() if row["mine"] is not None
        },
        "cost": first["cost"],
        "optimum": compute_optimum(costs) if whole else None,
        "infeasible": first["infeasible"],
        "rounds": first["rounds"],
        "seconds": max(row["seconds"] for row in rows.values()),
        "served": sorted(task for task, generation in done if generation == number),
    }


def compute_optimum(costs: Mat) -> float | None:
    """Return the least cost in m of as many pairs as possible, or None if there are no tasks.

    costs: (robots, tasks) m, inf if the robot may not do the task.
    """
    if costs.size == 0:
        return None
    allowed = np.isfinite(costs)
    dear = 1.0 + 2.0 * float(
        costs[allowed].sum()
    )  # costs more than all allowed pairs together
    chosen = linear_sum_assignment(np.where(allowed, costs, dear))
    return float(np.where(allowed, costs, 0.0)[chosen].sum())


def compute_gap(table: dict[str, Any]) -> float:
    """Return the absolute difference in m between the team's cost and the central solver's cost.

    Returns 0 if the central solver has no cost.
    """
    return 0.0 if table["optimum"] is None else abs(table["cost"] - table["optimum"])
