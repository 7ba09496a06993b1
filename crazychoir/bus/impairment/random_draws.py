"""Random numbers as a pure function of a key and counters: any of
them can be computed in any order, in any process.

Source of the mixing function: Steele, Lea & Flood 2014, OOPSLA (SplitMix64).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class RandomDraws:
    """The range of a draw, and the blocks in which burst chains are computed."""

    range_size: int = 1 << 64
    """Number of values of a draw: draws are integers from 0 to range_size - 1."""
    block_size: int = 256
    """States of a burst chain that are computed together."""
    kept_blocks: int = 4
    """Blocks of a burst chain that are kept."""
    earlier_blocks: int = 8
    """Earlier blocks that are searched for the draw that decided a state."""


RANDOM_DRAWS = RandomDraws()


@dataclass(frozen=True, slots=True)
class DrawConstants:
    """Constants of the draws: those of SplitMix64, and the salts of burst chains."""

    word_mask: int = RANDOM_DRAWS.range_size - 1
    """The lowest 64 bits."""
    number_increment: int = 0x9E3779B97F4A7C15
    """SplitMix64 increment, times the number."""
    attempt_increment: int = 0xD1342543DE82EF95
    """Increment, times the attempt."""
    first_multiplier: int = 0xBF58476D1CE4E5B9
    """First multiplier of SplitMix64."""
    second_multiplier: int = 0x94D049BB133111EB
    """Second multiplier of SplitMix64."""
    burst_salt: int = 0x6A09E667F3BCC909
    """Salt of the burst chain."""
    start_salt: int = 0xBB67AE8584CAA73B
    """Salt of its stationary start."""


DRAW_CONSTANTS = DrawConstants()


def draw_key(*parts: object) -> int:
    """Return the 64-bit key of numbers and strings, equal in every process."""
    return int.from_bytes(
        blake2b(repr(parts).encode(), digest_size=8).digest(), "little"
    )


def draw_edge_keys(
    seed: int, sources: Sequence[int], destination: int, channel: str
) -> npt.NDArray[np.uint64]:
    """Return draw_key(seed, source, destination, channel) of many sources, (n,)."""
    end = f", {destination!r}, {channel!r})"
    begin = f"({seed!r}, "
    digests = [
        blake2b(f"{begin}{source}{end}".encode(), digest_size=8).digest()
        for source in sources
    ]
    return np.frombuffer(b"".join(digests), "<u8")


def draw(key: int, number: int, attempt: int) -> int:
    """Return a uniform integer in 0 .. RANDOM_DRAWS.range_size - 1."""
    z = (
        key
        + number * DRAW_CONSTANTS.number_increment
        + attempt * DRAW_CONSTANTS.attempt_increment
    ) & DRAW_CONSTANTS.word_mask
    z = ((z ^ (z >> 30)) * DRAW_CONSTANTS.first_multiplier) & DRAW_CONSTANTS.word_mask
    z = ((z ^ (z >> 27)) * DRAW_CONSTANTS.second_multiplier) & DRAW_CONSTANTS.word_mask
    return z ^ (z >> 31)


def bad_states(key: int, block: int, p_good_bad: float, p_bad_good: float) -> bytes:
    """Return a block of states of the Gilbert-Elliott chain, one byte each: 1 bad, 0 good.

    It begins at the index RANDOM_DRAWS.block_size * block.

        u_t < p_gb: bad;   u_t >= 1 - p_bg: good;   else as at t - 1         (p_gb + p_bg <= 1)

    u_t: the draw of index t

    Good turns bad with p_gb, and bad turns good with p_bg. The state at t follows from the last
    draw that decided, so no process needs to walk from 0. If no draw in the last
    RANDOM_DRAWS.earlier_blocks blocks decided, the state is drawn from the stationary law,
    P(bad) = p_gb / (p_gb + p_bg).
    """
    decided, bad = _find_decisions(key, block, p_good_bad, p_bad_good)
    cause = np.maximum.accumulate(
        np.where(decided, np.arange(RANDOM_DRAWS.block_size), -1)
    )
    states = np.where(
        cause >= 0,
        bad[cause],
        _state_before(key, block, p_good_bad, p_bad_good) if cause[0] < 0 else False,
    )
    return states.astype(np.uint8).tobytes()


def _state_before(key: int, block: int, p_good_bad: float, p_bad_good: float) -> bool:
    first = max(block - RANDOM_DRAWS.earlier_blocks, 0)
    for earlier in range(block - 1, first - 1, -1):
        decided, bad = _find_decisions(key, earlier, p_good_bad, p_bad_good)
        if decided.any():
            return bool(bad[np.flatnonzero(decided)[-1]])
    return (
        draw(key ^ DRAW_CONSTANTS.start_salt, first, 0) * (p_good_bad + p_bad_good)
        < p_good_bad * RANDOM_DRAWS.range_size
    )


def _find_decisions(
    key: int, block: int, p_good_bad: float, p_bad_good: float
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return two masks over a block: the indices that decide the
    state, and the indices that decide for bad.
    """
    u = _draw_uniforms(key ^ DRAW_CONSTANTS.burst_salt, block * RANDOM_DRAWS.block_size)
    bad = u < p_good_bad
    return bad | (u >= 1.0 - p_bad_good), bad


def _draw_uniforms(key: int, first: int) -> npt.NDArray[np.float64]:
    """Return the draws of a block from `first` on, in [0, 1)."""
    start = np.uint64(
        (key + first * DRAW_CONSTANTS.number_increment) & DRAW_CONSTANTS.word_mask
    )
    z = start + np.arange(RANDOM_DRAWS.block_size, dtype=np.uint64) * np.uint64(
        DRAW_CONSTANTS.number_increment
    )
    z = (z ^ (z >> np.uint64(30))) * np.uint64(DRAW_CONSTANTS.first_multiplier)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(DRAW_CONSTANTS.second_multiplier)
    z ^= z >> np.uint64(31)
    return (z >> np.uint64(11)).astype(np.float64) * 2.0**-53
