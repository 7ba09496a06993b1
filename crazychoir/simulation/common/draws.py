"""Random numbers as functions of (seed, drone, use, number) alone.

There is no generator state, so the order of the calls does not change what is drawn.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel

Keys = npt.NDArray[np.uint64]

GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # increment of SplitMix64
FIRST = np.uint64(0xBF58476D1CE4E5B9)  # first multiplier of SplitMix64
SECOND = np.uint64(0x94D049BB133111EB)  # second multiplier of SplitMix64
S8, S16, S27, S30, S31, S32 = (np.uint64(n) for n in (8, 16, 27, 30, 31, 32))
BYTES = np.uint64(0x00FF00FF00FF00FF)  # mask of every second byte
LOW = np.uint64(0xFFFF)  # mask of the lowest 16 bits
SCALE = math.sqrt(
    3.0 / (256.0**2 - 1.0)
)  # 1 over the standard deviation of the sum of four uniform bytes


@kernel()
def scramble(z: np.uint64) -> np.uint64:
    """Return 64 bits that look random; different z give different results.

    Source: SplitMix64, Steele, Lea & Flood 2014, OOPSLA: its n-th number is scramble(key + n
        GOLDEN).
    """
    z = (z ^ (z >> S30)) * FIRST
    z = (z ^ (z >> S27)) * SECOND
    return z ^ (z >> S31)


@kernel()
def normals(key: np.uint64, number: np.uint64) -> tuple[float, float]:
    """Return draw `number` of a stream: two values, each nearly standard normal.

    Each value is the scaled sum of four random bytes, so it lies within 3.46.
    """
    z = scramble(key + GOLDEN * number)
    pairs = (z & BYTES) + ((z >> S8) & BYTES)
    fours = pairs + (pairs >> S16)
    return (np.int64(fours & LOW) - 510) * SCALE, (
        np.int64((fours >> S32) & LOW) - 510
    ) * SCALE


@kernel(numba.int64, numba.int64, numba.int64)
def stream(seed: int, use: int, drone: int) -> np.uint64:
    """Return the key of a drone's stream of random numbers for one use."""
    key = scramble(np.uint64(seed) + GOLDEN * np.uint64(use))
    return scramble(key + GOLDEN * np.uint64(drone))


@kernel(numba.uint64, numba.int64)
def uniform(key: np.uint64, number: int) -> float:
    """Return draw `number` of a stream, uniform in [-1, 1)."""
    return np.int64(scramble(key + GOLDEN * np.uint64(number))) / 9223372036854775808.0
