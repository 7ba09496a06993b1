"""Ways are the polynomials of go_to; where two of them meet."""

import math

import numpy as np
import pytest

from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.safety.collision.agreed.meeting import OtherPaths
from crazychoir.safety.collision.agreed.paths import (
    compute_end_place,
    compute_motion,
    compute_path_duration,
    is_outside_box,
    plan_braking,
    plan_catching_up,
    plan_flight,
    plan_hold,
)
from crazychoir.simulation.onboard import loop
from crazychoir.simulation.onboard.onboard import Onboard

FIGURES = np.array([1.0, 0.4, 0.34, 0.15])
AT_REST = np.zeros(9)


def rest(*p):
    return np.concatenate([np.array(p, dtype=float), AT_REST])


def straight(p, q, v_max=1.0):
    return plan_flight(rest(*p), np.array(q, dtype=float), v_max, 2.0)


def planned(onboard, ms):
    """[(t, p)] s since the present plan began, m: what the planner on board wants, each 10 ms."""
    out, begin = [], float(onboard.record["planner"]["begin"])
    for _ in range(ms // 10):
        loop.run(onboard.rows, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, STANDARD_GRAVITY)
        t = 1e-3 * float((onboard.record["tick"] - 1) // 10 * 10)
        out.append(
            (t - begin, np.array([float(onboard.record["wanted"][c]) for c in "xyz"]))
        )
    return out


@pytest.mark.parametrize("interrupted", [0, 700])
def test_a_way_is_what_the_planner_on_board_flies(interrupted):
    """Single precision on board, double here: from rest, and from a flight under way.

    The planner on board does not know the jerk.
    """
    onboard = Onboard(CRAZYFLIE_21)
    onboard.planner.take_off(1.0, 1.0)
    start = rest(*planned(onboard, 1500)[-1][1])
    if interrupted:
        first = plan_flight(start, np.array([1.0, 1.0, 1.5]), 1.0, 2.0)
        onboard.planner.go_to((1.0, 1.0, 1.5), 0.0, float(first[0, 0]))
        begin = float(onboard.record["planner"]["begin"])
        planned(onboard, interrupted)
        start = compute_motion(first, 1e-3 * float(onboard.record["tick"]) - begin)
        start[9:12] = 0.0
    way = plan_flight(start, np.array([-1.2, 0.4, 0.7]), 1.0, 2.0)
    onboard.planner.go_to((-1.2, 0.4, 0.7), 0.0, float(way[0, 0]))
    flown = planned(onboard, 1000 * math.ceil(way[0, 0]))
    assert (
        max(np.abs(p - compute_motion(way, t)[0:3]).max() for t, p in flown[1:]) < 2e-4
    )
    assert flown[-1][1] == pytest.approx([-1.2, 0.4, 0.7], abs=1e-4)


@pytest.mark.parametrize("v", [(0.0, 0.0, 0.0), (0.8, -0.3, 0.1)])
def test_a_flight_keeps_the_limits_and_arrives_at_rest(v):
    start = np.array([0.0, 0.0, 1.0, *v, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    way = plan_flight(start, np.array([2.0, -1.0, 1.5]), 1.0, 2.0)
    flown = np.array(
        [
            compute_motion(way, t)
            for t in np.linspace(0.0, compute_path_duration(way), 400)
        ]
    )
    assert np.linalg.norm(flown[:, 3:6], axis=1).max() <= 1.1
    assert np.linalg.norm(flown[:, 6:9], axis=1).max() <= 2.3
    assert flown[0] == pytest.approx(start, abs=1e-9)
    assert compute_end_place(way) == pytest.approx([2.0, -1.0, 1.5])
    assert compute_motion(way, compute_path_duration(way) - 1e-9)[
        3:12
    ] == pytest.approx(np.zeros(9), abs=1e-5)


def test_a_motion_is_the_derivative_of_the_one_before():
    way, h = (
        plan_flight(np.linspace(0.1, 1.2, 12), np.array([2.0, 0.0, 1.0]), 1.0, 2.0),
        1e-5,
    )
    for t in (0.3, 0.9, 0.6 * compute_path_duration(way)):
        slope = (compute_motion(way, t + h) - compute_motion(way, t - h)) / (2.0 * h)
        assert compute_motion(way, t)[3:12] == pytest.approx(slope[0:9], abs=1e-5)


def test_a_stop_is_short_and_never_turns_back():
    start = np.array([0.0, 0.0, 1.0, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    way = plan_braking(start, 2.0)
    speeds = [
        compute_motion(way, t)[3]
        for t in np.linspace(0.0, compute_path_duration(way), 50)
    ]
    assert min(speeds) >= -1e-9
    assert compute_end_place(way)[0] == pytest.approx(
        15.0 / 16.0 * 0.8**2 / 2.0, rel=1e-6
    )


def test_keeping_up_comes_by_what_is_wanted_and_ends_at_rest():
    then = np.array([0.64, 0.0, 1.0, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    way = plan_catching_up(np.array([0.0, 0.0, 1.0, 0.8, *np.zeros(8)]), then, 0.8, 2.0)
    assert compute_motion(way, 0.4)[0] == pytest.approx(0.32)
    assert compute_motion(way, 0.8) == pytest.approx(then, abs=1e-9)
    assert compute_motion(way, 9.0)[3:12] == pytest.approx(np.zeros(9))


def met(way, others, began=0.0, now=0.0):
    meeting = OtherPaths(FIGURES, 2.0)
    for other in others:
        meeting.way(7, *other)
    return meeting.first(way, began, now)


def brute(way, other, began, other_began, until):
    """The first time at which the scaled distance is too small, looked at every ms."""
    for t in np.arange(max(began, other_began), until, 1e-3):
        d = (
            compute_motion(way, t - began)[0:3]
            - compute_motion(other, t - other_began)[0:3]
        ) * [
            1.0,
            1.0,
            0.4,
        ]
        if np.linalg.norm(d) < FIGURES[2]:
            return t
    return math.inf


def test_two_that_cross_meet_where_a_fine_look_says():
    one, two = straight((-1, 0, 1), (1, 0, 1)), straight((0, -1, 1), (0, 1, 1))
    time, whose = met(one, [(two, 0.3)])
    assert whose == 7
    assert time == pytest.approx(brute(one, two, 0.0, 0.3, 6.0), abs=0.051)
    assert met(one, [(two, 3.5)])[1] is None, "later it is clear"
    assert brute(one, two, 0.0, 3.5, 9.0) == math.inf


def test_one_meets_another_that_stays_and_passes_high_above_it():
    low = plan_hold(np.array([0.0, 0.0, 0.5]), 0.0)
    assert met(straight((-1, 0, 0.6), (1, 0, 0.6)), [(low, 0.0)])[1] == 7
    assert met(straight((-1, 0, 1.4), (1, 0, 1.4)), [(low, 0.0)])[1] is None
    assert met(straight((-1, 0, 1.2), (1, 0, 1.2)), [(low, 0.0)])[1] == 7, (
        "0.7 m count for 0.28"
    )


def test_what_is_over_is_no_meeting():
    one, two = straight((-1, 0, 1), (1, 0, 1)), straight((0, -1, 1), (0, 1, 1))
    first, _ = met(one, [(two, 0.0)])
    assert met(one, [(two, 0.0)], now=first + 2.5)[1] is None


def test_two_that_are_too_near_may_part_and_not_come_nearer():
    beside = plan_hold(np.array([0.0, 0.25, 1.0]), 0.0)
    assert met(straight((0, 0, 1), (0, -1, 1)), [(beside, 0.0)])[1] is None
    assert met(straight((0, 0, 1), (0.3, 0.25, 1)), [(beside, 0.0)])[1] == 7


def test_one_on_the_floor_is_no_obstacle_a_little_above():
    meeting = OtherPaths(FIGURES, 2.0)
    meeting.stands(4, np.zeros(3))
    assert meeting.clear(straight((-1, 0, 0.3), (1, 0, 0.3)), 0.0, 0.0)
    assert not meeting.clear(straight((-1, 0, 0.3), (0, 0, 0.1)), 0.0, 0.0)


def test_a_drone_that_tells_no_path_is_assumed_to_brake():
    meeting = OtherPaths(FIGURES, 2.0)
    meeting.guessed(4, np.array([0.0, -0.9, 1.0]), np.array([0.0, 1.0, 0.0]), 0.0)
    assert meeting.first(plan_hold(np.array([0.0, 0.1, 1.0]), 2.0), 0.0, 0.0)[1] == 4
    assert meeting.clear(plan_hold(np.array([0.0, 0.5, 1.0]), 2.0), 0.0, 0.0)


def test_a_silent_drone_may_be_anywhere_on_its_path():
    way = straight((0, -1, 1), (0, 1, 1))
    through = straight((-1, 0, 1), (0.4, 0, 1))
    meeting = OtherPaths(FIGURES, 2.0)
    meeting.somewhere(4, way, 0.0, 1.0)
    assert not meeting.clear(through, 9.0, 9.0), "though it should be long past"
    assert met(through, [(way, 0.0)], began=9.0, now=9.0)[1] is None
    assert meeting.clear(straight((-1, -1, 1), (0, -1.6, 1)), 9.0, 9.0), (
        "that it had left before"
    )


def test_a_silent_drone_that_has_come_to_rest_is_still_there():
    way = straight((0, -1, 1), (0, 0, 1))
    for heard in (0.5, compute_path_duration(way) + 0.05, 60.0):
        meeting = OtherPaths(FIGURES, 2.0)
        meeting.somewhere(4, way, 0.0, heard)
        assert not meeting.clear(straight((-1, 0, 1), (1, 0, 1)), 63.0, 63.0)


def test_a_drone_that_may_have_come_down_may_be_anywhere_below():
    meeting, over, under = (
        OtherPaths(FIGURES, 2.0),
        straight((-1, 0, 2), (1, 0, 2)),
        straight((-1, 0, 0.3), (1, 0, 0.3)),
    )
    meeting.way(4, plan_hold(np.array([0.0, 0.0, 1.2]), 0.0), -math.inf)
    assert meeting.clear(under, 0.0, 0.0)
    meeting = OtherPaths(FIGURES, 2.0)
    meeting.below(4, np.array([0.0, 0.0, 1.1]))
    assert not meeting.clear(under, 0.0, 0.0)
    assert meeting.clear(over, 0.0, 0.0)


def test_a_way_leaves_a_box_wherever_it_is_outside():
    low, high = np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 2.0])
    along = straight((-1.0, 0.0, 1.0), (1.0, 0.0, 1.0))
    assert not is_outside_box(along, 0.0, low, high)
    assert is_outside_box(straight((0.0, 0.0, 1.0), (0.0, 1.1, 1.0)), 0.0, low, high)
    middle, below = (0.0, 0.0, 1.0), (0.0, 0.0, -0.2)
    there, back = straight(middle, below), straight(below, middle)
    way = np.concatenate([there, back])
    assert is_outside_box(way, 0.0, low, high)
    lasts = compute_path_duration(way)
    assert is_outside_box(way, 0.5 * lasts, low, high)
    assert not is_outside_box(way, 0.9 * lasts, low, high), "what is flown is over"


def test_an_accelerating_drone_comes_to_rest_without_flying_much_faster():
    start = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    way = plan_braking(start, 0.8)
    flown = np.array(
        [
            compute_motion(way, t)
            for t in np.linspace(0.0, compute_path_duration(way), 200)
        ]
    )
    assert np.linalg.norm(flown[:, 3:6], axis=1).max() < 1.4
    assert np.linalg.norm(flown[:, 6:9], axis=1).max() < 1.8


def test_a_path_that_begins_at_peak_acceleration_is_no_harder_than_that():
    start = np.array([0.0, 0.0, 1.0, 0.4, 0.0, 0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 0.0])
    way = plan_flight(start, np.array([1.0, 0.5, 1.0]), 1.0, 0.8)
    flown = np.array(
        [
            compute_motion(way, t)
            for t in np.linspace(0.0, compute_path_duration(way), 200)
        ]
    )
    assert np.linalg.norm(flown[:, 6:9], axis=1).max() < 1.0
