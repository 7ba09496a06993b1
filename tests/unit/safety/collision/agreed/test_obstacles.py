"""Where a drone comes down that cannot do so where it is."""

import numpy as np
import pytest

from crazychoir.safety.collision.agreed.obstacles import find_free_place
from crazychoir.safety.rules.guard import Fence

HALL = Fence.box((-1.0, -1.0, 0.0), (1.0, 1.0, 2.0))
P = np.array([0.0, 0.0, 0.3])


def test_it_is_the_nearest_that_is_far_enough_from_all():
    assert find_free_place(P, np.array([[0.5, 0.0, 0.4]]), HALL) == pytest.approx(P)
    place = find_free_place(P, np.array([[0.1, 0.0, 0.4]]), HALL)
    assert place == pytest.approx([-0.3, 0.0, 0.3])
    others = np.array(
        [[0.0, 0.0, 0.4], [-0.4, 0.0, 0.4], [0.4, 0.0, 0.4], [0.0, 0.4, 0.4]]
    )
    place = find_free_place(P, others, HALL)
    assert all(np.hypot(*(place[0:2] - other[0:2])) >= other[2] for other in others)
    assert np.linalg.norm(place[0:2]) == pytest.approx(0.4)


def test_it_is_inside_the_fence_or_nowhere():
    assert (
        find_free_place(np.array([0.9, 0.0, 0.3]), np.array([[0.8, 0.0, 0.5]]), HALL)[0]
        <= 0.9
    )
    assert find_free_place(P, np.array([[0.0, 0.0, 9.0]]), HALL) is None
