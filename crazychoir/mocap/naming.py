"""Which body is which drone's: a proposal, by where they stand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from crazychoir.mocap.frames import Frame
from crazychoir.types import Vec

FAR = 0.3
"""m from its home beyond which a drone is not taken to stand there."""


@dataclass(frozen=True)
class Seen:
    """What was seen of a body: its mean place (3,) m, how far it was from there, m, its rate, Hz."""

    name: str
    p: Vec
    spread: float
    rate: float


@dataclass(frozen=True)
class Match:
    """The drone that a body is taken for, and its distance from that one's home, m."""

    drone: int
    name: str
    distance: float

    @property
    def sure(self) -> bool:
        """Whether it stands near enough."""
        return self.distance <= FAR


def bodies(frames: Sequence[Frame], seconds: float) -> list[Seen]:
    """All that was seen in so many s, by name."""
    places: dict[str, list[Vec]] = {}
    for frame in frames:
        for name, flat in frame.bodies.items():
            places.setdefault(name, []).append(flat[0:3])
    return [_seen(name, np.array(at), seconds) for name, at in sorted(places.items())]


def _seen(name: str, at: Vec, seconds: float) -> Seen:
    p = at.mean(axis=0)
    return Seen(name, p, float(np.linalg.norm(at - p, axis=1).max()), len(at) / seconds)


def matched(seen: Sequence[Seen], homes: Mapping[int, Sequence[float]]) -> list[Match]:
    """One body a drone, such that the sum of their distances is least; drones are left over if bodies are few.

        min sum_i |p_m(i) - h_i|,  m one to one

    homes: h_i (3,) m, where drone i stands. A height counts as the rest: who wants to find swapped drones on two levels
    needs it.
    """
    if not seen or not homes:
        return []
    ids = sorted(homes)
    cost = np.array(
        [
            [float(np.linalg.norm(body.p - np.asarray(homes[i]))) for body in seen]
            for i in ids
        ]
    )
    rows, columns = linear_sum_assignment(cost)
    return [
        Match(ids[r], seen[c].name, float(cost[r, c]))
        for r, c in zip(rows, columns, strict=True)
    ]
