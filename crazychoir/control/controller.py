"""The controller of one drone: a template, and the hierarchical one made of strategies."""

from abc import ABC, abstractmethod

import numpy as np

from crazychoir.control.attitude import AttitudeControl
from crazychoir.control.handlers import CommunicationHandler, TrajectoryHandler
from crazychoir.control.position import PositionControl
from crazychoir.math3d import Vec
from crazychoir.types import FPQR, Reference, State


class CrazyflieController(ABC):
    """Maps references to commands. What it listens to and what it sends are its handlers, exchangeable at run time.

    A reference that is missing, of another kind or not finite is not flown: the drone holds the last good one, at rest.
    refused: how many were there and could not be flown.
    """

    def __init__(self, command_sender: CommunicationHandler, traj_handler: TrajectoryHandler) -> None:
        self.command_sender, self.traj_handler = command_sender, traj_handler
        self.refused = 0
        self._last: Vec | None = None
        self._input = np.zeros(4)

    @abstractmethod
    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """The input u (4,) = thrust N, body rates rad/s for a reference (14,); None if an argument is not finite."""

    def command(self, state: State, reference: Reference | None, now: float) -> FPQR:
        """One tick: the command for this state and reference; now: s."""
        u = None
        if reference is not None:
            flat = self.traj_handler.read(reference)
            u = None if flat is None else self.law(state, flat, now)
            if u is None:
                self.refused += 1
            else:
                self._last = flat
        if u is None:
            u = self._hold(state, now)
        self._input = u
        return self.command_sender.message(u)

    def _hold(self, state: State, now: float) -> Vec:
        """Fly the last good reference at rest; with a state that is not finite: the last thrust, no rates."""
        self._last = self.traj_handler.hold(state, self._last)
        u = self.law(state, self._last, now)
        return np.array([self._input[0], 0.0, 0.0, 0.0]) if u is None else u


class HierarchicalController(CrazyflieController):
    """Position control around attitude control, each a strategy: the paper's flatness-based scheme.

    pos_strategy: FlatnessPositionCtrl or FlatnessAccelerationCtrl;  attitude_strategy: GeometryAttitudeCtrl.
    """

    def __init__(
        self,
        pos_strategy: PositionControl,
        attitude_strategy: AttitudeControl,
        command_sender: CommunicationHandler,
        traj_handler: TrajectoryHandler,
    ) -> None:
        super().__init__(command_sender, traj_handler)
        self.pos_strategy, self.attitude_strategy = pos_strategy, attitude_strategy

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """The attitude strategy's command for the attitude that the position strategy desires."""
        desired = self.pos_strategy.desired(state, reference, now)
        return None if desired is None else self.attitude_strategy.command(state, desired)
