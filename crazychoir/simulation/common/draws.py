"""Random numbers as functions of (seed, drone, use, number) alone.

There is no generator state, so the order of the calls does not change what is drawn.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel

Keys = npt.NDArray[np.uint64]


class SplitMix64(NamedTuple):
    """Constants of the generator SplitMix64 (Steele, Lea & Flood 2014)."""

    golden_gamma: np.uint64 = np.uint64(0x9E3779B97F4A7C15)
    """Increment of the state: 2^64 divided by the golden ratio."""
    first_multiplier: np.uint64 = np.uint64(0xBF58476D1CE4E5B9)
    """First multiplier of the mixing function."""
    second_multiplier: np.uint64 = np.uint64(0x94D049BB133111EB)
    """Second multiplier of the mixing function."""


SPLITMIX_64 = SplitMix64()


class RandomStreams(NamedTuple):
    """Uses of the random streams of a drone: each use has a stream of its own."""

    sensor_noise: int = 0
    """Noise of the inertial sensors."""
    sensor_bias: int = 1
    """Their biases."""
    gusts: int = 2
    """Gusts of wind."""
    motor_factors: int = 3
    """Differences between its motors."""
    disturbances: int = 4
    """Slow torques and forces."""
    pose_delay: int = 5
    """Delays of poses on their way to the estimators on board; one for all drones."""


RANDOM_STREAMS = RandomStreams()


SHIFT_8 = np.uint64(8)
SHIFT_16 = np.uint64(16)
SHIFT_27 = np.uint64(27)
SHIFT_30 = np.uint64(30)
SHIFT_31 = np.uint64(31)
SHIFT_32 = np.uint64(32)


class ByteSum(NamedTuple):
    """Masks and scale that turn 64 random bits into two sums of four bytes."""

    every_second_byte: np.uint64 = np.uint64(0x00FF00FF00FF00FF)
    """Mask of every second byte."""
    lowest_16_bits: np.uint64 = np.uint64(0xFFFF)
    """Mask of the lowest 16 bits."""
    scale: float = math.sqrt(3.0 / (256.0**2 - 1.0))
    """1 over the standard deviation of the sum of four uniform bytes."""


BYTE_SUM = ByteSum()


@kernel()
def scramble_bits(z: np.uint64) -> np.uint64:
    """Return 64 bits that look random; different z give different results.

    Source: SplitMix64, Steele, Lea & Flood 2014, OOPSLA: its n-th number is scramble(key + n
        SPLITMIX_64.golden_gamma).
    """
    z = (z ^ (z >> SHIFT_30)) * SPLITMIX_64.first_multiplier
    z = (z ^ (z >> SHIFT_27)) * SPLITMIX_64.second_multiplier
    return z ^ (z >> SHIFT_31)


@kernel()
def draw_normals(key: np.uint64, number: np.uint64) -> tuple[float, float]:
    """Return draw `number` of a stream: two values, each nearly standard normal.

    Each value is the scaled sum of four random bytes, so it lies within 3.46.
    """
    z = scramble_bits(key + SPLITMIX_64.golden_gamma * number)
    pairs = (z & BYTE_SUM.every_second_byte) + (
        (z >> SHIFT_8) & BYTE_SUM.every_second_byte
    )
    fours = pairs + (pairs >> SHIFT_16)
    return (np.int64(fours & BYTE_SUM.lowest_16_bits) - 510) * BYTE_SUM.scale, (
        np.int64((fours >> SHIFT_32) & BYTE_SUM.lowest_16_bits) - 510
    ) * BYTE_SUM.scale


def derive_stream_key(seed: int, use: int, drone: int) -> np.uint64:
    """Return the key of a drone's stream of random numbers for one of the RANDOM_STREAMS.

    seed: any whole number, not negative; its lowest 64 bits count
    """
    half = 1 << 63
    return _derive((seed + half) % (2 * half) - half, use, drone)


@kernel(numba.int64, numba.int64, numba.int64)
def _derive(seed: int, use: int, drone: int) -> np.uint64:
    """Return the key for a seed from -2^63 to 2^63 - 1."""
    key = scramble_bits(np.uint64(seed) + SPLITMIX_64.golden_gamma * np.uint64(use))
    return scramble_bits(key + SPLITMIX_64.golden_gamma * np.uint64(drone))


@kernel(numba.uint64, numba.int64)
def draw_uniform(key: np.uint64, number: int) -> float:
    """Return draw `number` of a stream, uniform in [-1, 1)."""
    return (
        np.int64(scramble_bits(key + SPLITMIX_64.golden_gamma * np.uint64(number)))
        / 9223372036854775808.0
    )
