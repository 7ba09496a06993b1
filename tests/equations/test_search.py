"""The random numbers of the search."""

import numpy as np
import pytest

from crazychoir.routing.search.annealing import draw_exponential
from crazychoir.routing.search.ruin import draw_fraction


def test_draw_is_splitmix64():
    # The first words of the published generator from the seed 1234567.
    words = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    random = np.array([1234567], np.uint64)
    assert [draw_fraction(random) for _ in words] == [
        ((word >> 11) + 0.5) * 2.0**-53 for word in words
    ]


def test_exponential_is_minus_the_logarithm_of_the_uniform_number():
    one, other = np.array([3], np.uint64), np.array([3], np.uint64)
    for _ in range(1000):
        assert draw_exponential(one) == pytest.approx(
            -np.log(draw_fraction(other)), rel=1e-13, abs=1e-15
        )
