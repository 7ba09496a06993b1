"""What it costs to rest elsewhere than at the goal."""

import numpy as np
import pytest

from crazychoir.safety.collision.agreed.rest_goal import (
    ARRIVAL_DISTANCE,
    REST_COSTS,
    RestGoal,
)

GOAL, PLACE = np.array([1.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])
FIGURES = np.array([1.0, 0.4, 0.34, 0.15])


def aim(*awaited):
    return RestGoal(GOAL, 1.0, 0.8, awaited, FIGURES)


def test_at_the_goal_it_costs_nothing_and_near_it_what_a_flight_there_takes():
    near = GOAL + np.array([0.04, 0.0, 0.0])
    assert aim().missing(GOAL) == 0.0
    assert aim().missing(near) == pytest.approx(
        np.sqrt(84.0 * np.sqrt(5.0) / 25.0 * 0.04 / 0.8)
    )


def test_elsewhere_it_costs_more_than_the_flight_that_is_left():
    takes = np.sqrt(84.0 * np.sqrt(5.0) / 25.0 / 0.8)
    assert aim().missing(PLACE) == pytest.approx(
        REST_COSTS.elsewhere + REST_COSTS.remaining_flight * takes
    )
    assert (
        aim().missing(GOAL + np.array([2.0 * ARRIVAL_DISTANCE, 0.0, 0.0]))
        > REST_COSTS.elsewhere
    )


@pytest.mark.parametrize(
    ("offset", "extra"),
    [
        ((0.3, 0.0, 0.0), REST_COSTS.awaited_place),
        ((0.4, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 0.8), REST_COSTS.awaited_place),
    ],
)
def test_where_another_waits_to_come_to_it_costs_more(offset, extra):
    assert aim(PLACE + np.array(offset)).missing(PLACE) - aim().missing(
        PLACE
    ) == pytest.approx(extra)


def test_the_own_goal_costs_nothing_though_another_waits_for_it():
    assert aim(GOAL).missing(GOAL) == 0.0
