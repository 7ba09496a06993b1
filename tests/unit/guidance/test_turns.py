"""Which drone has its turn at a place, and where the others wait."""

import math

import numpy as np
import pytest
from pilots import make_stand_in

from crazychoir.guidance.turns import (
    TURN_DISTANCES,
    TURN_TIMES,
    TurnTaking,
    choose_place_aside,
    find_first_at,
    is_blocked,
)
from crazychoir.safety.airspace.airspace_rows import PAIR_ROW
from crazychoir.safety.rules.guard import Fence

P = np.array([1.0, 2.0, 0.5])
ME = 5
HALL = Fence.box((-3.0, -3.0, 0.0), (3.0, 3.0, 2.0))


def pilot(others, now=10.0, at=P, gave_way=-math.inf):
    """Return the pilot of drone 5 at `at`; others that it hears: {id: (m from P along x, m height, s old)}."""
    rows = np.zeros(len(others), PAIR_ROW)
    rows["drone"] = list(others)
    for row, (away, z, age) in zip(rows, others.values(), strict=True):
        row["state"][0:3] = (P[0] + away, P[1], z)
        row["state_time"] = now - age
    return make_stand_in(
        {
            "port.address": ME,
            "clock.now": lambda: now,
            "setup.limits.ground": 0.0,
            "setup.fence": HALL,
            "follower.clearance.traffic.rows": rows,
            "follower.clearance.gave_way": gave_way,
            "state.p": np.array(at),
            "gap": lambda p: float(np.linalg.norm(np.subtract(p, at))),
        }
    )


@pytest.mark.parametrize(
    ("others", "first"),
    [
        ({}, ME),
        (
            {
                3: (0.9 * TURN_DISTANCES.near, 0.5, 0.0),
                2: (0.1, 0.9, 0.0),
                7: (0.0, 0.5, 0.0),
            },
            2,
        ),
        ({7: (0.0, 0.5, 0.0)}, 7),
        ({2: (1.1 * TURN_DISTANCES.near, 0.5, 0.0)}, ME),
        ({2: (0.1, 0.02, 0.0)}, ME),
        ({2: (0.1, 0.5, 1.0)}, ME),
    ],
)
def test_the_lowest_id_of_the_drones_near_a_place_is_first(others, first):
    assert find_first_at(pilot(others), P) == first


def test_a_drone_that_gives_way_to_no_other_is_first():
    alone = make_stand_in({"port.address": ME, "follower.clearance.traffic": None})
    assert find_first_at(alone, P) == ME


def test_the_others_wait_on_their_own_side_as_high_as_the_place():
    assert choose_place_aside(np.add(P, [0.0, -0.2, 0.3]), P, HALL) == pytest.approx(
        P - [0.0, TURN_DISTANCES.waiting, 0.0]
    )
    assert np.linalg.norm(choose_place_aside(P, P, HALL) - P) == pytest.approx(
        TURN_DISTANCES.waiting
    )


def test_where_the_fence_is_near_they_wait_on_another_side():
    wall = np.array([0.0, 2.8, 0.5])
    here = np.add(wall, [0.0, 0.1, 0.0])
    assert choose_place_aside(here, wall, HALL) == pytest.approx(
        np.subtract(wall, [TURN_DISTANCES.waiting, 0.0, 0.0])
    )
    assert (
        choose_place_aside(here, wall, Fence.box((-0.1, 2.7, 0.0), (0.1, 2.9, 2.0)))[1]
        > 3.0
    ), "there is none"


def seen(turns, **changes):
    """Return `turns` with its pilot a moment later."""
    turns.pilot = pilot(**changes)
    return turns


SHARED, NEXT = {2: (0.1, 0.5, 0.0)}, P - [0.3, 0.0, 0.0]


def test_a_long_hindered_drone_leaves_its_place_to_a_lower_id_for_a_while():
    turns = TurnTaking(pilot(SHARED, at=NEXT))
    at = {"others": SHARED, "at": NEXT}
    assert turns.to(P) is P
    assert seen(turns, now=12.0, gave_way=12.0, **at).to(P) is P, (
        "it may get out of the way"
    )
    left = seen(
        turns, now=10.1 + TURN_TIMES.patience, gave_way=10.1 + TURN_TIMES.patience, **at
    ).to(P)
    assert left == pytest.approx(P - [TURN_DISTANCES.waiting, 0.0, 0.0])
    later = 10.2 + TURN_TIMES.patience
    assert seen(turns, now=later, **at).to(P) is left
    assert seen(turns, now=later, others={}, at=NEXT).to(P) is P, (
        "the other one has gone"
    )
    assert seen(turns, now=later + TURN_TIMES.aside, **at).to(P) is P, (
        "it has had its time"
    )


def test_a_drone_without_a_goal_gets_out_of_the_way_at_once_and_stays_there():
    turns = TurnTaking(pilot(SHARED, at=NEXT))
    assert turns.away() is None, "it hinders no drone"
    left = seen(turns, others=SHARED, at=NEXT, gave_way=10.0).away()
    assert left == pytest.approx(np.add(P, [0.1 - TURN_DISTANCES.waiting, 0.0, 0.0]))
    assert seen(turns, others=SHARED, at=NEXT, now=11.0).away() is left
    assert (
        seen(turns, others=SHARED, at=left, now=11.0, gave_way=11.0).away() is None
    ), "it is there"
    assert seen(turns, others={}, at=NEXT, now=20.0, gave_way=20.0).away() is None, (
        "no drone is near"
    )


def test_one_is_hindered_for_half_a_second_after_it_gave_way():
    assert is_blocked(pilot({}, gave_way=9.6))
    assert not is_blocked(pilot({}, gave_way=9.4))
