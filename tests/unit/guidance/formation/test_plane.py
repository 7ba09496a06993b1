"""Robots in the plane: shapes wherever their centre is, and points between leaders."""

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.formation.plane import CornerHooks, PointHooks
from crazychoir.guidance.mission import load_mission

SQUARE = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])


def corners(config):
    return dict(zip(config.ids, SQUARE, strict=True))


def test_a_shape_may_be_anywhere_but_no_robot_beside_its_corner():
    config = load_mission("unicycles").swarm(None)
    hooks = CornerHooks(corners)
    ends = {i: {"place": [p[0] + 3.0, p[1] + 1.0, 0.0]} for i, p in enumerate(SQUARE)}
    report = hooks.report(config, ends)
    assert report["success"]
    assert report["worst_error_m"] == pytest.approx(0.0, abs=1e-12)
    ends[2]["place"][0] += 0.08
    assert hooks.report(config, ends)["reasons"] == {
        2: "0.060 m from its corner, allowed 0.03 m"
    }


def test_options_are_refused():
    config = load_mission("unicycles").swarm(None)
    with pytest.raises(ConfigError, match="there is no such key"):
        CornerHooks(corners).check(config.replace(mission_options={"k": 1.0}))


def test_points_end_at_the_mean_of_their_neighbours():
    config = load_mission("integrators").swarm(None)
    goals = PointHooks().goal(config)
    for robot in config.drones:
        heard = [goals[j] for j in config.graph().in_neighbors(robot.id)]
        wanted = robot.home if robot.leader else np.mean(heard, axis=0)
        np.testing.assert_allclose(goals[robot.id], wanted, atol=1e-12)
