"""Shapes: polygons have sides of the same length, rings their radius."""

import numpy as np
import pytest

from crazychoir.guidance.formation.shapes import polygon, ring


@pytest.mark.parametrize("count", [3, 4, 7])
def test_a_polygon_has_equal_sides_around_the_origin(count):
    corners = polygon(count, 1.5)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 1.5)
    np.testing.assert_allclose(corners.mean(axis=0), 0.0, atol=1e-12)


def test_two_corners_are_a_side_apart():
    first, second = polygon(2, 1.5)
    assert np.linalg.norm(first - second) == pytest.approx(1.5)


def test_a_ring_has_its_radius():
    places = ring(5, 2.5)
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 2.5)
    np.testing.assert_allclose(places[0], [2.5, 0.0])
