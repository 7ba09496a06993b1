"""What the predictive-control mission needs beside its law: goals, limits, and which drone was ahead."""

import numpy as np
import pytest

from crazychoir.guidance.defaults.mpc import MPCHooks, MPCOptions

HOOKS = MPCHooks(MPCOptions)


def test_the_third_drone_of_the_own_swarm_is_slow():
    config = HOOKS.swarm()
    speeds = [HOOKS.motion(config, drone).speed for drone in config.drones]
    assert speeds == [0.6, 0.6, 0.25, 0.6]
    assert HOOKS.check(config) == []
    assert HOOKS.planned_reach(config) == pytest.approx(0.3)


def test_a_drone_may_have_its_own_goal():
    config = HOOKS.swarm(1)
    drones = [{"id": 0, "home": [0, 0, 0], "options": {"goal": [1.0, 0.5]}}]
    config = config.replace(drones=drones)
    assert HOOKS.goal(config)[0][:2].tolist() == [1.0, 0.5]


def test_the_largest_lead_over_a_neighbour_is_found():
    config = HOOKS.swarm(3)
    results = {}
    for i in config.ids:
        goal = HOOKS.goal_of(config, config.drone(i))
        left = np.array([[3.0, 0.0], [1.0 if i == 2 else 1.4, 0.0], [0.0, 0.0]])
        results[i] = {"way": np.column_stack([[0, 1, 2], goal - left]).tolist()}
    ahead, pair = HOOKS.most_ahead(config, results)
    assert ahead == pytest.approx(0.4)
    assert pair == (1, 2)
