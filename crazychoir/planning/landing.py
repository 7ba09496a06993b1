"""The way down."""

from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.types import FullState


class Landing:
    """First to rest, then straight down: however fast it flew, it touches the ground where it came to rest.

    stop: a flight that ends at rest;  down: one from there to the floor.  duration: s of both.
    """

    def __init__(self, stop: PointToPoint, down: PointToPoint) -> None:
        self.stop, self.down = stop, down
        self.duration = stop.duration + down.duration

    def sample(self, t: float) -> FullState:
        """The reference t seconds after the start."""
        late = t - self.stop.duration
        return self.stop.sample(t) if late < 0.0 else self.down.sample(late)

    def reaches(self, z: float) -> float:
        """s after the start at which it is, on its way down, at the height z m; to 1 ms."""
        early, late = self.stop.duration, self.duration
        while late - early > 1e-3:
            middle = 0.5 * (early + late)
            early, late = (middle, late) if self.sample(middle).p[2] > z else (early, middle)
        return late

    def done(self, t: float) -> bool:
        """Is the floor reached at t?"""
        return t >= self.duration
