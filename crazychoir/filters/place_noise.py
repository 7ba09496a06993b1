"""The noise of measured positions, found from the poses themselves."""

from typing import NamedTuple

from crazychoir.filters.rows import DIFFERENCE_ORDER, FilterRow
from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import clip


class PlaceNoise(NamedTuple):
    """How the noise of the positions is measured, and which noise the filter may assume."""

    start: float = 0.0005
    """m, standard deviation per axis before the first measurement."""
    least: float = 0.00005
    """m, least standard deviation per axis: a marker body of Vicon in flight."""
    most: float = 0.002
    """m, greatest standard deviation per axis."""
    memory: float = 1.0
    """s of measurements over which the variance is averaged, at any rate of the poses."""
    most_surprise: float = 9.0
    """Greatest ratio of one measurement to the mean; a wrong pose that is accepted counts no more."""
    uneven_share: float = 0.1
    """Share by which an interval between poses may differ from the one before."""


PLACE_NOISE = PlaceNoise()
DIFFERENCE_GAIN = 70.0
"""Variance of the fourth difference of white noise, over that of the noise: 1 + 16 + 36 + 16 + 1."""


@kernel()
def measure_place_noise(row: FilterRow, h: float) -> None:
    """Take an accepted pose into the variance of the positions per axis.

        r = mean of |D p_k|^2 / (3 * 70),   D p_k = p_k - 4 p_k-1 + 6 p_k-2 - 4 p_k-3 + p_k-4

    A flight hardly changes the fourth difference: 0.016 mm at 50 Hz for a snap of 100 m/s4. The mean
    begins with the first measurement, and then has the memory PLACE_NOISE.memory: a measurement weighs h over
    the time that is measured. Five poses in a row must be evenly spaced in time, otherwise nothing is measured.

    row: record of the filter
    h: s since the pose before
    """
    if abs(h - row.pose_interval) > PLACE_NOISE.uneven_share * h:
        row.even_poses = min(
            row.even_poses, 1
        )  # the pose before may be the first of five
    row.pose_interval = h
    squared = 0.0
    for c in range(3):
        difference = row.pose[c]
        for order in range(DIFFERENCE_ORDER):
            before = row.place_differences[order, c]
            row.place_differences[order, c] = difference
            difference = difference - before
        squared += difference * difference
    row.even_poses += 1
    if row.even_poses <= DIFFERENCE_ORDER:
        return
    row.noise_time = min(row.noise_time + h, max(PLACE_NOISE.memory, h))
    weight = h / row.noise_time
    mean = row.place_variance
    measured = min(squared / (3.0 * DIFFERENCE_GAIN), PLACE_NOISE.most_surprise * mean)
    row.place_variance = clip(
        mean + weight * (measured - mean),
        PLACE_NOISE.least**2,
        PLACE_NOISE.most**2,
    )
