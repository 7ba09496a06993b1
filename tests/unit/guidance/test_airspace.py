"""Levels and ways round the homes of others."""

from itertools import pairwise

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.airspace import levels, way_round

LOW, HIGH = np.array([-5.0, -5.0]), np.array([5.0, 5.0])


def gap(way, circle):
    """m between a way and a point."""
    best = np.inf
    for a, b in pairwise(way):
        d = b - a
        t = np.clip((circle - a) @ d / max(d @ d, 1e-12), 0.0, 1.0)
        best = min(best, np.linalg.norm(circle - a - t * d))
    return best


def test_each_drone_has_a_level_of_its_own_by_its_id():
    assert levels([7, 3, 5], 0.4, 0.25, 2.0) == pytest.approx({3: 0.4, 5: 0.65, 7: 0.9})


def test_levels_that_do_not_fit_are_refused():
    with pytest.raises(ConfigError, match=r"1\.90 m.*at most 1\.80 m"):
        levels(range(4), 0.4, 0.5, 1.8)


def test_a_free_way_is_straight():
    found = way_round(np.zeros(2), np.array([3.0, 0.0]), np.array([[1.0, 0.5], [9.0, 0.0]]), 0.4, LOW, HIGH)
    assert np.array(found) == pytest.approx(np.array([[3.0, 0.0]]))


@pytest.mark.parametrize("seed", range(20))
def test_a_way_keeps_clear_of_every_circle_and_is_hardly_longer(seed):
    draw = np.random.default_rng(seed)
    circles = draw.uniform(-3.0, 3.0, (6, 2))
    a, b = np.array([-4.0, draw.uniform(-1, 1)]), np.array([4.0, draw.uniform(-1, 1)])
    way = [a, *way_round(a, b, circles, 0.4, LOW, HIGH)]
    assert way[-1] == pytest.approx(b)
    assert all(gap(way, circle) >= 0.4 - 1e-6 for circle in circles)
    assert all((p >= LOW).all() and (p <= HIGH).all() for p in way)
    length = sum(np.linalg.norm(q - p) for p, q in pairwise(way))
    assert length <= 1.15 * np.linalg.norm(b - a)


def test_a_circle_that_holds_an_end_does_not_count():
    a, b = np.zeros(2), np.array([2.0, 0.0])
    found = way_round(a, b, np.array([[0.1, 0.0], [2.0, 0.3]]), 0.4, LOW, HIGH)
    assert len(found) == 1


def test_the_way_stays_in_the_room():
    low, high = np.array([-5.0, -0.2]), np.array([5.0, 2.0])
    way = way_round(np.array([-2.0, 0.0]), np.array([2.0, 0.0]), np.array([[0.0, 0.1]]), 0.4, low, high)
    assert len(way) > 1
    assert all(p[1] >= -0.2 for p in way)


def test_where_there_is_no_way_round_it_is_straight():
    low, high = np.array([-5.0, -0.2]), np.array([5.0, 0.2])
    way = way_round(np.array([-2.0, 0.0]), np.array([2.0, 0.0]), np.array([[0.0, 0.0]]), 0.4, low, high)
    assert np.array(way) == pytest.approx(np.array([[2.0, 0.0]]))
