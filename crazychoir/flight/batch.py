"""The drones of a process as one batch: a record a drone, which the stages of a tick read and write.

Each stage of a tick is one compiled call for all records, see tick.py. It reads the fields that
earlier stages wrote, and writes its own. The Python parts of a drone read and write its record by a
DroneRow.
"""

from enum import IntEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from crazychoir.control.rows import make_control_rows
from crazychoir.filters.command_history import compute_history_size
from crazychoir.filters.rows import FilterTable
from crazychoir.flight.flight_limits import BLIND_HORIZON
from crazychoir.numerics.kernels import Record, Records
from crazychoir.planning.plan_row import PLAN_ROW, PlanRows
from crazychoir.safety.collision.avoidance import AVOID_ROW
from crazychoir.safety.rules.guard import GUARD_ROW, Action, GuardRows
from crazychoir.safety.rules.modes import GROUND_MODE, Mode
from crazychoir.types import (
    Acceleration,
    FullState,
    Reference,
    State,
    Vec,
    Velocity,
)


class FlightReferenceKind(IntEnum):
    """Kinds of references that a drone follows from tick to tick."""

    NONE = 0
    """The drone flies its plan."""
    ACCELERATION = 1
    """`reference[6:9]` and the yaw in `reference[12]`."""
    VELOCITY = 2
    """`reference[3:6]` and the yaw in `reference[12]`."""
    FULL_STATE = 3
    """All of `reference`, as FullState.flat."""


# In Python 3.11 the access to a member of an enum costs more than the comparison.
NO_REFERENCE: Final = int(FlightReferenceKind.NONE)
"""`FlightReferenceKind.NONE` as a plain int."""


class Course(IntEnum):
    """What a drone does in a tick, as the stage `judge` decides."""

    NOTHING = 0
    """It gets no command."""
    IDLE = 1
    """Its motors stay off."""
    FOLLOW = 2
    """It flies its reference or its plan: the stages `follow` and `avoid` are for it."""
    READY = 3
    """The judge has decided what its controller flies."""


class FlightControllerKind(IntEnum):
    """The controller that flies what a drone wants."""

    NONE = 0
    """No controller: the drone gets no command, or the idle one."""
    TRACKER = 1
    """The controller of full states."""
    FOLLOWER = 2
    """The controller of accelerations."""


DRONE_ROW = np.dtype(
    [
        # Set once.
        ("is_by_hand", np.int64),  # 1: the judge decides in Python, in each tick
        ("avoids", np.int64),  # 1: a collision filter keeps the drone clear
        (
            "sends_rows",
            np.int64,
        ),  # 1: its commands are four numbers, computed in compiled code
        ("has_world_row", np.int64),  # 1: its world takes its commands as a row
        ("is_running", np.int64),  # 1: its actor runs, and no tick of it has failed
        ("listener", np.int64),  # its number in the airspace; -1: it has none
        ("knows_commands", np.int64),  # 1: its filter knows what it is commanded
        ("has_follower", np.int64),  # 1: the sender can send accelerations
        ("ground", np.float64),  # m, height of the ground
        ("least_velocity_gain", np.float64),  # 1/s, of the tracker
        ("limits", np.float64, (4,)),  # of ReferenceLimits
        ("gains", np.float64, (13,)),  # of the tracker, as Gains.position
        # Which drones tick now.
        ("ticks", np.int64),  # 1: this tick is for the drone
        ("ticked_ns", np.int64),  # ns, its newest tick
        ("number", np.int64),  # number of its newest tick
        # Estimate.
        ("is_known", np.int64),  # 1: the drone was seen
        ("state", np.float64, (13,)),  # as State.flat
        ("age", np.float64),  # s, of the measurement
        ("acceleration", np.float64, (3,)),  # m/s2, commanded in the tick before
        ("commanded", np.float64, (3,)),  # m/s2, asked for by the newest command
        # Mode and permission.
        ("mode", np.int64),  # index into NUMBERED_MODES
        ("is_held", np.int64),  # 1: by its operator
        ("awaits_start", np.int64),  # 1: its mission waits for the operator's start
        ("obeyed", np.int64),  # the Action of the last verdict
        # Reference of guidance.
        ("reference_kind", np.int64),  # a FlightReferenceKind
        ("reference", np.float64, (14,)),  # as FullState.flat
        ("reference_ns", np.int64),  # ns, when it was given
        ("is_beyond", np.int64),  # 1: the wanted place is beyond the fence
        ("fence_ticks", np.int64),  # ticks at the fence, wanting to be beyond it
        ("lift_off_height", np.float64),  # m, above which a drone that takes off flies
        # Course of this tick.
        ("course", np.int64),  # a Course
        ("controller", np.int64),  # a FlightControllerKind
        ("wanted", np.float64, (14,)),  # what the controller flies, as FullState.flat
        ("has_flown", np.int64),  # 1: `flown` is valid
        ("flown", np.float64, (14,)),  # full state that the drone flies
        ("learns_trim", np.int64),  # 1: the trim learns from this tick
        # Evasion.
        ("is_aside", np.int64),  # 1: pushed off its plan, and not back
        ("gave_way", np.float64),  # s, when it last gave way
        ("evasion_ticks", np.int64),  # ticks that the collision filter has flown it
        ("evades", np.int64),  # 1: the collision filter flies it now
        ("evades_drone", np.int64),  # the drone that it evades; -1: it brakes
        (
            "cut_off_since",
            np.float64,
        ),  # s, since when it hears too few; inf: it does not
        # Messages since they were last counted.
        ("sent", np.int64),  # states sent to other drones
        ("lost", np.int64),  # states of these that the simulated network lost
        # Command.
        ("is_computed", np.int64),  # 1: `command` was computed in this tick
        ("command", np.float64, (14,)),  # input of the sender
    ]
)
"""One drone in the batch."""

DroneRows = npt.NDArray[np.void]
"""(n,) records of DRONE_ROW."""

NUMBERED_MODES: tuple[Mode, ...] = tuple(Mode)
"""The modes in the order of their numbers."""
MODE_NUMBERS: dict[Mode, int] = {
    mode: number for number, mode in enumerate(NUMBERED_MODES)
}
"""The number of each mode in a record."""


class Batch:
    """The records of the drones of a process.

    size: largest number of drones
    rate: Hz, of the poses of the drones; the largest if they differ
    """

    def __init__(self, size: int, rate: float = 100.0) -> None:
        self.drones: DroneRows = np.zeros(size, DRONE_ROW)
        history_size = compute_history_size(BLIND_HORIZON, 1.0 / rate)
        self.filters = FilterTable.allocate(size, history_size)
        self.controls: Records = make_control_rows(size)
        self.plans: PlanRows = np.zeros(size, PLAN_ROW)
        self.guards: GuardRows = np.zeros(size, GUARD_ROW)
        self.avoids: Records = np.zeros(size, AVOID_ROW)
        self.places: dict[int, int] = {}
        """The place of each drone, by id: the index of its records."""
        self.drones["listener"] = -1
        self.drones["gave_way"] = -np.inf
        self.drones["cut_off_since"] = np.inf

    @property
    def count(self) -> int:
        """Number of drones."""
        return len(self.places)

    def add(self, drone: int) -> "DroneRow":
        """Return the record of one more drone, with this id."""
        index = self.count
        self.places[drone] = index
        return DroneRow(self, index)


class DroneRow:
    """The record of one drone, as its Python parts read and write it.

    batch: of the drone
    index: of its record
    """

    def __init__(self, batch: Batch, index: int) -> None:
        self.batch = batch
        self.index = index
        self.drone: Record = batch.drones[index]
        self.plan: Record = batch.plans[index]
        self.guard: Record = batch.guards[index]
        self.filters = batch.filters.share_row(index)
        """The record of its filter."""
        self.controls: Records = batch.controls[index : index + 1]
        """(1,): the record of its controllers."""
        self.avoid: Records = batch.avoids[index : index + 1]
        """(1,): the record of its collision filter."""
        self._state: State | None = None
        self._state_number = -1
        self.mode = GROUND_MODE

    @property
    def mode(self) -> Mode:
        """The mode of the drone, see safety/rules/modes."""
        mode: Mode = NUMBERED_MODES[self.drone["mode"]]
        return mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        self.drone["mode"] = MODE_NUMBERS[mode]

    @property
    def obeyed(self) -> Action:
        """The action of the last verdict."""
        return Action(self.drone["obeyed"])

    @obeyed.setter
    def obeyed(self, action: Action) -> None:
        self.drone["obeyed"] = action

    @property
    def fence_ticks(self) -> int:
        """Number of ticks at the fence because guidance wanted to be beyond it."""
        return int(self.drone["fence_ticks"])

    @property
    def state(self) -> State | None:
        """The newest state of the drone; None before the first pose."""
        row = self.drone
        if not row["is_known"]:
            return None
        if self._state is None or self._state_number != row["number"]:
            flat = row["state"].copy()
            a = row["acceleration"].copy()
            flat.setflags(write=False)
            a.setflags(write=False)
            self._state = State(flat, float(row["age"]), a)
            self._state_number = row["number"]
        return self._state

    def get_state(self) -> State:
        """Return the newest state of a drone that was seen."""
        state = self.state
        assert state is not None  # noqa: S101 - callers have looked
        return state

    @property
    def has_reference(self) -> bool:
        """Whether the drone follows a reference; False while it flies its plan."""
        return bool(self.drone["reference_kind"] != NO_REFERENCE)

    @property
    def reference(self) -> Reference | None:
        """The reference that the drone follows; None while it flies its plan."""
        row = self.drone
        flat: Vec = row["reference"]
        match row["reference_kind"]:
            case FlightReferenceKind.ACCELERATION:
                return Acceleration(flat[6:9].copy(), float(flat[12]))
            case FlightReferenceKind.VELOCITY:
                return Velocity(flat[3:6].copy(), float(flat[12]))
            case FlightReferenceKind.FULL_STATE:
                return FullState(flat.copy())
        return None

    def set_reference(
        self, reference: Acceleration | Velocity | FullState | None, now_ns: int = 0
    ) -> None:
        """Follow this reference from now on; None: fly the plan.

        reference: with float64 arrays, see `convert_reference`
        now_ns: ns
        """
        row = self.drone
        flat: Vec = row["reference"]
        match reference:
            case None:
                row["reference_kind"] = FlightReferenceKind.NONE
                return
            case Acceleration():
                row["reference_kind"] = FlightReferenceKind.ACCELERATION
                flat[6:9] = reference.a
                flat[12] = reference.yaw
            case Velocity():
                row["reference_kind"] = FlightReferenceKind.VELOCITY
                flat[3:6] = reference.v
                flat[12] = reference.yaw
            case FullState():
                row["reference_kind"] = FlightReferenceKind.FULL_STATE
                flat[:] = reference.flat
        row["reference_ns"] = now_ns

    @property
    def flown(self) -> FullState | None:
        """The full state that the drone flew in the last tick; None if it flew none."""
        row = self.drone
        return FullState(row["flown"].copy()) if row["has_flown"] else None

    @flown.setter
    def flown(self, flown: FullState | None) -> None:
        row = self.drone
        row["has_flown"] = flown is not None
        if flown is not None:
            row["flown"] = flown.flat

    def fly(self, flown: FullState, learns_trim: bool = False) -> None:
        """Let the controller fly this full state in this tick, without the stages before it.

        learns_trim: whether the trim learns from this tick
        """
        row = self.drone
        row["course"] = Course.READY
        row["controller"] = FlightControllerKind.TRACKER
        row["wanted"] = flown.flat
        row["learns_trim"] = learns_trim
        self.flown = flown
