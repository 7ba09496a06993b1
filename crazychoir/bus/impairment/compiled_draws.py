"""The draws of random_draws for kernels: of single messages, and of burst chains."""

import numpy as np

from crazychoir.bus.impairment.random_draws import DRAW_CONSTANTS, RANDOM_DRAWS
from crazychoir.numerics.kernels import kernel

# One operand that is not uint64 would turn the whole expression into float64.
ATTEMPT_INCREMENT = np.uint64(DRAW_CONSTANTS.attempt_increment)
NUMBER_INCREMENT = np.uint64(DRAW_CONSTANTS.number_increment)
FIRST_MULTIPLIER = np.uint64(DRAW_CONSTANTS.first_multiplier)
SECOND_MULTIPLIER = np.uint64(DRAW_CONSTANTS.second_multiplier)
BURST_SALT = np.uint64(DRAW_CONSTANTS.burst_salt)
START_SALT = np.uint64(DRAW_CONSTANTS.start_salt)
FIRST_SHIFT = np.uint64(30)  # bits
SECOND_SHIFT = np.uint64(27)  # bits
LAST_SHIFT = np.uint64(31)  # bits
UNIFORM_SHIFT = np.uint64(11)  # bits, to the 53 bits of a float
BLOCK_SIZE = RANDOM_DRAWS.block_size
EARLIER_BLOCKS = RANDOM_DRAWS.earlier_blocks
RANGE_SIZE = float(RANDOM_DRAWS.range_size)


@kernel()
def draw_word(key: np.uint64, number: np.uint64, attempt: np.uint64) -> np.uint64:
    """Return the same integer as random_draws.draw(key, number, attempt)."""
    z = key + number * NUMBER_INCREMENT + attempt * ATTEMPT_INCREMENT
    z = (z ^ (z >> FIRST_SHIFT)) * FIRST_MULTIPLIER
    z = (z ^ (z >> SECOND_SHIFT)) * SECOND_MULTIPLIER
    return z ^ (z >> LAST_SHIFT)


@kernel()
def draw_first_attempt(key: np.uint64, number: int) -> np.uint64:
    """Return the same integer as random_draws.draw(key, number, 0)."""
    return draw_word(key, np.uint64(number), np.uint64(0))


@kernel()
def is_bad_state(
    key: np.uint64, index: int, p_good_bad: float, p_bad_good: float
) -> bool:
    """Return whether the state of a burst chain is bad, as random_draws.bad_states.

    The last draw that decided gives the state; so only a few draws are computed.

    key: of the channel
    index: of the state
    p_good_bad: probability that good turns bad
    p_bad_good: probability that bad turns good
    """
    salted = key ^ BURST_SALT
    first = max(index // BLOCK_SIZE - EARLIER_BLOCKS, 0)
    for t in range(index, first * BLOCK_SIZE - 1, -1):
        u = np.float64(draw_first_attempt(salted, t) >> UNIFORM_SHIFT) * 2.0**-53
        if u < p_good_bad:
            return True
        if u >= 1.0 - p_bad_good:
            return False
    start = np.float64(draw_first_attempt(key ^ START_SALT, first))
    return bool(start * (p_good_bad + p_bad_good) < p_good_bad * RANGE_SIZE)


def split_threshold(share: float) -> tuple[int, int]:
    """Return the threshold of a probability as a word, and 1 if every draw is below it.

    A draw is below the threshold with this probability. That of probability 1 is 2^64, which no
    word holds.

    share: 0 to 1
    """
    threshold = round(share * RANDOM_DRAWS.range_size)
    is_always = threshold >= RANDOM_DRAWS.range_size
    return (0, 1) if is_always else (threshold, 0)
