"""The controller of one drone: a template, and the hierarchical controller made of strategies."""

import math
from abc import ABC, abstractmethod

import numpy as np

from crazychoir.control.attitude import AttitudeControl
from crazychoir.control.handlers import TrajectoryHandler
from crazychoir.control.position import PositionControl
from crazychoir.control.senders import CommunicationHandler
from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.numerics.math3d import is_finite, rotation_columns, rotation_exponential
from crazychoir.types import ZERO_ACCELERATION, Command, Reference, State, Vec

EARLY_TOLERANCE = 1e-4
"""Seconds that a tick may be early for the next look at the position: clocks and cameras jitter."""


class CrazyflieController(ABC):
    """Maps references to commands.

    Its handlers define which references it reads and which commands it sends; both can be exchanged
    at run time. If a reference is missing, of another kind or not finite, the drone rests at the
    last good one.

    command_sender: makes the commands
    traj_handler: reads the references
    """

    def __init__(
        self, command_sender: CommunicationHandler, traj_handler: TrajectoryHandler
    ) -> None:
        self.command_sender = command_sender
        self.traj_handler = traj_handler
        self.refused = 0
        """Number of references that could not be flown."""
        self._last: Vec | None = None

    @abstractmethod
    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the input u of the sender for a reference; None if an argument is not finite.

        state: of the drone
        reference: (14,), as FullState.flat
        now: s
        """

    @property
    def acceleration(self) -> Vec:
        """The acceleration that the last command asks of the drone: (3,) m/s2, world, read-only.

        A controller that does not compute it gives the acceleration of the reference.
        """
        if self._last is None:
            return ZERO_ACCELERATION
        a = self._last[6:9].copy()
        a.setflags(write=False)
        return a

    @abstractmethod
    def blind(self) -> Vec:
        """Return the input to send while the state of the drone is not finite."""

    def command(
        self, state: State, reference: Reference | None, now: float
    ) -> Command | None:
        """Return the command for this state and reference; None if nothing new is to be sent.

        state: of the drone
        reference: None if there is none
        now: s
        """
        u = None
        if reference is not None:
            flat = self.traj_handler.read(reference)
            u = None if flat is None else self.law(state, flat, now)
            if u is None:
                self.refused += 1
            else:
                self._last = flat
        return self.command_sender.message(self._hold(state, now) if u is None else u)

    def _hold(self, state: State, now: float) -> Vec:
        """Return the input that flies the last good reference at rest."""
        self._last = self.traj_handler.hold(state, self._last)
        u = self.law(state, self._last, now)
        return self.blind() if u is None else u


@kernel(vector, vector, memory, real)
def _turn_desired(x: Vec, ref: Vec, desired: Vec, t: float) -> bool:
    """Turn the desired attitude further by its feed-forward: R_d exp(t w_d).

    x: (13,): state
    ref: (14,): reference
    desired: (13,), of a PositionControl, changed in place
    t: s
    Returns False, and changes nothing, if x or ref is not finite.
    """
    if not (is_finite(x) and is_finite(ref)):
        return False
    turn = rotation_columns(
        rotation_exponential(t * desired[10], t * desired[11], t * desired[12])
    )
    for c in range(3):
        a = desired[1 + c]
        b = desired[4 + c]
        d = desired[7 + c]
        for n in range(3):
            desired[1 + 3 * n + c] = a * turn[n][0] + b * turn[n][1] + d * turn[n][2]
    return True


class HierarchicalController(CrazyflieController):
    """Position control around attitude control, each a strategy: the paper's flatness-based scheme.

    pos_strategy: FlatnessPositionCtrl or FlatnessAccelerationCtrl
    attitude_strategy: GeometryAttitudeCtrl, or AngleAttitudeCtrl for an attitude control on board
    command_sender: makes the commands
    traj_handler: reads the references
    position_rate: Hz, of the position strategy; 0: in each tick. Between its ticks the desired
        attitude turns further by its feed-forward, and the thrust stays constant.
    """

    def __init__(
        self,
        pos_strategy: PositionControl,
        attitude_strategy: AttitudeControl,
        command_sender: CommunicationHandler,
        traj_handler: TrajectoryHandler,
        position_rate: float = 0.0,
    ) -> None:
        super().__init__(command_sender, traj_handler)
        self.pos_strategy = pos_strategy
        self.attitude_strategy = attitude_strategy
        self.position_rate = position_rate
        self._desired = np.zeros(13)
        self._at = -math.inf
        self._next = -math.inf
        self._thrust = 0.0

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the attitude strategy's input for the attitude of the position strategy."""
        if self.position_rate > 0.0:
            desired = self._at_its_rate(state, reference, now)
        else:
            desired = self.pos_strategy.desired(state, reference, now)
        if desired is None:
            return None
        u = self.attitude_strategy.command(state, desired)
        self._thrust = float(u[0])
        return u

    def _at_its_rate(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the desired attitude, computed at the rate of the position strategy."""
        t = now - self._at
        self._at = now
        if self._at < self._next - EARLY_TOLERANCE and 0.0 <= t < 1.0:
            return (
                self._desired
                if _turn_desired(state.flat, reference, self._desired, t)
                else None
            )
        desired = self.pos_strategy.desired(state, reference, now)
        if desired is not None:
            self._desired[:] = desired
            self._next = (
                max(self._next, now - 1.0 / self.position_rate)
                + 1.0 / self.position_rate
            )
        return desired

    @property
    def acceleration(self) -> Vec:
        """The acceleration of the position strategy: (3,) m/s2, world."""
        return self.pos_strategy.acceleration

    def blind(self) -> Vec:
        """Return the last thrust, with rates or angles of 0."""
        return np.array([self._thrust, 0.0, 0.0, 0.0])
