"""One robot as the kernels of routing see it: matrices over nodes, windows, limits."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crazychoir.types import Mat, Vec


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A robot and M tasks. Nodes: 0..M-1 pickups, M..2M-1 deliveries, 2M where it starts, 2M + 1 where it ends.

    distance: (2M + 2, 2M + 2) m, what a route costs; column 2M + 1 is 0 in an open tour;
    duration: (2M + 2, 2M + 2) s from the beginning of service at v to the arrival at w: service at v, then the way;
    earliest, latest: (2M + 2,) s, when service may begin, 0 and inf where there are no windows; who is early waits;
    load: (M,), capacity: what is left of it beside the goods that stay on board;  limit: m, of the distance of a route;
    capable: (M,) bool, tasks that it may serve;  aboard: (M,) bool, tasks whose goods it carries from the start:
    their pickup is no stop, nobody else can serve them, and their load counts from the start;
    fixed: cost in m of leaving at all;  trips: how often it may start anew with its whole limit from where it ends
    (a robot that recharges there), at least 1.
    """

    distance: Mat
    duration: Mat
    earliest: Vec
    latest: Vec
    load: Vec
    capacity: float
    limit: float
    capable: npt.NDArray[np.bool_]
    aboard: npt.NDArray[np.bool_]
    fixed: float = 0.0
    trips: int = 1

    @property
    def tasks(self) -> int:
        """M."""
        return len(self.load)
