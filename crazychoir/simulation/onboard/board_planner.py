"""The planner on board one drone, in SI units, and its uploaded trajectories."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError
from crazychoir.firmware.memories import TRAJECTORY_MEMORY
from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.simulation.onboard import bezier, planner, supervisor
from crazychoir.simulation.onboard.record import (
    EXPANDED_PIECES,
    EntryPoints,
    Fleet,
)
from crazychoir.types import Vec

_planner = EntryPoints(planner)
_supervisor = EntryPoints(supervisor)


class TrajectoryStore:
    """Keeps the uploaded trajectories of one drone in its memory.

    rows: memory of all drones
    row: row of this drone
    """

    def __init__(self, rows: Fleet, row: int) -> None:
        self._rows = rows
        self._row = row
        self._record = rows[row]

    @property
    def memory(self) -> npt.NDArray[np.uint8]:
        """The 4096 bytes of uploaded trajectories, not copied."""
        words: npt.NDArray[np.float32] = self._rows["memory"][self._row][
            : TRAJECTORY_MEMORY.size
        ]
        return words.view(np.uint8)

    def define_trajectory(
        self, slot: int, offset: int, pieces: int, compressed: bool = False
    ) -> int:
        """Define a trajectory in the memory; return 8 if there is no such slot.

        A trajectory that does not lie in the memory is accepted too; a start of it does nothing.

        slot: number of the trajectory
        offset: bytes from the beginning of the memory, a multiple of 4 if not compressed
        pieces: count of its pieces
        """
        if not 0 <= slot < TRAJECTORY_MEMORY.slot_count:
            return FIRMWARE_RESULTS.unknown_command
        words = offset // 4
        placed = (
            offset < self.memory.size
            if compressed
            else offset % 4 == 0
            and words + pieces * TRAJECTORY_MEMORY.piece_size <= TRAJECTORY_MEMORY.size
        )
        count = pieces if placed and offset >= 0 else 0
        plan = self._record["planner"]
        plan["offset"][slot] = words if count else 0
        plan["pieces"][slot] = 0 if compressed else count
        plan["packed"][slot] = (offset, count) if compressed else (0, 0)
        return FIRMWARE_RESULTS.done

    def is_defined(self, slot: int) -> bool:
        """Return whether a start of this slot flies a trajectory."""
        plan = self._record["planner"]
        return 0 <= slot < TRAJECTORY_MEMORY.slot_count and bool(
            plan["pieces"][slot] or plan["packed"][slot][1]
        )

    def unpack(self, slot: int, timescale: float, reverse: bool) -> int:
        """Expand a compressed trajectory so that it can be flown; return 0 if it is ready.

        It can only be flown forwards with a timescale of 1; otherwise 8 is returned.
        Choice of this model: at most EXPANDED_PIECES pieces are flown.
        """
        plan = self._record["planner"]
        if not 0 <= slot < TRAJECTORY_MEMORY.slot_count or not plan["packed"][slot][1]:
            return FIRMWARE_RESULTS.done
        offset, segments = plan["packed"][slot].tolist()
        if timescale != 1.0 or reverse:
            return FIRMWARE_RESULTS.unknown_command
        pieces = bezier.expand_segments(
            self.memory[offset:], min(segments, EXPANDED_PIECES)
        )
        plan["offset"][slot] = TRAJECTORY_MEMORY.size
        plan["pieces"][slot] = len(pieces)
        self._rows["memory"][self._row][
            TRAJECTORY_MEMORY.size : TRAJECTORY_MEMORY.size + pieces.size
        ] = pieces.ravel()
        return FIRMWARE_RESULTS.done

    def upload(self, slot: int, pieces: npt.ArrayLike) -> None:
        """Write a trajectory behind those of the other slots and define it.

        pieces: (n, 33): coefficients c0 to c7 of x, y, z in m and of yaw in rad, time in s; then
            the duration of the piece in s
        Raises ConfigError for a wrong slot, shape or number, and if the memory is full.
        """
        rows = np.asarray(pieces, dtype=np.float32)
        where = f"trajectory {slot}"
        if not 0 <= slot < TRAJECTORY_MEMORY.slot_count:
            raise ConfigError(
                "trajectory: slot", slot, f"0 to {TRAJECTORY_MEMORY.slot_count - 1}"
            )
        if (
            rows.ndim != 2
            or rows.shape[1] != TRAJECTORY_MEMORY.piece_size
            or not len(rows)
        ):
            raise ConfigError(
                f"{where}: shape",
                rows.shape,
                "(n, 33): 4 times c0 to c7, and the duration",
            )
        if not np.all(np.isfinite(rows)) or np.any(rows[:, -1] <= 0.0):
            raise ConfigError(
                f"{where}: pieces",
                rows[:, -1].tolist(),
                "finite numbers, durations above 0 s",
            )
        plan = self._record["planner"]
        ends = [
            (plan["offset"][k], plan["pieces"][k] * TRAJECTORY_MEMORY.piece_size)
            for k in range(TRAJECTORY_MEMORY.slot_count)
            if k != slot
        ]
        start = int(
            max(
                (
                    offset + size
                    for offset, size in ends
                    if offset < TRAJECTORY_MEMORY.size
                ),
                default=0,
            )
        )
        if start + rows.size > TRAJECTORY_MEMORY.size:
            free = (TRAJECTORY_MEMORY.size - start) // TRAJECTORY_MEMORY.piece_size
            raise ConfigError(
                where,
                f"{len(rows)} pieces",
                f"at most {TRAJECTORY_MEMORY.most_pieces} in all slots, {free} are free",
            )
        self._rows["memory"][self._row][start : start + rows.size] = rows.ravel()
        plan["offset"][slot] = start
        plan["pieces"][slot] = len(rows)
        plan["packed"][slot] = 0


class BoardPlanner:
    """Gives flights to the planner on board one drone.

    A method returns the firmware's answer: 0 done, 1 refused in this state, 8 a compressed trajectory
    that is not flown in this way, 16 the supervisor does not allow flight. Numbers that are not
    finite are accepted, and disable the planner.

    rows: memory of all drones
    row: row of this drone
    trajectories: the uploaded trajectories of this drone
    """

    def __init__(self, rows: Fleet, row: int, trajectories: TrajectoryStore) -> None:
        self._rows = rows
        self._row = row
        self._trajectories = trajectories

    def _flight(self) -> int:
        """Return the answer of FIRMWARE_RESULTS why a plan cannot begin; 0 if it can."""
        return (
            FIRMWARE_RESULTS.done
            if _supervisor.can_fly(self._rows, self._row)
            else FIRMWARE_RESULTS.busy
        )

    def take_off(
        self, height: float, duration: float | None = None, yaw: float | None = None
    ) -> int:
        """Start to rise to a height.

        height: m, world
        duration: s; None: from the speed hlCommander.vtoff
        yaw: rad: heading at the end; None: keep the heading
        Returns an answer of FIRMWARE_RESULTS, 0 if the flight begins.
        """
        t = -1.0 if duration is None else duration
        psi = 0.0 if yaw is None else yaw
        refused = self._flight()
        keep = float(yaw is None)
        return refused or int(
            _planner.take_off(self._rows, self._row, height, t, psi, keep)
        )

    def land(
        self,
        height: float = 0.0,
        duration: float | None = None,
        yaw: float | None = None,
    ) -> int:
        """Start to descend to a height; the motors stop at the end.

        height: m, world
        duration: s; None: from the speed hlCommander.vland
        yaw: rad: heading at the end; None: keep the heading
        """
        t = -1.0 if duration is None else duration
        psi = 0.0 if yaw is None else yaw
        refused = self._flight()
        keep = float(yaw is None)
        return refused or int(
            _planner.land(self._rows, self._row, height, t, psi, keep)
        )

    def go_to(
        self,
        p: Vec | Sequence[float],
        yaw: float,
        duration: float,
        relative: bool = False,
        linear: bool = False,
    ) -> int:
        """Start to fly to a place and a heading.

        p: (3,) m, world
        yaw: rad
        duration: s
        relative: True to add p and yaw to the present set-point
        linear: True for a straight line at constant speed
        """
        x, y, z = p
        flags = float(relative), float(linear)
        refused = self._flight()
        return refused or int(
            _planner.go_to(self._rows, self._row, x, y, z, yaw, duration, *flags)
        )

    def spiral(
        self,
        angle: float,
        r0: float,
        r1: float,
        climb: float,
        duration: float,
        sideways: bool = False,
        clockwise: bool = False,
    ) -> int:
        """Start to fly a spiral through an angle about a point.

        angle: rad, limited to a turn; a negative angle is flown backwards
        r0: m: radius at the beginning, at least 0
        r1: m: radius at the end, at least 0
        climb: m: change of the height
        duration: s
        sideways: True if the point lies ahead of a clockwise spiral and behind another, False if
            it lies to the side
        clockwise: True to turn clockwise
        """
        refused = self._flight()
        flags = float(sideways), float(clockwise)
        return refused or int(
            _planner.spiral(
                self._rows, self._row, angle, r0, r1, climb, duration, *flags
            )
        )

    def start_trajectory(
        self,
        slot: int,
        timescale: float = 1.0,
        relative: bool = False,
        relative_yaw: bool = False,
        reverse: bool = False,
    ) -> int:
        """Start to fly an uploaded trajectory; a timescale of 2 takes twice the time.

        relative: True to shift it to the present set-point
        relative_yaw: True to turn a relative trajectory, about the origin of its coordinates, to
            the present heading
        """
        refused = self._flight() or self._trajectories.unpack(slot, timescale, reverse)
        flags = float(relative), float(relative_yaw), float(reverse)
        return refused or int(
            _planner.start_trajectory(self._rows, self._row, slot, timescale, *flags)
        )

    def stop(self) -> None:
        """Stop the plan: the motors stop while the planner is in control."""
        _planner.stop(self._rows, self._row)
