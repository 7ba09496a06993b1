"""Compressed trajectories: Bezier segments of 16-bit control points, turned into planner pieces."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crazychoir.firmware.memories import TRAJECTORY_MEMORY


@dataclass(frozen=True, slots=True)
class CompressedFormat:
    """Numbers in a segment of a compressed trajectory."""

    axis_count: int = 4
    """Axes of a segment: x, y, z and the heading."""
    milli_unit: float = 1e-3
    """m a unit of x, y and z (mm); s a unit of the duration (ms)."""
    angle_unit: float = math.radians(0.1)
    """rad a unit of the heading (tenths of a degree)."""
    axis_degrees: tuple[int, ...] = (0, 1, 3, 7)
    """Degree of an axis of a segment, by its two bits.

    It is also the count of control points that follow; the first point is the end of the segment
    before.
    """


COMPRESSED_FORMAT = CompressedFormat()


_SEGMENT_HEADER_SIZE = 3
"""Bytes of a segment before its points: the degrees of its axes, its duration in ms."""


def expand_segments(
    memory: npt.NDArray[np.uint8], segments: int
) -> npt.NDArray[np.float32]:
    """Return the (n, 33) pieces at the beginning of the memory: a start, then at most `segments`.

        x(t) = sum_i B_i,n(t / T) P_i = sum_j c_j t^j
        c_j = n! / (n - j)! / T^j sum_i (-1)^(i + j) P_i / (i! (j - i)!)

    The first segment without duration, or beyond the end of the memory, ends the trajectory.
    """
    raw = memory.tobytes()
    at = 2 * COMPRESSED_FORMAT.axis_count
    last = np.frombuffer(raw, "<i2", COMPRESSED_FORMAT.axis_count).astype(float)
    rows = []
    for _ in range(segments):
        if at + _SEGMENT_HEADER_SIZE > len(raw):
            break
        kinds = raw[at]
        ms = int.from_bytes(raw[at + 1 : at + _SEGMENT_HEADER_SIZE], "little")
        counts = [
            COMPRESSED_FORMAT.axis_degrees[kinds >> 2 * axis & 0b11]
            for axis in range(COMPRESSED_FORMAT.axis_count)
        ]
        end = at + _SEGMENT_HEADER_SIZE + 2 * sum(counts)
        if ms == 0 or end > len(raw):
            break
        points = np.split(
            np.frombuffer(raw, "<i2", sum(counts), at + _SEGMENT_HEADER_SIZE).astype(
                float
            ),
            np.cumsum(counts)[:-1],
        )
        row = np.zeros(TRAJECTORY_MEMORY.piece_size, np.float32)
        for axis, behind in enumerate(points):
            curve = np.array([last[axis], *behind])
            unit = (
                COMPRESSED_FORMAT.angle_unit
                if axis == COMPRESSED_FORMAT.axis_count - 1
                else COMPRESSED_FORMAT.milli_unit
            )
            row[8 * axis : 8 * axis + len(curve)] = convert_to_power_basis(
                unit * curve, ms * COMPRESSED_FORMAT.milli_unit
            )
            last[axis] = curve[-1]
        row[-1] = ms * COMPRESSED_FORMAT.milli_unit
        at = end
        rows.append(row)
    return np.array(rows, np.float32).reshape(-1, TRAJECTORY_MEMORY.piece_size)


def convert_to_power_basis(
    points: npt.NDArray[np.float64], duration: float
) -> npt.NDArray[np.float64]:
    """Return the coefficients c_0 to c_n of a Bezier curve, see `expand_segments`.

    points: (n + 1,): control points
    duration: s
    """
    n = len(points) - 1
    c = np.zeros(n + 1)
    for j in range(n + 1):
        terms = (
            (-1.0) ** (i + j) * points[i] / (math.factorial(i) * math.factorial(j - i))
            for i in range(j + 1)
        )
        c[j] = math.factorial(n) / math.factorial(n - j) * sum(terms) / duration**j
    return c
