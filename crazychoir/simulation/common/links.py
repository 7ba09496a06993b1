"""Links to drones of the lightweight world, which obey a thrust and three rates."""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from crazychoir.numerics.kernels import kernel, memory, vector
from crazychoir.numerics.math3d import rotation_columns
from crazychoir.types import Command, State, Vec


@kernel(vector, vector, memory)
def convert_to_euler_rates(q: Vec, flat: Vec, out: Vec) -> None:
    """Write the thrust and the Euler-angle rates of a drone with these body rates.

        phi' = p + (q sin phi + r cos phi) tan theta
        theta' = q cos phi - r sin phi
        psi' = (q sin phi + r cos phi) / cos theta

    q: (4,): attitude
    flat: (4,): thrust N, body rates rad/s
    out: (4,): thrust N, rates rad/s of phi, theta and psi
    """
    x_axis, y_axis, z_axis = rotation_columns((q[0], q[1], q[2], q[3]))
    # The last row of R = (-sin theta, sin phi cos theta, cos phi cos theta).
    x = x_axis[2]
    y = y_axis[2]
    z = z_axis[2]
    phi = math.atan2(y, z)
    cos_theta = max(math.hypot(y, z), 1e-6)
    turn = flat[2] * math.sin(phi) + flat[3] * math.cos(phi)
    out[0] = flat[0]
    out[1] = flat[1] - turn * x / cos_theta
    out[2] = flat[2] * math.cos(phi) - flat[3] * math.sin(phi)
    out[3] = turn / cos_theta


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
    """A link to a world with rates of the Euler angles as inputs, as in the paper."""

    def inputs(self, flat: Vec) -> Vec | Sequence[float]:
        """Turn thrust and body rates p, q, r into thrust and Euler-angle rates.

        The conversion uses the present attitude of the drone.
        """
        rates = np.empty(4)
        convert_to_euler_rates(self.world.state(self.drone).q, flat, rates)
        return rates
