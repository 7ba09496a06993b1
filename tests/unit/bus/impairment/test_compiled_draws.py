"""The compiled draws are those of random_draws, for each 64-bit word."""

import numba
import numpy as np
import pytest

from crazychoir.bus.impairment.compiled_draws import draw_word, split_threshold
from crazychoir.bus.impairment.random_draws import RANDOM_DRAWS, draw
from crazychoir.numerics.kernels import kernel

words = numba.types.Array(numba.uint64, 1, "C")


@kernel(words, words, words, words)
def draw_words(keys, numbers, attempts, drawn):
    """Write the draw of each key, number and attempt."""
    for k in range(keys.shape[0]):
        drawn[k] = draw_word(keys[k], numbers[k], attempts[k])


def test_compiled_draws_equal_those_in_python():
    random = np.random.default_rng(3)
    size = 20_000
    keys = random.integers(0, 1 << 64, size, dtype=np.uint64)
    numbers = random.integers(0, 1 << 40, size, dtype=np.uint64)
    attempts = random.integers(0, 9, size, dtype=np.uint64)
    keys[:3] = [0, (1 << 64) - 1, 1 << 63]
    drawn = np.zeros(size, np.uint64)
    draw_words(keys, numbers, attempts, drawn)
    wanted = map(draw, keys.tolist(), numbers.tolist(), attempts.tolist())
    assert drawn.tolist() == list(wanted)


@pytest.mark.parametrize("share", [0.0, 1e-30, 0.2, 0.5, 1.0 - 2.0**-53])
def test_the_threshold_of_a_share_is_that_of_the_simulated_network(share):
    assert split_threshold(share) == (round(share * RANDOM_DRAWS.range_size), 0)


def test_a_share_of_one_needs_a_flag():
    assert split_threshold(1.0) == (0, 1)
