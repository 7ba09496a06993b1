"""Whose turn it is at a place, and where the others wait."""

from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.guidance.turns import AROUND, NEAR, aside, first_at
from crazychoir.safety.collision.traffic import BORN, COLUMNS

P = np.array([1.0, 2.0, 0.5])
ME = 5


def pilot(others, now=10.0):
    """That of drone 5, which hears others: {id: (m from P along x, m height, s old)}."""
    rows = np.zeros((len(others), COLUMNS))
    for row, (away, z, age) in zip(rows, others.values(), strict=True):
        row[0:3], row[BORN] = (P[0] + away, P[1], z), now - age
    return SimpleNamespace(
        drone=ME, clock=SimpleNamespace(now=lambda: now), limits=SimpleNamespace(ground=0.0),
        collision=SimpleNamespace(traffic=SimpleNamespace(rows=rows, ids=list(others))),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("others", "first"),
    [
        ({}, ME),
        ({3: (0.9 * NEAR, 0.5, 0.0), 2: (0.1, 0.9, 0.0), 7: (0.0, 0.5, 0.0)}, 2),
        ({7: (0.0, 0.5, 0.0)}, 7),
        ({2: (1.1 * NEAR, 0.5, 0.0)}, ME),
        ({2: (0.1, 0.02, 0.0)}, ME),
        ({2: (0.1, 0.5, 1.0)}, ME),
    ],
)
def test_the_lowest_of_those_that_fly_near_a_place_is_first(others, first):
    assert first_at(pilot(others), P) == first


def test_who_gives_way_to_nobody_is_first():
    assert first_at(SimpleNamespace(drone=ME, collision=None), P) == ME


def test_the_others_wait_on_their_own_side_as_high_as_the_place():
    assert aside(np.add(P, [0.0, -0.2, 0.3]), P) == pytest.approx(P - [0.0, AROUND, 0.0])
    assert np.linalg.norm(aside(P, P) - P) == pytest.approx(AROUND)
