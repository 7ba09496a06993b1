"""Values of the legs between all nodes of a robot; the legs between stops are shared by robots."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crazychoir.types import Ints, Mat, Vec


@dataclass(frozen=True, eq=False)
class Legs:
    """A value of each leg from a node to a node, in four blocks.

    The nodes are the 2M stops, then the start, then the end of the robot. Almost all values are
    those between stops. Robots for which these are equal hold the same array, so that a large team
    in one process needs it once.
    """

    between: Mat
    """(2M, 2M): between stops, from row to column."""
    to_stops: Mat
    """(2, 2M): from the start, and from the end, to each stop."""
    from_stops: Mat
    """(2M, 2): from each stop to the start, and to the end."""
    ends: Mat
    """(2, 2): between start and end."""

    @classmethod
    def of(cls, whole: Mat) -> "Legs":
        """Return the blocks of a matrix (2M + 2, 2M + 2); its nodes are in the order of the class."""
        s = len(whole) - 2
        return cls(whole[:s, :s], whole[s:, :s], whole[:s, s:], whole[s:, s:])

    @cached_property
    def whole(self) -> Mat:
        """(2M + 2, 2M + 2): all values in one array, made at the first use."""
        return np.ascontiguousarray(
            np.block([[self.between, self.from_stops], [self.to_stops, self.ends]])
        )

    @property
    def outer(self) -> tuple[Mat, Mat, Mat]:
        """The blocks in which the start or the end takes part."""
        return self.to_stops, self.from_stops, self.ends

    def at(self, v: int, w: int) -> float:
        """Return the value of the leg from node v to node w."""
        s = len(self.between)
        if v < s:
            return float(self.between[v, w] if w < s else self.from_stops[v, w - s])
        return float(self.to_stops[v - s, w] if w < s else self.ends[v - s, w - s])

    def most(self) -> float:
        """Return the largest value."""
        return max(
            float(block.max(initial=0.0)) for block in (self.between, *self.outer)
        )

    def only(self, stops: Ints) -> "Legs":
        """Return the legs between these stops, (2K,), the start and the end."""
        return Legs(
            np.ascontiguousarray(self.between[np.ix_(stops, stops)]),
            self.to_stops[:, stops],
            self.from_stops[stops],
            self.ends,
        )


def measure_distances(a: Mat, b: Mat) -> Mat:
    """Return the (A, B) distances in m from the points a, (A, d), to the points b, (B, d)."""
    squares = np.zeros((len(a), len(b)))
    for axis in range(a.shape[1]):
        squares += (a[:, None, axis] - b[None, :, axis]) ** 2
    return np.asarray(np.sqrt(squares))


def measure_durations(distance: Legs, between: Mat, service: Vec, speed: float) -> Legs:
    """Return the s from the begin of service at v to the arrival at w.

        duration_vw = service_v + distance_vw / speed

    distance: of the legs, m.
    between: (2M, 2M) s, the durations between stops.
    service: (2M,) s, at the stops; 0 at start and end.
    speed: m/s.
    """
    return Legs(
        between,
        distance.to_stops / speed,
        service[:, None] + distance.from_stops / speed,
        distance.ends / speed,
    )
