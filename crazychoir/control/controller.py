"""The controller of one drone: a template, and the hierarchical controller made of strategies."""

from abc import ABC, abstractmethod

import numpy as np

from crazychoir.control.attitude import (
    AngleAttitudeCtrl,
    AttitudeControl,
    AttitudeKind,
    GeometryAttitudeCtrl,
)
from crazychoir.control.feed_forward import RateFeedForward
from crazychoir.control.handlers import (
    AccelerationTraj,
    FullStateTraj,
    TrajectoryHandler,
)
from crazychoir.control.position import (
    FlatnessAccelerationCtrl,
    FlatnessPositionCtrl,
    PositionControl,
)
from crazychoir.control.rows import (
    CONTROLLER_ROW,
    INPUT_SIZE,
    CompiledControllerKind,
    DesiredSource,
    find_desired_source_of,
    fly_controller_of,
    keep_desired_of,
    start_controller_row,
)
from crazychoir.control.senders import CommunicationHandler
from crazychoir.control.trim import TRIM_ROW
from crazychoir.numerics.kernels import Records
from crazychoir.types import ZERO_ACCELERATION, Command, Reference, State, Vec

NO_REFERENCE = np.zeros(14)
"""(14,): stands for the reference in a call of a kernel that reads none."""
UNUSED_TRIMS = np.zeros(1, TRIM_ROW)
"""(1,) of TRIM_ROW: stands for the trim in a call of a kernel that reads none."""


class CrazyflieController(ABC):
    """Maps references to commands.

    Its handlers define which references it reads and which commands it sends; both can be exchanged
    at run time. If a reference is missing, of another kind or not finite, the drone rests at the
    last good one.

    command_sender: makes the commands
    traj_handler: reads the references
    rows: (1,) of CONTROLLER_ROW, where its memory is kept; None for an array of its own
    """

    def __init__(
        self,
        command_sender: CommunicationHandler,
        traj_handler: TrajectoryHandler,
        rows: Records | None = None,
    ) -> None:
        self.rows = np.zeros(1, CONTROLLER_ROW) if rows is None else rows
        """(1,) of CONTROLLER_ROW."""
        start_controller_row(self.rows)
        self.command_sender = command_sender
        self._trims = UNUSED_TRIMS
        self.traj_handler = traj_handler

    @property
    def traj_handler(self) -> TrajectoryHandler:
        """The handler that reads the references."""
        return self._traj_handler

    @traj_handler.setter
    def traj_handler(self, handler: TrajectoryHandler) -> None:
        self._traj_handler = handler
        self._choose_kind()

    def _choose_kind(self) -> None:
        """Choose how this controller is called, when a part of it is new."""
        kind = self._find_kind()
        self.rows["kind"] = kind
        self._is_compiled = kind is not CompiledControllerKind.BY_HAND

    def _find_kind(self) -> CompiledControllerKind:
        """Return how this controller is called; compiled code must know all its parts."""
        return CompiledControllerKind.BY_HAND

    @property
    def refused(self) -> int:
        """Number of references that could not be flown."""
        return int(self.rows["refused"][0])

    @property
    def last(self) -> Vec | None:
        """The last usable reference, a new (14,); None before the first."""
        if self.rows["has_last"][0] == 0:
            return None
        last: Vec = self.rows["last"][0].copy()
        return last

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
        last = self.last
        if last is None:
            return ZERO_ACCELERATION
        a = last[6:9]
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
        if self._is_compiled:
            u = self._fly_compiled(state, reference, now)
        else:
            u = self._fly_by_hand(state, reference, now)
        return self.command_sender.message(u)

    def _fly_compiled(
        self, state: State, reference: Reference | None, now: float
    ) -> Vec:
        """Return the input (4,), by the laws in the record."""
        flat = None
        if reference is not None:
            flat = self._traj_handler.read(reference)
            if flat is None:
                self._refuse()
        u = np.empty(INPUT_SIZE)
        fly_controller_of(
            self.rows,
            self._trims,
            state.flat,
            state.age,
            NO_REFERENCE if flat is None else flat,
            flat is not None,
            now,
            u,
        )
        return u

    def _fly_by_hand(
        self, state: State, reference: Reference | None, now: float
    ) -> Vec:
        """Return the input, by the law in Python."""
        u = None
        if reference is not None:
            flat = self._traj_handler.read(reference)
            u = None if flat is None else self.law(state, flat, now)
            if flat is None or u is None:
                self._refuse()
            else:
                self._keep(flat)
        return self._hold(state, now) if u is None else u

    def _hold(self, state: State, now: float) -> Vec:
        """Return the input that flies the last good reference at rest."""
        held = self.traj_handler.hold(state, self.last)
        self._keep(held)
        u = self.law(state, held, now)
        return self.blind() if u is None else u

    def _keep(self, flat: Vec) -> None:
        """Keep a reference (14,) as the last usable one."""
        self.rows["last"] = flat
        self.rows["has_last"] = 1

    def _refuse(self) -> None:
        """Count a reference that cannot be flown."""
        self.rows["refused"] += 1


HANDLER_TYPES: dict[type, type] = {
    FlatnessPositionCtrl: FullStateTraj,
    FlatnessAccelerationCtrl: AccelerationTraj,
}
"""The handler beside each position control that compiled code knows."""
ATTITUDE_TYPES = (GeometryAttitudeCtrl, AngleAttitudeCtrl)
"""The attitude controls that compiled code knows."""


class HierarchicalController(CrazyflieController):
    """Position control around attitude control, each a strategy: the paper's flatness-based scheme.

    Its parts can be exchanged at run time. While they are those of `make_controls`, which ship and
    share the record of this controller, compiled code flies it; else its strategies are called in
    Python. Both give the same commands.

    pos_strategy: FlatnessPositionCtrl or FlatnessAccelerationCtrl
    attitude_strategy: GeometryAttitudeCtrl, or AngleAttitudeCtrl for an attitude control on board
    command_sender: makes the commands
    traj_handler: reads the references
    position_rate: Hz, of the position strategy; 0: in each tick. Between its ticks the desired
        attitude turns further by its feed-forward, and the thrust stays constant.
    rows: (1,) of CONTROLLER_ROW, where its memory is kept; None for an array of its own
    """

    def __init__(
        self,
        pos_strategy: PositionControl,
        attitude_strategy: AttitudeControl,
        command_sender: CommunicationHandler,
        traj_handler: TrajectoryHandler,
        position_rate: float = 0.0,
        rows: Records | None = None,
    ) -> None:
        self._pos_strategy = pos_strategy
        self._attitude_strategy = attitude_strategy
        super().__init__(command_sender, traj_handler, rows)
        self._desired: Vec = self.rows["desired"][0]
        self.feed_forward = RateFeedForward(self.rows["feed_forward"])
        """Rates that are asked for beside those of the position strategy."""
        self.position_rate = position_rate

    @property
    def pos_strategy(self) -> PositionControl:
        """The strategy that turns a reference into a thrust and an attitude."""
        return self._pos_strategy

    @pos_strategy.setter
    def pos_strategy(self, strategy: PositionControl) -> None:
        self._pos_strategy = strategy
        self._choose_kind()

    @property
    def attitude_strategy(self) -> AttitudeControl:
        """The strategy that turns an attitude into the input of the sender."""
        return self._attitude_strategy

    @attitude_strategy.setter
    def attitude_strategy(self, strategy: AttitudeControl) -> None:
        self._attitude_strategy = strategy
        self._choose_kind()

    @property
    def position_rate(self) -> float:
        """Hz, of the position strategy; 0: in each tick."""
        return float(self.rows["position_rate"][0])

    @position_rate.setter
    def position_rate(self, rate: float) -> None:
        self.rows["position_rate"] = rate

    def _find_kind(self) -> CompiledControllerKind:
        position = self._pos_strategy
        attitude = self._attitude_strategy
        if (
            isinstance(position, FlatnessPositionCtrl)
            and isinstance(attitude, (GeometryAttitudeCtrl, AngleAttitudeCtrl))
            and type(attitude) in ATTITUDE_TYPES
            and type(self.traj_handler) is HANDLER_TYPES.get(type(position))
            and np.shares_memory(position.rows, self.rows)
            and np.shares_memory(attitude.rows, self.rows)
        ):
            self._trims = position.trim.rows
            return CompiledControllerKind.FLATNESS
        return CompiledControllerKind.BY_HAND

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the attitude strategy's input for the attitude of the position strategy."""
        if self.position_rate > 0.0:
            desired = self._find_desired(state, reference, now)
        else:
            desired = self._pos_strategy.desired(state, reference, now)
        if desired is None:
            return None
        kind = (
            AttitudeKind.ANGLES
            if isinstance(self._attitude_strategy, AngleAttitudeCtrl)
            else AttitudeKind.RATES
        )
        desired = self.feed_forward.lead(kind, state, desired, now)
        u = self._attitude_strategy.command(state, desired)
        self.rows["thrust"] = u[0]
        return u

    def _find_desired(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the desired attitude, computed at the rate of the position strategy."""
        source = find_desired_source_of(self.rows, state.flat, reference, now)
        if source == DesiredSource.REFUSED:
            return None
        if source == DesiredSource.TURNED:
            return self._desired
        desired = self._pos_strategy.desired(state, reference, now)
        if desired is not None:
            keep_desired_of(self.rows, desired, now)
        return desired

    @property
    def acceleration(self) -> Vec:
        """The acceleration of the position strategy: (3,) m/s2, world."""
        return self._pos_strategy.acceleration

    def blind(self) -> Vec:
        """Return the last thrust, with rates or angles of 0."""
        return np.array([self.rows["thrust"][0], 0.0, 0.0, 0.0])
