"""Random edges: both ends draw the same, and each end chooses with its share."""

import numpy as np
import pytest

from crazychoir.bus.impairment import random_draws
from crazychoir.guidance.formation.random_edges import RandomEdges


def test_edges_with_a_share_of_one_always_count():
    edges = RandomEdges(0, (1, 2), 1.0, 3)
    assert all(edges.counts(j, k) for j in (1, 2) for k in range(200))


def test_both_ends_must_choose_the_edge():
    ends = RandomEdges(0, (1,), 0.3, 5), RandomEdges(1, (0,), 0.3, 5)
    counted = [(ends[0].counts(1, k), ends[1].counts(0, k)) for k in range(5000)]
    assert all(one == other for one, other in counted)
    assert np.mean(counted) == pytest.approx(0.09, abs=0.015)


def test_another_seed_draws_other_edges():
    drawn = [
        [RandomEdges(0, (1,), 0.5, seed).counts(1, k) for k in range(100)]
        for seed in (1, 2)
    ]
    assert drawn[0] != drawn[1]


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_each_end_chooses_by_the_draw_of_its_key(share):
    edges = RandomEdges(2, (7,), share, 5)
    keys = random_draws.draw_key(5, 2, 7), random_draws.draw_key(5, 7, 2)
    for k in range(300):
        draws = [random_draws.draw(key, k, 0) / 2.0**64 for key in keys]
        assert edges.counts(7, k) == (max(draws) < share)
