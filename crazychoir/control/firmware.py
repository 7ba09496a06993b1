"""Controllers of drones that their firmware flies: by velocities, references or waypoints."""

import math

import numpy as np

from crazychoir.control.controller import CrazyflieController
from crazychoir.control.handlers import FullStateTraj, TrajectoryHandler
from crazychoir.control.rows import EARLY_TOLERANCE, CompiledControllerKind
from crazychoir.control.senders import CommunicationHandler
from crazychoir.control.velocity import FIRMWARE_GAINS, VelocityCtrlStrategy
from crazychoir.numerics.kernels import Records
from crazychoir.numerics.math3d import is_finite
from crazychoir.types import Command, Reference, State, Vec

LINE_LATENESS = 0.05
"""s: delay of a command, of the planner's tick, and of the drone behind its set-points."""
NEW_FLIGHT_GAP = 1.0
"""Seconds without a line after which the next line begins another flight."""
FIRMWARE_LEARNING_RATES = np.array([0.5, 1.0]) / (
    FIRMWARE_GAINS.position,
    FIRMWARE_GAINS.yaw,
)
"""1/s, ki / kp of the firmware's control of the height and of the yaw."""


class VelocityController(CrazyflieController):
    """Flies references by velocities.

    Compiled code flies it while its strategy shares its record, and its handler is a FullStateTraj.

    strategy: computes the velocities
    command_sender: makes the commands
    traj_handler: reads the references
    rows: (1,) of CONTROLLER_ROW, where its memory is kept; None for an array of its own
    """

    def __init__(
        self,
        strategy: VelocityCtrlStrategy,
        command_sender: CommunicationHandler,
        traj_handler: TrajectoryHandler,
        rows: Records | None = None,
    ) -> None:
        self._strategy = strategy
        super().__init__(command_sender, traj_handler, rows)

    @property
    def strategy(self) -> VelocityCtrlStrategy:
        """The strategy that computes the velocities."""
        return self._strategy

    @strategy.setter
    def strategy(self, strategy: VelocityCtrlStrategy) -> None:
        self._strategy = strategy
        self._choose_kind()

    def _find_kind(self) -> CompiledControllerKind:
        if (
            type(self._strategy) is VelocityCtrlStrategy
            and type(self.traj_handler) is FullStateTraj
            and np.shares_memory(self._strategy.rows, self.rows)
        ):
            return CompiledControllerKind.VELOCITY
        return CompiledControllerKind.BY_HAND

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the velocity of the strategy."""
        return self._strategy.velocity(state, reference)

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


class SetPointLead:
    """Moves references ahead, so that a drone flies them that is behind its set-points.

    The equations are those of WaypointController. It learns as the firmware does, from one call to
    the next.
    """

    def __init__(self) -> None:
        self._learnt = LearntIntegrals()

    def apply(self, reference: Vec, t: float, now: float) -> Vec | None:
        """Return the set-point (14,) for a reference; None for a reference that is not finite.

        reference: (14,), as FullState.flat
        t: s by which the set-point is later than the reference
        now: s
        """
        if not is_finite(reference):
            return None
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
        late: float = LINE_LATENESS,
    ) -> None:
        super().__init__(command_sender, traj_handler)
        self.late = late
        self._lead = SetPointLead()

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the reference (14,), moved ahead."""
        return self._lead.apply(reference, self.late, now)

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
        late: float = LINE_LATENESS,
    ) -> None:
        super().__init__(command_sender, traj_handler)
        self.every = every
        self.ahead = ahead
        self.late = late
        self._next = -math.inf
        self._line = np.zeros(5)
        self._lead = SetPointLead()

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
        end = self._lead.apply(reference, self.ahead + self.late, now)
        if end is None:
            return None
        line = np.array([*end[0:3], end[12], self.ahead])
        self._line = line
        return line

    def blind(self) -> Vec:
        """Return the last line again: the planner on board needs no state from here."""
        return self._line
