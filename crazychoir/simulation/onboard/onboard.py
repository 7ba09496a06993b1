"""The firmware of one drone: its parts, its supervisor, its parameters and its logs."""

import math
from collections.abc import Sequence

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.firmware.supervision import STATE_NAMES
from crazychoir.platforms import Platform
from crazychoir.simulation.onboard import (
    commander,
    estimator,
    laws,
    logs,
    loop,
    parameters,
    planner,
    supervisor,
    voronoi,
)
from crazychoir.simulation.onboard.board_planner import BoardPlanner, TrajectoryStore
from crazychoir.simulation.onboard.record import (
    CONTROLLER_KINDS,
    ESTIMATOR_KINDS,
    EntryPoints,
    Fleet,
    make_fleet,
)
from crazychoir.simulation.onboard.setpoint_input import SetpointInput
from crazychoir.types import State, Vec

CONTROLLERS_BY_NAME = {
    "pid": CONTROLLER_KINDS.pid,
    "mellinger": CONTROLLER_KINDS.mellinger,
    "indi": CONTROLLER_KINDS.indi,
    "brescianini": CONTROLLER_KINDS.brescianini,
    "lee": CONTROLLER_KINDS.lee,
}
_commander = EntryPoints(commander)
_planner = EntryPoints(planner)
_supervisor = EntryPoints(supervisor)
_estimator = EntryPoints(estimator)
_voronoi = EntryPoints(voronoi)
_loop = EntryPoints(loop)


class Onboard:
    """The firmware of one drone: a view of its row in the array of all drones.

    The simulation steps all rows of the array. Arguments are SI, in the world (z up) or in the
    body (forward, left, up).

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
        self.setpoints = SetpointInput(self.rows, row, self.firmware)
        """Takes the set-points."""
        self.trajectories = TrajectoryStore(self.rows, row)
        """Keeps the uploaded trajectories."""
        self.planner = BoardPlanner(self.rows, row, self.trajectories)
        """Takes the flights that the drone plans on board."""
        self.laws: dict[str, laws.Law] = {}
        self.law_name = ""
        _loop.settle(self.rows, self.row)

    def restart(self, is_tested: bool = True) -> None:
        """Restart the firmware: everything in it is reset, only the battery voltage stays.

        is_tested: False if its self-test fails: then only its clock runs
        """
        vbat = float(self.record["vbat"])
        self.rows[self.row : self.row + 1] = make_fleet(1, self.platform)
        self.record["self_tested"] = is_tested
        if not is_tested:
            self.record["az"] = 0.0
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

    def peer_position(self, number: int, p: Vec) -> None:
        """Take the position of another drone, which colAv.enable avoids.

        number: last byte of the other drone's address
        p: (3,) m, world
        """
        _voronoi.hear_peer(self.rows, self.row, number, p[0], p[1], p[2])

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

    def notify_setpoint_stop(self) -> None:
        """End streamed set-points: the planner may take over, from the present estimate."""
        _commander.relax(self.rows, self.row)
        _planner.tell_state(self.rows, self.row)

    # The supervisor

    def arm(self, armed: bool = True) -> bool:
        """Arm the motors, or disarm them, also in the air.

        Return False if the checks before flight do not allow it.
        """
        if armed:
            return bool(_supervisor.request_arming(self.rows, self.row))
        self.record["armed"] = 0
        return True

    def emergency_stop(self) -> None:
        """Stop the motors for good, at the next pass of the supervisor, within 40 ms."""
        self.record["emergency"] = 1

    def emergency_stop_watchdog(self) -> None:
        """Feed the watchdog; after the first call, 1 s without a call triggers an emergency stop."""
        _supervisor.feed_watchdog(self.rows, self.row)

    def recover(self) -> bool:
        """Forget a crash, so that the drone can be armed again; return False if it lies on its back."""
        return bool(_supervisor.recover(self.rows, self.row))

    @property
    def state(self) -> str:
        """The supervisor's state in words."""
        return STATE_NAMES[int(self.record["state"])]

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
        target = laws.convert_setpoint(
            fw[supervisor.name_flown_setpoint(fw)], self.firmware.thrust_max
        )
        answer = self.laws[self.law_name](
            target, self.estimate, self.gyro, laws.LAW_PERIOD
        )
        laws.write_answer(fw, self.law_name, answer)

    def _choose(self, controller: str | float) -> None:
        codes = {0: CONTROLLER_KINDS.pid} | {
            code: code for code in CONTROLLERS_BY_NAME.values()
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
                f"{names}, or 0, 1 (pid), 2 (mellinger), 3 (indi), 4 (brescianini), 5 (lee), "
                "6 (registered)",
                "Offer your own with register(name, law) first.",
            )
        _loop.forget(self.rows, self.row)
        self.record["controller"] = code

    def _choose_estimator(self, code: float) -> None:
        """Choose the estimator; the Kalman filter starts anew, the complementary filter goes on."""
        kind = ESTIMATOR_KINDS.kalman if code == 0 else code
        if kind not in ESTIMATOR_KINDS:
            raise ConfigError(
                "stabilizer.estimator", code, "0, 1 (complementary) or 2 (kalman)"
            )
        if kind != self.record["estimator"]:
            self.record["estimator"] = kind
            _estimator.reset(self.rows, self.row)

    def set(self, name: str, value: str | float) -> None:
        """Write a parameter by the firmware's name; the controller by number or by name.

        Raises ConfigError for an unknown parameter or controller, or a number that is not finite.
        """
        is_number = not isinstance(value, str) and math.isfinite(value)
        if name != "stabilizer.controller" and not is_number:
            raise ConfigError(f"firmware parameter {name}", value, "a finite number")
        self.write(name, value)

    def write(self, name: str, value: str | float) -> None:
        """Write a parameter as `set` does; as in the firmware, NaN and infinity are taken too."""
        if name == "stabilizer.controller":
            self._choose(value)
        elif name == "stabilizer.estimator":
            self._choose_estimator(float(value))
        elif name == parameters.RESET_ESTIMATION:
            if value:
                _estimator.reset(self.rows, self.row)
        else:
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
