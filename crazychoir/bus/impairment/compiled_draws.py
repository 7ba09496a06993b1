"""The random draws of the simulated network as a part of kernels: the words of `random_draws.draw`."""

from typing import NamedTuple

import numpy as np

from crazychoir.bus.impairment.random_draws import RANDOM_DRAWS
from crazychoir.numerics.kernels import kernel


class _CompiledDrawConstants(NamedTuple):
    """Constants of the draws as 64-bit words: with other integers numba would compute in floats."""

    number_increment: np.uint64 = np.uint64(0x9E3779B97F4A7C15)
    """SplitMix64 increment, times the number."""
    attempt_increment: np.uint64 = np.uint64(0xD1342543DE82EF95)
    """Increment, times the attempt."""
    first_multiplier: np.uint64 = np.uint64(0xBF58476D1CE4E5B9)
    """First multiplier of SplitMix64."""
    second_multiplier: np.uint64 = np.uint64(0x94D049BB133111EB)
    """Second multiplier of SplitMix64."""
    shift_30: np.uint64 = np.uint64(30)
    """First shift."""
    shift_27: np.uint64 = np.uint64(27)
    """Second shift."""
    shift_31: np.uint64 = np.uint64(31)
    """Third shift."""


_DRAW_WORDS = _CompiledDrawConstants()


@kernel()
def draw_word(key: np.uint64, number: np.uint64, attempt: np.uint64) -> np.uint64:
    """Return `random_draws.draw(key, number, attempt)`, a uniform 64-bit word."""
    z = (
        key
        + number * _DRAW_WORDS.number_increment
        + attempt * _DRAW_WORDS.attempt_increment
    )
    z = (z ^ (z >> _DRAW_WORDS.shift_30)) * _DRAW_WORDS.first_multiplier
    z = (z ^ (z >> _DRAW_WORDS.shift_27)) * _DRAW_WORDS.second_multiplier
    return z ^ (z >> _DRAW_WORDS.shift_31)


def split_threshold(share: float) -> tuple[int, int]:
    """Return the threshold of a probability as a word, and 1 if every draw is below it.

    A draw is below the threshold with this probability. That of probability 1 is 2^64, which no
    word holds.

    share: 0 to 1
    """
    threshold = round(share * RANDOM_DRAWS.range_size)
    is_always = threshold >= RANDOM_DRAWS.range_size
    return (0, 1) if is_always else (threshold, 0)
