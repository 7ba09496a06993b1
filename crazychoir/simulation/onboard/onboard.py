"""The firmware of one drone: its commands in SI units, its parameters and its logs."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.simulation.onboard import (
    bezier,
    commander,
    estimator,
    laws,
    logs,
    loop,
    parameters,
    planner,
    supervisor,
)
from crazychoir.simulation.onboard.commander import SETPOINT_PRIORITIES
from crazychoir.simulation.onboard.record import (
    CONTROLLER_KINDS,
    TRAJECTORY_MEMORY,
    Fleet,
    load_entry_points,
    make_fleet,
)
from crazychoir.simulation.onboard.units import (
    FULL_THRUST_COMMAND,
    convert_roll_pitch_yaw_rate_to_raw,
    convert_thrust_to_raw,
)
from crazychoir.types import State, Vec

CONTROLLERS_BY_NAME = {
    "pid": CONTROLLER_KINDS.pid,
    "mellinger": CONTROLLER_KINDS.mellinger,
    "lee": CONTROLLER_KINDS.lee,
}
MOST_PIECES = (
    TRAJECTORY_MEMORY.size // TRAJECTORY_MEMORY.piece_size
)  # pieces that fit into the memory for trajectories
_commander = load_entry_points(commander)
_planner = load_entry_points(planner)
_supervisor = load_entry_points(supervisor)
_estimator = load_entry_points(estimator)
_loop = load_entry_points(loop)


class Onboard:
    """The firmware of one drone: a view of its row in the array of all drones.

    The simulation steps all rows of the array. Arguments are SI, in the world (z up) or in the
    body (forward, left, up). A set-point method returns True if the commander has accepted the
    set-point; it is refused if its priority is too low or a number is not finite. A planner method
    returns the firmware's answer: 0 done, 1 refused in this state, 8 no such trajectory, 16 the
    supervisor does not allow flight.

    platform: platform for which the firmware is made
    rows: memory of all drones, None for an array of its own
    row: row of this drone
    """

    def __init__(
        self, platform: Platform, rows: Fleet | None = None, row: int = 0
    ) -> None:
        self.platform = platform
        self.firmware = platform.firmware
        self.rows = make_fleet(1, platform) if rows is None else rows
        self.row = row
        self.record = self.rows[row]
        self.laws: dict[str, laws.Law] = {}
        self.law_name = ""
        _loop.settle(self.rows, self.row)

    def restart(self) -> None:
        """Restart the firmware: everything in it is reset, only the battery voltage stays."""
        vbat = float(self.record["vbat"])
        self.rows[self.row : self.row + 1] = make_fleet(1, self.platform)
        self.record["vbat"] = self.record["vbat_low"] = vbat
        _loop.settle(self.rows, self.row)

    def place(self, p: Vec | Sequence[float], yaw: float) -> None:
        """Set the place where the drone is switched on, and start the estimate there.

        p: (3,) m, world
        yaw: rad: heading
        """
        fw = self.record
        fw["initial_x"], fw["initial_y"], fw["initial_z"] = p
        fw["initial_yaw"] = yaw
        _estimator.reset(self.rows, self.row)
        _planner.tell_state(self.rows, self.row)

    # Measurements from outside

    def external_pose(self, p: Vec, q: Vec) -> None:
        """Correct the estimate by a pose from motion capture.

        p: (3,) m, world
        q: (4,): body to world
        """
        _estimator.see_pose(self.rows, self.row, p, q)

    def external_position(self, p: Vec) -> None:
        """Correct the estimate by a position p (3,) m, world; the attitude is not corrected."""
        _estimator.see_position(self.rows, self.row, p)

    def measured_velocity(self, v: Vec, std: float) -> None:
        """Correct the estimate by a velocity that a deck on board has measured.

        v: (3,) m/s, world
        std: m/s: standard deviation of an axis
        """
        _estimator.see_velocity(self.rows, self.row, v, std)

    @property
    def estimate(self) -> State:
        """A copy of the estimated state; the rates are those of the filtered gyroscope."""
        fw = self.record
        names = ["x", "y", "z", "vx", "vy", "vz", "qx", "qy", "qz", "qw"]
        return State(np.array([*(fw[name] for name in names), *self.gyro]))

    @property
    def gyro(self) -> Vec:
        """Filtered reading of the gyroscope: (3,) rad/s, body."""
        fw = self.record
        return np.radians([fw["gx"], fw["gy"], fw["gz"]])

    # Set-points

    def rpyt_raw(
        self,
        roll: float,
        pitch: float,
        yaw: float,
        thrust: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point with the numbers of an RPYT packet.

        roll: deg or deg/s
        pitch: deg or deg/s, positive nose up
        yaw: deg, or deg/s with inverted sign
        thrust: 0..65535
        """
        ok = math.isfinite(roll + pitch + yaw + thrust)
        return ok and bool(
            _commander.rpyt(self.rows, self.row, roll, pitch, yaw, thrust, priority)
        )

    def fpqr(self, thrust: float, p: float, q: float, r: float) -> bool:
        """Give a set-point of thrust N and body rates rad/s.

        It needs flightmode.stabModeRoll = .stabModePitch = .stabModeYaw = 0.
        """
        roll, pitch, yaw = convert_roll_pitch_yaw_rate_to_raw(p, q, r)
        return self.rpyt_raw(roll, pitch, yaw, self._thrust(thrust))

    def frpy(self, thrust: float, roll: float, pitch: float, yaw_rate: float) -> bool:
        """Give a set-point of thrust, roll, pitch and yaw rate.

        It needs flightmode.stabModeRoll = .stabModePitch = 1 and .stabModeYaw = 0.
        thrust: N
        roll: rad
        pitch: rad, positive nose down
        yaw_rate: rad/s
        """
        return self.rpyt_raw(
            *convert_roll_pitch_yaw_rate_to_raw(roll, pitch, yaw_rate),
            self._thrust(thrust),
        )

    def _thrust(self, newtons: float) -> float:
        raw = convert_thrust_to_raw(newtons, self.firmware)
        return (
            min(max(raw, 0.0), FULL_THRUST_COMMAND) if math.isfinite(raw) else math.nan
        )

    def stop_setpoint(self, priority: int = SETPOINT_PRIORITIES.crtp) -> bool:
        """Give the null set-point: no thrust, all modes disabled."""
        return bool(_commander.nothing(self.rows, self.row, priority))

    def velocity(
        self,
        v: Vec | Sequence[float],
        yaw_rate: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of velocity v (3,) m/s, world, and yaw rate rad/s."""
        x, y, z = v
        ok = math.isfinite(x + y + z + yaw_rate)
        return ok and bool(
            _commander.velocity(
                self.rows, self.row, x, y, z, math.degrees(yaw_rate), priority
            )
        )

    def hover(
        self,
        ahead: float,
        left: float,
        yaw_rate: float,
        z: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of horizontal velocity along the heading, yaw rate and height.

        ahead: m/s, along the heading
        left: m/s, to the left of the heading
        yaw_rate: rad/s
        z: m, world
        """
        ok = math.isfinite(ahead + left + yaw_rate + z)
        return ok and bool(
            _commander.hover(
                self.rows, self.row, ahead, left, math.degrees(yaw_rate), z, priority
            )
        )

    def z_distance(
        self,
        roll: float,
        pitch: float,
        yaw_rate: float,
        z: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of roll, pitch, yaw rate and height.

        roll: rad
        pitch: rad, positive nose down
        yaw_rate: rad/s
        z: m, world
        """
        ok = math.isfinite(roll + pitch + yaw_rate + z)
        r = math.degrees(roll)
        p = -math.degrees(pitch)
        w = math.degrees(yaw_rate)
        return ok and bool(
            _commander.z_distance(self.rows, self.row, r, p, w, z, priority)
        )

    def altitude_hold(
        self,
        roll: float,
        pitch: float,
        yaw_rate: float,
        climb: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of roll, pitch, yaw rate and vertical speed.

        roll: rad
        pitch: rad, positive nose down
        yaw_rate: rad/s
        climb: m/s, upwards
        """
        ok = math.isfinite(roll + pitch + yaw_rate + climb)
        r = math.degrees(roll)
        p = -math.degrees(pitch)
        w = math.degrees(yaw_rate)
        return ok and bool(
            _commander.altitude_hold(self.rows, self.row, r, p, w, climb, priority)
        )

    def manual(
        self,
        thrust: float,
        roll: float,
        pitch: float,
        yaw_rate: float,
        rates: bool = False,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of thrust, roll, pitch and yaw rate without the thrust lock.

        thrust: N
        roll: rad, or rad/s if rates is True
        pitch: rad, or rad/s if rates is True
        yaw_rate: rad/s
        """
        ok = math.isfinite(thrust + roll + pitch + yaw_rate)
        r = math.degrees(roll)
        p = -math.degrees(pitch)
        w = math.degrees(yaw_rate)
        raw = self._thrust(thrust)
        return ok and bool(
            _commander.manual(self.rows, self.row, r, p, w, raw, float(rates), priority)
        )

    def position(
        self,
        p: Vec | Sequence[float],
        yaw: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of position p (3,) m, world, and heading rad."""
        x, y, z = p
        ok = math.isfinite(x + y + z + yaw)
        return ok and bool(
            _commander.position(
                self.rows, self.row, x, y, z, math.degrees(yaw), priority
            )
        )

    def full_state(self, s: Vec, priority: int = SETPOINT_PRIORITIES.crtp) -> bool:
        """Give a full state s (16,) = p m, v m/s, a m/s2 world, q body to world, w rad/s body."""
        ok = math.isfinite(float(np.sum(s)))
        return ok and bool(_commander.full_state(self.rows, self.row, s, priority))

    def notify_setpoint_stop(self) -> None:
        """End streamed set-points: the planner may take over, from the present estimate."""
        _commander.relax(self.rows, self.row)
        _planner.tell_state(self.rows, self.row)

    # The planner on board

    def _flight(self, *numbers: float) -> int:
        """Return why a plan cannot begin; 0 if it can."""
        if not math.isfinite(sum(numbers)):
            return planner.PLANNER_ANSWERS.refused
        return (
            planner.PLANNER_ANSWERS.done
            if _supervisor.can_fly(self.rows, self.row)
            else planner.PLANNER_ANSWERS.flight_forbidden
        )

    def take_off(
        self, height: float, duration: float | None = None, yaw: float | None = None
    ) -> int:
        """Start to rise to a height.

        height: m, world
        duration: s; None: from the speed hlCommander.vtoff
        yaw: rad: heading at the end; None: keep the heading
        """
        t = -1.0 if duration is None else duration
        psi = 0.0 if yaw is None else yaw
        refused = self._flight(height, t, psi)
        keep = float(yaw is None)
        return refused or int(
            _planner.take_off(self.rows, self.row, height, t, psi, keep)
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
        refused = self._flight(height, t, psi)
        keep = float(yaw is None)
        return refused or int(_planner.land(self.rows, self.row, height, t, psi, keep))

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
        refused = self._flight(x, y, z, yaw, duration)
        return refused or int(
            _planner.go_to(self.rows, self.row, x, y, z, yaw, duration, *flags)
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

        angle: rad
        r0: m: radius at the beginning
        r1: m: radius at the end
        climb: m: change of the height
        duration: s
        sideways: True if the point lies ahead, False if it lies to the side
        clockwise: True to turn clockwise
        """
        refused = self._flight(angle, r0, r1, climb, duration)
        flags = float(sideways), float(clockwise)
        return refused or int(
            _planner.spiral(self.rows, self.row, angle, r0, r1, climb, duration, *flags)
        )

    def start_trajectory(
        self,
        slot: int,
        timescale: float = 1.0,
        relative: bool = False,
        relative_yaw: bool = False,
        reverse: bool = False,
    ) -> int:
        """Start to fly an uploaded trajectory; a timescale of 2 takes twice the time."""
        refused = self._flight(timescale) or self._unpack(slot, timescale, reverse)
        flags = float(relative), float(relative_yaw), float(reverse)
        return refused or int(
            _planner.start_trajectory(self.rows, self.row, slot, timescale, *flags)
        )

    def stop(self) -> None:
        """Stop the plan: the motors stop while the planner is in control."""
        _planner.stop(self.rows, self.row)

    @property
    def memory(self) -> npt.NDArray[np.uint8]:
        """The 4096 bytes of uploaded trajectories, not copied."""
        words: npt.NDArray[np.float32] = self.rows["memory"][self.row][
            : TRAJECTORY_MEMORY.size
        ]
        return words.view(np.uint8)

    def define_trajectory(
        self, slot: int, offset: int, pieces: int, compressed: bool = False
    ) -> int:
        """Define a trajectory in the memory; return 8 if it does not fit.

        slot: number of the trajectory
        offset: bytes from the beginning of the memory, a multiple of 4 if not compressed
        pieces: count of its pieces
        """
        words = offset // 4
        placed = (
            offset < self.memory.size
            if compressed
            else offset % 4 == 0
            and words + pieces * TRAJECTORY_MEMORY.piece_size <= TRAJECTORY_MEMORY.size
        )
        if not (
            0 <= slot < TRAJECTORY_MEMORY.slot_count
            and pieces > 0
            and offset >= 0
            and placed
        ):
            return planner.PLANNER_ANSWERS.unknown_trajectory
        plan = self.record["planner"]
        plan["offset"][slot] = words
        plan["pieces"][slot] = 0 if compressed else pieces
        plan["packed"][slot] = (offset, pieces * compressed)
        return planner.PLANNER_ANSWERS.done

    def _unpack(self, slot: int, timescale: float, reverse: bool) -> int:
        """Expand a compressed trajectory so that it can be flown; return 0 if it is ready.

        It can only be flown forwards with a timescale of 1; otherwise 8 is returned.
        Chosen: at most TRAJECTORY_MEMORY.expanded_pieces pieces are flown.
        """
        plan = self.record["planner"]
        if not 0 <= slot < TRAJECTORY_MEMORY.slot_count or not plan["packed"][slot][1]:
            return planner.PLANNER_ANSWERS.done
        offset, segments = plan["packed"][slot].tolist()
        pieces = bezier.expand_segments(
            self.memory[offset:], min(segments, TRAJECTORY_MEMORY.expanded_pieces)
        )
        if timescale != 1.0 or reverse or not len(pieces):
            return planner.PLANNER_ANSWERS.unknown_trajectory
        plan["offset"][slot] = TRAJECTORY_MEMORY.size
        plan["pieces"][slot] = len(pieces)
        self.rows["memory"][self.row][
            TRAJECTORY_MEMORY.size : TRAJECTORY_MEMORY.size + pieces.size
        ] = pieces.ravel()
        return planner.PLANNER_ANSWERS.done

    def upload(self, slot: int, pieces: npt.ArrayLike) -> None:
        """Write a trajectory behind those of the other slots and define it.

        pieces: (n, 33): coefficients c0 to c7 of x, y, z in m and of yaw in rad, time in s; then
            the
            duration of the piece in s
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
        plan = self.record["planner"]
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
                f"at most {MOST_PIECES} in all slots, {free} are free",
            )
        self.rows["memory"][self.row][start : start + rows.size] = rows.ravel()
        plan["offset"][slot] = start
        plan["pieces"][slot] = len(rows)
        plan["packed"][slot] = 0

    # The supervisor

    def arm(self, armed: bool = True) -> bool:
        """Request armed motors, or disarm them, also in the air.

        Return False if the checks before flight do not allow it.
        """
        fw = self.record
        if armed and not fw["armed"] and not _supervisor.can_arm(self.rows, self.row):
            return False
        fw["arm_requested"] = armed
        if not armed:
            fw["armed"] = 0
        return True

    def emergency_stop(self) -> None:
        """Stop the motors at once and for good."""
        self.record["estop"] = 1

    def emergency_stop_watchdog(self) -> None:
        """Feed the watchdog; after the first call, 1 s without a call triggers an emergency stop."""
        _supervisor.feed_watchdog(self.rows, self.row)

    def recover(self) -> bool:
        """Return to normal after a crash if the drone stands upright; return False if it cannot."""
        return bool(_supervisor.recover(self.rows, self.row))

    @property
    def state(self) -> str:
        """The supervisor's state in words."""
        return supervisor.STATE_NAMES[int(self.record["state"])]

    @property
    def info(self) -> int:
        """The supervisor's bits, as in the log variable supervisor.info."""
        return int(_supervisor.information(self.rows, self.row))

    # Controllers, parameters, logs

    def register(self, name: str, law: laws.Law) -> None:
        """Offer a user's own controller, selected by `set("stabilizer.controller", name)`.

        The law is called every 2 ms, also on the ground: law(setpoint, estimate, gyro, dt) returns
        ForceTorque, MotorForces or Legacy. If setpoint.modes are all 0 and the thrust is 0, it
        must answer no thrust, or the motors turn on. Raises ConfigError if the name is taken or
        the law cannot be called.
        """
        if name in CONTROLLERS_BY_NAME or not callable(law):
            taken = ", ".join(CONTROLLERS_BY_NAME)
            raise ConfigError(
                "register: controller",
                name,
                f"a callable under another name than {taken}",
            )
        self.laws[name] = law

    def obey_law(self) -> None:
        """Run the user's controller.

        The simulation calls this between two ms when record["law_due"] is 1.
        """
        fw = self.record
        fw["law_due"] = 0
        leveling = fw["state"] == supervisor.SUPERVISOR_STATES.level_out
        target = laws.convert_setpoint(
            fw["level"] if leveling else fw["wanted"], self.firmware.thrust_max
        )
        answer = self.laws[self.law_name](
            target, self.estimate, self.gyro, laws.LAW_PERIOD
        )
        laws.write_answer(fw, self.law_name, answer)

    def _choose(self, controller: str | float) -> None:
        codes = {
            0: CONTROLLER_KINDS.pid,
            CONTROLLER_KINDS.pid: CONTROLLER_KINDS.pid,
            CONTROLLER_KINDS.mellinger: CONTROLLER_KINDS.mellinger,
            CONTROLLER_KINDS.lee: CONTROLLER_KINDS.lee,
        }
        if isinstance(controller, str) and controller in self.laws:
            self.law_name = controller
            code = CONTROLLER_KINDS.out_of_tree
        elif controller == CONTROLLER_KINDS.out_of_tree and self.laws:
            self.law_name = list(self.laws)[-1]
            code = CONTROLLER_KINDS.out_of_tree
        elif isinstance(controller, str) and controller in CONTROLLERS_BY_NAME:
            code = CONTROLLERS_BY_NAME[controller]
        elif controller in codes:
            code = codes[int(controller)]
        else:
            names = ", ".join([*CONTROLLERS_BY_NAME, *self.laws])
            raise ConfigError(
                "stabilizer.controller",
                controller,
                f"{names}, or 0, 1 (pid), 2 (mellinger), 5 (lee), 6 (registered)",
                "Offer your own with register(name, law) first.",
            )
        _loop.forget(self.rows, self.row)
        self.record["controller"] = code

    def set(self, name: str, value: str | float) -> None:
        """Write a parameter by the firmware's name; the controller by number or by name.

        Raises ConfigError for an unknown parameter or controller, or a number that is not finite.
        """
        if name == "stabilizer.controller":
            self._choose(value)
            return
        if isinstance(value, str) or not math.isfinite(value):
            raise ConfigError(f"firmware parameter {name}", value, "a finite number")
        if name == parameters.RESET_ESTIMATION:
            if value:
                _estimator.reset(self.rows, self.row)
            return
        *parts, field = parameters.find_parameter(name)
        place = self.record[parts[0]] if parts else self.record
        place[field] = value

    def get(self, name: str) -> float:
        """Read a parameter by the firmware's name."""
        if name == parameters.RESET_ESTIMATION:
            return 0.0
        *parts, field = parameters.find_parameter(name)
        return float((self.record[parts[0]] if parts else self.record)[field])

    def log(self, name: str) -> float:
        """Read a log variable by the firmware's name, in the firmware's units."""
        return logs.read_log_variable(self.rows, self.row, name)
