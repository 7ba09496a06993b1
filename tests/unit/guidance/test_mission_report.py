"""How far drones are from their places, in words."""

import numpy as np

from crazychoir.guidance.mission_report import describe_distances

GOALS = {i: np.array([float(i), 0.0, 1.0]) for i in range(3)}


def test_only_drones_beyond_the_tolerance_are_named():
    results = {
        0: {"place": [0.0, 0.0, 1.02]},
        1: {"place": [1.0, 0.3, 1.4]},
        2: {"reason": "it was stopped"},
    }
    assert describe_distances(GOALS, results, 0.05, "its goal") == {
        1: "0.500 m from its goal, allowed 0.05 m"
    }
