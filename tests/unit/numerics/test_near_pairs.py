"""Near places, against a comparison of all pairs."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from crazychoir.numerics.near_pairs import find_nearest, list_near_pairs


@pytest.mark.parametrize("n", [2, 3, 50])
def test_the_nearest_place_is_that_of_all_pairs(n):
    places = np.random.default_rng(n).uniform(-2.0, 2.0, (n, 3))
    gaps = squareform(pdist(places)) + np.diag(np.full(n, np.inf))

    near = find_nearest(places)

    np.testing.assert_array_equal(near.rows, gaps.argmin(axis=1))
    np.testing.assert_allclose(near.distances, gaps.min(axis=1))


def test_places_that_are_equal_are_nearest_to_each_other():
    places = np.array([[1.0, 2.0, 0.0]] * 3 + [[5.0, 0.0, 0.0]])

    near = find_nearest(places)

    assert all(near.rows[k] != k for k in range(4))
    np.testing.assert_array_equal(near.distances[:3], 0.0)


def test_pairs_within_reach_come_in_increasing_order():
    places = np.random.default_rng(4).uniform(-1.0, 1.0, (40, 3))
    gaps = squareform(pdist(places))

    found = list_near_pairs(places, 0.5)

    wanted = [(i, j) for i in range(40) for j in range(i + 1, 40) if gaps[i, j] <= 0.5]
    assert [tuple(pair) for pair in found.tolist()] == wanted
