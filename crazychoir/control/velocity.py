"""Velocity control: from a reference to a velocity, for drones that control their velocity on board."""

import math

import numpy as np

from crazychoir.control.controller import EARLY, CrazyflieController
from crazychoir.control.handlers import TrajectoryHandler
from crazychoir.control.senders import CommunicationHandler
from crazychoir.math3d import Vec, finite, kernel, memory, real, vector, wrap
from crazychoir.types import Command, Reference, State


@kernel(vector, vector, vector, real, memory)
def _velocity(x: Vec, ref: Vec, gains: Vec, heading: float, out: Vec) -> bool:
    """The law of VelocityCtrlStrategy; gains: (4,) = kp, kd, k_yaw, largest speed."""
    if not (finite(x) and finite(ref)):
        return False
    squares = 0.0
    for c in range(3):
        out[c] = ref[3 + c] + gains[0] * (ref[c] - x[c]) + gains[1] * (ref[3 + c] - x[3 + c])
        squares += out[c] ** 2
    share = min(1.0, gains[3] / math.sqrt(squares)) if squares > 0.0 else 1.0
    for c in range(3):
        out[c] *= share
    out[3] = ref[13] + gains[2] * wrap(ref[12] - heading)
    return True


class VelocityCtrlStrategy:
    """Proportional-derivative control of the place by a velocity.

        u = v_d + kp (p_d - p) + kd (v_d - v),   yaw' = yaw_d' + k_yaw (yaw_d - yaw), the short way

    kp, k_yaw: 1/s;  kd: 1;  v_max: m/s, the longest u.
    """

    def __init__(self, kp: float = 1.5, kd: float = 0.1, k_yaw: float = 2.0, v_max: float = 3.0) -> None:
        self._gains = np.array([kp, kd, k_yaw, v_max])

    def velocity(self, state: State, reference: Vec) -> Vec | None:
        """A new u (4,) = velocity m/s world, yaw rate rad/s; None if state or reference (14,) is not finite."""
        x, y, z, w = state.flat[6:10].tolist()
        heading = math.atan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z))
        out = np.empty(4)
        return out if _velocity(state.flat, reference, self._gains, heading, out) else None


class VelocityController(CrazyflieController):
    """Flies references by velocities."""

    def __init__(
        self, strategy: VelocityCtrlStrategy, command_sender: CommunicationHandler, traj_handler: TrajectoryHandler
    ) -> None:
        super().__init__(command_sender, traj_handler)
        self.strategy = strategy

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """The velocity of the strategy."""
        return self.strategy.velocity(state, reference)

    def blind(self) -> Vec:
        """No velocity."""
        return np.zeros(4)


class WaypointController(CrazyflieController):
    """Flies references by the planner on board: every `every` s a straight line to where the reference will be.

        p_c = p_d + v_d T + a_d T^2 / 2,   yaw_c = yaw_d + yaw_d' T,   T = ahead

    The planner is at p_c at now + T and the next line begins before that, so it flies along the reference, but for the
    corners between lines.  every, ahead: s.
    """

    def __init__(
        self, command_sender: CommunicationHandler, traj_handler: TrajectoryHandler, every: float = 0.1,
        ahead: float = 0.2,
    ) -> None:  # fmt: skip
        super().__init__(command_sender, traj_handler)
        self.every, self.ahead = every, ahead
        self._next, self._line = -math.inf, np.zeros(5)

    def command(self, state: State, reference: Reference | None, now: float) -> Command | None:
        """The next line if it is time for it."""
        if now < self._next - EARLY:
            return None
        self._next = now + self.every
        return super().command(state, reference, now)

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Place, yaw, duration (5,)."""
        t = self.ahead
        line = np.empty(5)
        line[0:3] = reference[0:3] + t * reference[3:6] + 0.5 * t * t * reference[6:9]
        line[3], line[4] = reference[12] + t * reference[13], t
        if not math.isfinite(sum(line.tolist())):
            return None
        self._line = line
        return line

    def blind(self) -> Vec:
        """The last line again: the planner on board needs no state from here."""
        return self._line
