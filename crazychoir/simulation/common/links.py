"""Links to drones of the lightweight world, which obey a thrust and three rates."""

import math
from collections.abc import Sequence
from typing import Protocol

from crazychoir.numerics.math3d import rotation
from crazychoir.types import Command, State, Vec


class RateWorld(Protocol):
    """A world in which each drone obeys four numbers."""

    def command(self, i: int, u: Vec | Sequence[float]) -> None:
        """Hold u (4,) = thrust N, rates rad/s for drone i from now on."""
        ...

    def cut(self, i: int) -> None:
        """Stop the motors of drone i for good."""
        ...

    def state(self, i: int) -> State:
        """Return a copy of the true state of drone i."""
        ...


class SimulatedLink:
    """The link to one drone of a world in this process."""

    def __init__(self, world: RateWorld, drone: int) -> None:
        self.world = world
        self.drone = drone

    def send(self, command: Command) -> None:
        """Let the drone hold this FPQR until the next command."""
        self.world.command(self.drone, self.inputs(command.flat))

    def inputs(self, flat: Vec) -> Vec | Sequence[float]:
        """Turn thrust N and body rates rad/s into the inputs that the world takes."""
        return flat

    def cut(self) -> None:
        """Stop the motors for good."""
        self.world.cut(self.drone)


class EulerRatesLink(SimulatedLink):
    """A link to a world with rates of the Euler angles as inputs, as in the paper.

    phi' = p + (q sin phi + r cos phi) tan theta
    theta' = q cos phi - r sin phi
    psi' = (q sin phi + r cos phi) / cos theta
    """

    def inputs(self, flat: Vec) -> Vec | Sequence[float]:
        """Turn thrust and body rates p, q, r into thrust and Euler-angle rates.

        The conversion uses the present attitude of the drone.
        """
        thrust, p, q, r = flat.tolist()
        # The last row of R = (-sin theta, sin phi cos theta, cos phi cos theta).
        x, y, z = rotation(self.world.state(self.drone).q)[2].tolist()
        phi = math.atan2(y, z)
        cos_theta = max(math.hypot(y, z), 1e-6)
        turn = q * math.sin(phi) + r * math.cos(phi)
        return [
            thrust,
            p - turn * x / cos_theta,
            q * math.cos(phi) - r * math.sin(phi),
            turn / cos_theta,
        ]
