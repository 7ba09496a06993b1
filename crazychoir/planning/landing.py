"""Flights of several legs, and the way down."""

from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.types import FullState


class Legs:
    """One flight after the other, each from where the one before comes to rest.

    duration: s of all.
    """

    def __init__(self, *legs: PointToPoint) -> None:
        self.legs = legs
        self.duration = sum(leg.duration for leg in legs)

    @property
    def last(self) -> PointToPoint:
        """The leg at whose goal it ends."""
        return self.legs[-1]

    def sample(self, t: float) -> FullState:
        """The reference t seconds after the start."""
        for leg in self.legs[:-1]:
            if t < leg.duration:
                return leg.sample(t)
            t -= leg.duration
        return self.last.sample(t)

    def done(self, t: float) -> bool:
        """Is the goal reached at t?"""
        return t >= self.duration


class Landing(Legs):
    """First to rest, then straight down: however fast it flew, it touches the ground where it came to rest.

    The last of its legs goes down.
    """

    def reaches(self, z: float) -> float:
        """s after the start at which it is, on its way down, at the height z m; to 1 ms."""
        early, late = self.duration - self.last.duration, self.duration
        while late - early > 1e-3:
            middle = 0.5 * (early + late)
            early, late = (middle, late) if self.sample(middle).p[2] > z else (early, middle)
        return late
