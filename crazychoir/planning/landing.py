"""Flights of several legs, and the way down."""

from dataclasses import dataclass

from crazychoir.planning.piecewise import Piecewise, join_pieces
from crazychoir.planning.point_to_point import PointToPoint


@dataclass(frozen=True, slots=True)
class Descent:
    """Where a way down ends, and how long it takes."""

    height: float = 0.0
    """m above the ground: height of the floor on which the drone lands."""
    duration: float = 0.0
    """s of the way down until the drone counts as landed, or 0: as fast as the limits allow.

    The limits may make it longer.
    """


STRAIGHT_DOWN = Descent()
"""To the ground, as fast as the limits allow."""


class FlightLegs(Piecewise):
    """Several flights, each from where the one before comes to rest."""

    def __init__(self, *legs: PointToPoint) -> None:
        flight = join_pieces(legs)
        last = legs[-1]
        super().__init__(flight.coefficients, flight.durations)
        self.legs = legs
        self._end[0:12] = last.sample(last.duration).flat[
            0:12
        ]  # equal to the last digit

    @property
    def last(self) -> PointToPoint:
        """The leg that ends at the goal."""
        return self.legs[-1]


class Landing(FlightLegs):
    """First to rest, then straight down.

    However fast the drone flew, it touches the ground where it came to rest. The last leg goes
    down.
    """

    def reaches(self, z: float) -> float:
        """Return s after the start when the descent is at the height z m, to 1 ms."""
        early = self.duration - self.last.duration
        late = self.duration
        while late - early > 1e-3:
            middle = 0.5 * (early + late)
            early, late = (
                (middle, late) if self.sample(middle).p[2] > z else (early, middle)
            )
        return late
