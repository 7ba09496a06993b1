import numpy as np
import pytest

from crazychoir.routing.search.annealing import _is_accepted

PRESENT = (2, 5.0, 10.0, 30.0)
"""Number of missing tasks, absences of these tasks, what counts before lengths, and cost in m."""


@pytest.mark.parametrize(
    ("new", "accepted"),
    [
        ((1, 9.0, 99.0, 99.0), True),
        ((2, 4.0, 99.0, 99.0), True),
        ((3, 5.0, 0.0, 0.0), False),
        ((2, 6.0, 0.0, 0.0), False),
        ((2, 5.0, 9.0, 99.0), True),
        ((2, 5.0, 11.0, 0.0), False),
    ],
)
def test_missing_tasks_and_vehicles_decide_before_the_cost_without_a_draw(
    new, accepted
):
    random = np.array([7], np.uint64)
    assert bool(_is_accepted(PRESENT, new, 1e9, random)) == accepted
    assert random[0] == 7


@pytest.mark.parametrize(
    ("cost", "temperature", "accepted"),
    [(29.9, 1e-9, True), (30.1, 1e-9, False), (30.1, 1e9, True)],
)
def test_a_dearer_plan_is_accepted_when_it_is_hot(cost, temperature, accepted):
    random = np.array([7], np.uint64)
    found = _is_accepted(PRESENT, (*PRESENT[:3], cost), temperature, random)
    assert bool(found) == accepted
    assert random[0] != 7
