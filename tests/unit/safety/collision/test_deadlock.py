"""Which way round a drone goes that does not get on."""

import numpy as np
import pytest

from crazychoir.safety.collision.deadlock import (
    PASSING_SIDE_FIELDS,
    STUCK_LIMITS,
    note_giving_way,
    reset_side,
)

GOAL = np.array([2.0, 0.0, 1.0])


def common_side():
    side = np.zeros(1, PASSING_SIDE_FIELDS)
    reset_side(side, drone=0)
    return side


def signs(side, places, goal=GOAL, period=0.1, began=0.0):
    """Of a drone that gives way at each of these places."""
    found = []
    for k, p in enumerate(places):
        note_giving_way(side[0], np.asarray(p, dtype=float), goal, began + period * k)
        found.append(float(side["side"][0]))
    return found


def test_a_stuck_drone_tries_the_other_side_and_then_the_first_one_again():
    found = signs(common_side(), [(0.1 * (k % 2), 0.0, 1.0) for k in range(140)])
    turns = [0.1 * k for k in range(1, 140) if found[k] != found[k - 1]]
    assert turns == pytest.approx(
        [
            STUCK_LIMITS.stuck_time + 0.1,
            2.0 * (STUCK_LIMITS.stuck_time + 0.1),
            3.0 * (STUCK_LIMITS.stuck_time + 0.1),
        ]
    )
    assert found[0] == 1.0


def test_a_moving_drone_keeps_its_side():
    assert (
        signs(
            common_side(),
            [
                (
                    0.0,
                    1.1
                    * STUCK_LIMITS.moved_distance
                    * k
                    / (10.0 * STUCK_LIMITS.stuck_time),
                    1.0,
                )
                for k in range(400)
            ],
        )
        == [1.0] * 400
    )


def test_a_drone_at_its_goal_keeps_its_side():
    assert signs(common_side(), [GOAL + 0.1] * 400) == [1.0] * 400


@pytest.mark.parametrize(
    ("gap", "sign"),
    [(0.5 * STUCK_LIMITS.free_time, -1.0), (2.0 * STUCK_LIMITS.free_time, 1.0)],
)
def test_a_drone_that_was_free_for_a_while_returns_to_the_common_side(gap, sign):
    side = common_side()
    still = [(0.0, 0.0, 1.0)] * 45
    assert signs(side, still)[-1] == -1.0
    assert signs(side, [(1.0, 0.0, 1.0)], began=4.4 + gap) == [sign]
