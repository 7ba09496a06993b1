"""The ways among which a drone chooses stay inside the fence, and are slow enough."""

import numpy as np
import pytest

from crazychoir.safety.collision.agreed.detours import Detours
from crazychoir.safety.collision.agreed.paths import (
    compute_end_place,
    compute_motion,
    compute_path_duration,
    find_peak_speed,
    plan_braking,
    plan_flight,
)
from crazychoir.safety.collision.agreed.rest_goal import RestGoal
from crazychoir.safety.rules.guard import FENCE_INSET, Fence

FENCE = Fence.box((-3.0, -3.0, 0.25), (3.0, 3.0, 2.5))
DOWN = np.array([0.0, 0.0, 0.6, 0.0, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def options(start, goal, present=None, most=1000.0):
    """Return the paths from a motion to a goal; present: the path before it, None: it brakes."""
    aim = RestGoal(np.array(goal), 1.0, 0.8, (), np.ones(4))
    if present is None:
        present = plan_braking(start, 0.8), 0.0
    return Detours(1.0, 0.8, FENCE, np.random.default_rng(1)).options(
        start, aim, present, most
    )


def lowest(option):
    return min(
        compute_motion(option.way, t)[2]
        for t in np.linspace(0.0, compute_path_duration(option.way), 300)
    )


@pytest.mark.parametrize("z", [0.6, 1.0])
def test_no_way_leaves_the_fence_though_the_drone_flies_towards_it(z):
    start = DOWN.copy()
    start[2] = z
    unavoidable = min(
        FENCE.low[2] + FENCE_INSET, compute_end_place(plan_braking(start, 0.8))[2]
    )
    found = options(start, (2.5, 0.0, 1.0))
    assert len(found) > 5
    assert min(map(lowest, found)) >= unavoidable - 0.005


@pytest.mark.parametrize("speed", [0.8, 1.2])
def test_no_way_goes_into_the_floor_though_the_drone_dives(speed):
    start = DOWN.copy()
    start[5] = -speed
    assert compute_end_place(plan_braking(start, 0.8))[2] < 0.1
    assert all(
        lowest(option) >= 0.1 - 0.005 for option in options(start, (2.5, 0.0, 1.0))
    )


def test_a_drone_on_a_path_inside_the_fence_takes_no_path_out_of_it():
    """It accelerates, so a path that begins anew would come to rest far away."""
    before = np.array(
        [0.87, -1.37, 1.44, 0.3, -0.48, 0.18, -0.45, 0.73, 0.54, 0.0, 0.0, 0.0]
    )
    way = plan_flight(before, np.array([1.71, -2.26, 2.36]), 1.0, 0.8)
    start = compute_motion(way, 1.4)
    assert compute_end_place(plan_braking(start, 0.8))[2] > 2.4 + 0.05
    goal = (-2.5, 0.0, 1.0)
    present = way, 1.4
    found = options(start, goal, present)
    urgent = options(start, goal, present, most=np.inf)
    assert len(urgent) > len(found), "nearer to the fence if it must leave its path"
    for option in urgent:
        inset = FENCE_INSET if option.cost in [other.cost for other in found] else 0.0
        path = np.array(
            [
                compute_motion(option.way, t)[0:3]
                for t in np.linspace(0.0, compute_path_duration(option.way), 300)
            ]
        )
        assert path[:, 2].max() <= 2.5 - inset + 0.005
        assert path[:, 0].max() <= 3.0 - inset + 0.005


def test_ways_keep_off_the_sides_of_the_fence():
    start = np.array([-2.8, 0.0, 2.3, *np.zeros(9)])
    for option in options(start, (2.8, 0.0, 2.3)):
        assert (
            max(
                compute_motion(option.way, t)[2]
                for t in np.linspace(0.0, compute_path_duration(option.way), 300)
            )
            <= 2.4 + 0.005
        )


def test_a_goal_below_the_fence_is_flown_to():
    found = options(np.array([0.0, 0.0, 1.0, *np.zeros(9)]), (0.0, 0.0, 0.05))
    assert compute_end_place(found[0].way) == pytest.approx([0.0, 0.0, 0.05])
    assert min(map(lowest, found)) >= 0.045


def test_a_drone_that_often_changes_its_path_gets_no_faster():
    """Each path begins anew while the drone still accelerates."""
    goal = (2.8, 0.5, 1.5)
    start = np.array([-2.0, 0.0, 1.0, 0.55, 0.05, 0.05, 0.75, *np.zeros(5)])
    way, flown = plan_braking(start, 0.8), 0.0
    for _ in range(20):
        found = options(start, goal, (way, flown))
        if found:
            way, flown = found[0].way, 0.0
        assert find_peak_speed(way) <= 1.06
        flown += 0.1
        start = compute_motion(way, flown)
    assert start[0] > -0.5


def test_a_drone_that_is_too_fast_gets_no_faster():
    start = np.array([-2.0, 0.0, 1.0, 1.3, *np.zeros(8)])
    found = options(start, (2.5, 0.0, 1.0))
    assert len(found) > 3
    assert max(find_peak_speed(option.way) for option in found) <= 1.3 + 1e-5
