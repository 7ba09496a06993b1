"""Start delays: everybody computes the same ones, and the flights keep their distance with them."""

from itertools import pairwise

import numpy as np
import pytest

from crazychoir.errors import Refused
from crazychoir.guidance.separation import STEP, start_delays

CLEARANCE = 0.35


def flight(*places, speed=0.5):
    """(T, 3) m: a flight from place to place at a constant speed, sampled every STEP s."""
    legs = []
    for a, b in pairwise(places):
        a, b = np.array(a), np.array(b)
        n = max(1, round(np.linalg.norm(b - a) / (speed * STEP)))
        legs.append(a + np.linspace(0.0, 1.0, n + 1)[:, None] * (b - a))
    return np.vstack(legs)


def trip(home, place, height=0.5):
    """Up, there, back, down."""
    (x, y), (u, v) = home, place
    return flight((x, y, 0.0), (x, y, height), (u, v, height), (x, y, height), (x, y, 0.0))


def closest(paths, delays, i, j, shift=0.0):
    """Smallest distance of two delayed flights, vertical distances halved in the air; by interpolation."""
    end = max(delays[k] + len(paths[k]) * STEP for k in (i, j)) + 1.0

    def at(k, t):
        grid = np.arange(len(paths[k])) * STEP
        return np.column_stack([np.interp(t - delays[k], grid, paths[k][:, c]) for c in range(3)])

    t = np.arange(0.0, end, 0.02)
    a, b = at(i, t), at(j, t + shift)
    d = a - b
    d[np.minimum(a[:, 2], b[:, 2]) > 0.1, 2] *= 0.5
    return np.linalg.norm(d, axis=1).min()


CROSSING = {0: trip((0.0, 0.0), (2.0, 0.0)), 1: trip((1.0, -1.0), (1.0, 1.0)), 2: trip((0.0, 0.8), (2.0, -0.8))}


def test_flights_that_never_meet_start_at_once():
    apart = {i: trip((0.0, 1.0 * i), (2.0, 1.0 * i)) for i in range(4)}
    assert start_delays(apart, CLEARANCE) == dict.fromkeys(range(4), 0.0)


def test_one_that_meets_another_waits_and_the_lower_id_goes_first():
    delays = start_delays(CROSSING, CLEARANCE)
    assert delays[0] == 0.0
    assert delays[2] > 0.0
    assert all(d % 0.5 == 0.0 for d in delays.values())


@pytest.mark.parametrize("shift", [-0.3, -0.15, 0.0, 0.15, 0.3])
def test_with_their_delays_any_two_keep_their_distance_also_out_of_step(shift):
    delays = start_delays(CROSSING, CLEARANCE, slack=0.3)
    assert closest(CROSSING, dict.fromkeys(CROSSING, 0.0), 0, 2) < CLEARANCE, "without delays they do not"
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert closest(CROSSING, delays, i, j, shift) >= CLEARANCE - 0.03, "a sample apart"


def test_it_waits_no_longer_than_it_must():
    delays = start_delays(CROSSING, CLEARANCE)
    sooner = {**delays, 2: delays[2] - 0.5}
    worst = min(closest(CROSSING, sooner, i, 2, shift) for i in (0, 1) for shift in (-0.3, 0.0, 0.3))
    assert worst < CLEARANCE


def test_the_order_of_the_dictionary_does_not_matter():
    turned = dict(reversed(CROSSING.items()))
    assert start_delays(turned, CLEARANCE) == start_delays(CROSSING, CLEARANCE)


def test_who_stands_on_the_floor_is_an_obstacle_by_its_true_distance():
    """Drone 0 flies 0.5 m above drone 1, that has landed or waits: halved that would be too near."""
    paths = {0: trip((0.0, 0.0), (2.0, 0.0)), 1: trip((1.0, 0.0), (1.0, 0.0))}
    assert start_delays(paths, 0.3)[1] == 0.0
    with pytest.raises(Refused, match=r"the flight of drone 1: .*within 0.55 m of drone\(s\) 0 however long it waits"):
        start_delays(paths, 0.55)


def test_homes_that_are_nearer_than_the_clearance_are_refused():
    paths = {0: trip((0.0, 0.0), (0.0, 2.0)), 1: trip((0.3, 0.0), (0.3, 2.0))}
    with pytest.raises(Refused, match="move their homes apart"):
        start_delays(paths, CLEARANCE)


def test_air_above_another_is_rough():
    """0.6 m above each other all the way: counted as 0.3 m."""
    paths = {0: trip((0.0, 0.0), (2.0, 0.0), height=0.5), 1: trip((0.0, 0.5), (2.0, 0.0), height=1.1)}
    assert start_delays(paths, 0.25)[1] == 0.0
    assert start_delays(paths, CLEARANCE)[1] > 0.0


def test_nobody_and_one_alone():
    assert start_delays({}, CLEARANCE) == {}
    assert start_delays({4: CROSSING[0]}, CLEARANCE) == {4: 0.0}
