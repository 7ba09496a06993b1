"""Velocity control: from a reference to a velocity, for drones with velocity control on board."""

import math
from typing import NamedTuple

import numpy as np

from crazychoir.control.controller import CrazyflieController
from crazychoir.control.handlers import TrajectoryHandler
from crazychoir.control.rows import EARLY_TOLERANCE
from crazychoir.control.senders import CommunicationHandler
from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.numerics.math3d import STANDARD_GRAVITY, is_finite, wrap_angle
from crazychoir.types import Command, Reference, State, Vec


class FirmwareGains(NamedTuple):
    """Gains of the firmware's own control of velocity, position and yaw."""

    velocity: float = math.radians(25.0) * STANDARD_GRAVITY
    """1/s, kp of the firmware's control of a velocity by a tilt."""
    position: float = 2.0
    """1/s, kp of the firmware's control of a place by a velocity."""
    yaw: float = 6.0
    """1/s, kp of the firmware's control of the yaw by a rate."""


FIRMWARE_GAINS = FirmwareGains()


NEW_FLIGHT_GAP = 1.0
"""Seconds without a line after which the next line begins another flight."""
FIRMWARE_LEARNING_RATES = np.array([0.5, 1.0]) / (
    FIRMWARE_GAINS.position,
    FIRMWARE_GAINS.yaw,
)
"""1/s, ki / kp of the firmware's control of the height and of the yaw."""


@kernel(vector, vector, vector, real, memory)
def _compute_velocity(x: Vec, ref: Vec, gains: Vec, heading: float, out: Vec) -> bool:
    """Apply the law of VelocityCtrlStrategy.

    x: (13,): state
    ref: (14,): reference
    gains: (4,): kp, kd, k_yaw, largest speed
    heading: rad
    out: (4,): the result
    Returns False if x or ref is not finite.
    """
    if not (is_finite(x) and is_finite(ref)):
        return False
    squares = 0.0
    for c in range(3):
        ahead = ref[6 + c] / FIRMWARE_GAINS.velocity if c < 2 else 0.0
        out[c] = (
            ref[3 + c]
            + ahead
            + gains[0] * (ref[c] - x[c])
            + gains[1] * (ref[3 + c] - x[3 + c])
        )
        squares += out[c] ** 2
    share = min(1.0, gains[3] / math.sqrt(squares)) if squares > 0.0 else 1.0
    for c in range(3):
        out[c] *= share
    out[3] = ref[13] + gains[2] * wrap_angle(ref[12] - heading)
    return True


class VelocityCtrlStrategy:
    """Proportional-derivative control of the position by a velocity.

        u = v_d + S a_d / k_v + kp (p_d - p) + kd (v_d - v)
        yaw' = yaw_d' + k_yaw (yaw_d - yaw), the short way

    S a_d: horizontal part of a_d; the firmware makes an acceleration of a velocity error by its
        gain k_v in 1/s
    kp: 1/s
    kd: 1
    k_yaw: 1/s
    v_max: m/s, largest |u|
    """

    def __init__(
        self, kp: float = 2.0, kd: float = 0.1, k_yaw: float = 2.0, v_max: float = 3.0
    ) -> None:
        self._gains = np.array([kp, kd, k_yaw, v_max])

    def velocity(self, state: State, reference: Vec) -> Vec | None:
        """Return a new u (4,): velocity m/s world, yaw rate rad/s.

        Returns None if state or reference (14,) is not finite.
        """
        x, y, z, w = state.flat[6:10].tolist()
        heading = math.atan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z))
        out = np.empty(4)
        return (
            out
            if _compute_velocity(state.flat, reference, self._gains, heading, out)
            else None
        )


class VelocityController(CrazyflieController):
    """Flies references by velocities."""

    def __init__(
        self,
        strategy: VelocityCtrlStrategy,
        command_sender: CommunicationHandler,
        traj_handler: TrajectoryHandler,
    ) -> None:
        super().__init__(command_sender, traj_handler)
        self.strategy = strategy

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the velocity of the strategy."""
        return self.strategy.velocity(state, reference)

    def blind(self) -> Vec:
        """Return zero velocity."""
        return np.zeros(4)


class LearntIntegrals:
    """Model of the integrals of height and yaw in the firmware, which learn a lasting climb and turn."""

    def __init__(self) -> None:
        self._learnt = np.zeros(2)
        self._asked = math.inf

    def missing(self, climb: float, turn: float, now: float) -> tuple[float, float]:
        """Return the parts of a climb in m/s and a turn in rad/s that the integrals lack.

        On the ground the integrals are reset.
        """
        h = now - self._asked
        self._asked = now
        if 0.0 <= h < NEW_FLIGHT_GAP:
            self._learnt += (np.array([climb, turn]) - self._learnt) * -np.expm1(
                -h * FIRMWARE_LEARNING_RATES
            )
        else:
            self._learnt[:] = 0.0
        return climb - float(self._learnt[0]), turn - float(self._learnt[1])


class FullStateController(CrazyflieController):
    """Passes references on to the firmware, which flies them with its PIDs and its own estimate.

        p_c = p_d(T) + (v_d(T) - u e3 + S a_d / k_v) / k_p
        yaw_c = yaw_d(T) + (yaw_d' - w) / k_yaw
        T = late

    The firmware computes a velocity from the distance to the commanded place only, so this place
    lies ahead of the reference. Symbols are as in WaypointController.

    late: s, delay of the command and of the drone behind its set-points
    """

    def __init__(
        self,
        command_sender: CommunicationHandler,
        traj_handler: TrajectoryHandler,
        late: float = 0.05,
    ) -> None:
        super().__init__(command_sender, traj_handler)
        self.late = late
        self._learnt = LearntIntegrals()

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the reference (14,), moved ahead."""
        if not is_finite(reference):
            return None
        t = self.late
        a = reference[6:9]
        rate = float(reference[13])
        out = reference.copy()
        out[3:6] += t * a
        v = out[3:6]
        climb, turn = self._learnt.missing(float(v[2]), rate, now)
        out[0:3] += t * v - 0.5 * t * t * a
        out[0:2] += (
            v[0:2] + a[0:2] / FIRMWARE_GAINS.velocity
        ) / FIRMWARE_GAINS.position
        out[2] += climb / FIRMWARE_GAINS.position
        out[12] += t * rate + turn / FIRMWARE_GAINS.yaw
        return out

    def blind(self) -> Vec:
        """Return the last reference again: the firmware needs no state from here."""
        last = self.last
        return np.zeros(14) if last is None else last


class WaypointController(CrazyflieController):
    """Flies references by the planner on board: sends a straight line to a place ahead, again and again.

        p_c = p_d(T) + (v_d(T) - u e3 + S a_d / k_v) / k_p
        yaw_c = yaw_d(T) + (yaw_d' - w) / k_yaw
        p_d(T) = p_d + v_d T + a_d T^2 / 2,   v_d(T) = v_d + a_d T,   yaw_d(T) = yaw_d + yaw_d' T
        T = ahead + late
        u' = (v_d(T)_z - u) k_i / k_p,   w' = (yaw_d' - w) k_i / k_yaw

    A line ends at p_c `ahead` s after it has arrived, and the next line replaces it before. So the
    set-point of the planner moves along p_c, except at the corners between lines.

    The firmware computes a velocity only from the distance to its set-point, by k_p. A drone that
    flies at v is therefore v / k_p behind its set-point, and the set-point is sent ahead by as much.
    The yaw is treated in the same way. The firmware's integrals of height and yaw learn a lasting
    climb u and turn w, which need no lead. S a_d is as in VelocityCtrlStrategy.

    every: s, between two lines
    ahead: s, duration of a line
    late: s, delay of the command, of the planner's tick, and of the drone behind its set-points
    k_v, k_p, k_yaw: 1/s, of the control on board
    k_i: 1/s2, of its height and its yaw
    """

    def __init__(
        self,
        command_sender: CommunicationHandler,
        traj_handler: TrajectoryHandler,
        every: float = 0.1,
        ahead: float = 0.2,
        late: float = 0.05,
    ) -> None:
        super().__init__(command_sender, traj_handler)
        self.every = every
        self.ahead = ahead
        self.late = late
        self._next = -math.inf
        self._line = np.zeros(5)
        self._learnt = LearntIntegrals()

    def command(
        self, state: State, reference: Reference | None, now: float
    ) -> Command | None:
        """Return the next line if it is time for it; else None."""
        if now < self._next - EARLY_TOLERANCE:
            return None
        self._next = now + self.every
        return super().command(state, reference, now)

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return (5,): place m, yaw rad, duration s."""
        t = self.ahead + self.late
        a = reference[6:9]
        rate = float(reference[13])
        v = reference[3:6] + t * a
        line = np.empty(5)
        line[0:3] = reference[0:3] + t * v - 0.5 * t * t * a
        line[0:2] += (
            v[0:2] + a[0:2] / FIRMWARE_GAINS.velocity
        ) / FIRMWARE_GAINS.position
        line[3] = reference[12] + t * rate
        line[4] = self.ahead
        if not math.isfinite(sum(line.tolist())):
            return None
        climb, turn = self._learnt.missing(float(v[2]), rate, now)
        line[2] += climb / FIRMWARE_GAINS.position
        line[3] += turn / FIRMWARE_GAINS.yaw
        self._line = line
        return line

    def blind(self) -> Vec:
        """Return the last line again: the planner on board needs no state from here."""
        return self._line
