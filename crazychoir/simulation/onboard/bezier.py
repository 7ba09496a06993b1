"""Compressed trajectories: Bezier segments of 16-bit control points, as pieces that the planner flies."""

import math

import numpy as np
import numpy.typing as npt

from crazychoir.simulation.onboard.record import PIECE

AXES, MILLI, DECI = 4, 1e-3, math.radians(0.1)
"""x, y, z in mm, the heading in tenths of a degree."""
DEGREES = (0, 1, 3, 7)
"""Of a segment's axis, by its two bits: as many control points follow, behind the end of the segment before."""
_HEAD = 3
"""Bytes of a segment before its points: the kinds of its axes, its duration in ms."""


def expanded(memory: npt.NDArray[np.uint8], segments: int) -> npt.NDArray[np.float32]:
    """(n, 33) pieces of what lies at the beginning of the memory: a start, then at most so many segments.

        x(t) = sum_i B_i,n(t / T) P_i = sum_j c_j t^j
        c_j = n! / (n - j)! / T^j sum_i (-1)^(i + j) P_i / (i! (j - i)!)

    A segment without duration, or what does not fit into the memory, ends it.
    """
    raw = memory.tobytes()
    at = 2 * AXES
    last = np.frombuffer(raw, "<i2", AXES).astype(float)
    rows = []
    for _ in range(segments):
        if at + _HEAD > len(raw):
            break
        kinds = raw[at]
        ms = int.from_bytes(raw[at + 1 : at + _HEAD], "little")
        counts = [DEGREES[kinds >> 2 * axis & 0b11] for axis in range(AXES)]
        end = at + _HEAD + 2 * sum(counts)
        if ms == 0 or end > len(raw):
            break
        points = np.split(
            np.frombuffer(raw, "<i2", sum(counts), at + _HEAD).astype(float),
            np.cumsum(counts)[:-1],
        )
        row = np.zeros(PIECE, np.float32)
        for axis, behind in enumerate(points):
            curve = np.array([last[axis], *behind])
            unit = DECI if axis == AXES - 1 else MILLI
            row[8 * axis : 8 * axis + len(curve)] = power_basis(
                unit * curve, ms * MILLI
            )
            last[axis] = curve[-1]
        row[-1] = ms * MILLI
        at = end
        rows.append(row)
    return np.array(rows, np.float32).reshape(-1, PIECE)


def power_basis(
    points: npt.NDArray[np.float64], duration: float
) -> npt.NDArray[np.float64]:
    """Coefficients c_0 to c_n of the Bezier curve with n + 1 control points over so many s, see `expanded`."""
    n = len(points) - 1
    c = np.zeros(n + 1)
    for j in range(n + 1):
        terms = (
            (-1.0) ** (i + j) * points[i] / (math.factorial(i) * math.factorial(j - i))
            for i in range(j + 1)
        )
        c[j] = math.factorial(n) / math.factorial(n - j) * sum(terms) / duration**j
    return c
