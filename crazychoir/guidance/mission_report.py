"""What the reports of missions share: the results of all drones, and how far drones are from their places."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from crazychoir.types import Vec

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""


def describe_distances(
    goals: Mapping[int, Vec], results: Results, tolerance: float, place: str
) -> dict[int, str]:
    """Return by drone how far from its goal it ended. Drones within the tolerance are left out.

    goals: {id: (3,) m}.
    results: a drone without `place` counts as at its goal.
    tolerance: m.
    place: the goal in words, such as "its equilibrium".
    """
    reasons = {}
    for i, result in results.items():
        if "place" not in result:
            continue
        far = float(np.linalg.norm(goals[i] - result["place"]))
        if far > tolerance:
            reasons[i] = f"{far:.3f} m from {place}, allowed {tolerance} m"
    return reasons
