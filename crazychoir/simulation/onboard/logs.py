"""The firmware's log variables by name, in its units; the pitch is positive nose up.

What a controller of the firmware logs keeps its last value when another controller flies; here it
is 0 then.
"""

import difflib
import math
from collections.abc import Callable
from dataclasses import dataclass

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import rotation_columns
from crazychoir.simulation.onboard import supervisor
from crazychoir.simulation.onboard.record import CONTROLLER_KINDS, EntryPoints, Fleet
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY

FleetReader = Callable[[Fleet, int], float]


def _target_reader(name: str) -> FleetReader:
    """Return a reader of a field of the set-point that is flown; its yaw is the rate, as in the firmware."""
    field = "yaw_rate" if name == "yaw" else name
    return lambda rows, i: float(
        rows[supervisor.name_flown_setpoint(rows[i])][field][i]
    )


def _field_reader(name: str, factor: float = 1.0) -> FleetReader:
    return lambda rows, i: float(rows[name][i]) * factor


def _part_reader(part: str, field: str) -> FleetReader:
    """Return a reader of a field of a part of the record."""
    return lambda rows, i: float(rows[part][field][i])


def _motor_variance_reader(axis: str, k: int) -> FleetReader:
    """Return a reader of the variance of the accelerometer in the test of propeller k."""
    return lambda rows, i: float(rows["health"][f"variance_{axis}"][i, k])


def truncate_to_range(value: float, low: float, high: float) -> int:
    """Truncate to an integer within a range; 0 for a value that is not a number."""
    return 0 if math.isnan(value) else int(min(max(value, low), high))


def _int16_reader(name: str, factor: float = 1.0, offset: float = 0.0) -> FleetReader:
    """Return a reader of a field, scaled by factor, moved and limited to a 16-bit integer."""
    return lambda rows, i: float(
        truncate_to_range(float(rows[name][i]) * factor + offset, -32768.0, 32767.0)
    )


def _motor_reader(name: str, k: int) -> FleetReader:
    """Return a reader of a field of motor k, as a 32-bit integer."""
    return lambda rows, i: float(
        truncate_to_range(float(rows[name][i, k]), -(2.0**31), 2.0**31 - 1.0)
    )


@dataclass(frozen=True, slots=True)
class LogFields:
    """Names of the fields that the log variables read."""

    axes: tuple[str, ...] = ("x", "y", "z")
    """Axes of a vector."""
    state: tuple[str, ...] = (
        "x",
        "y",
        "z",
        "vx",
        "vy",
        "vz",
        "roll",
        "pitch",
        "yaw",
        "qx",
        "qy",
        "qz",
        "qw",
    )
    """Fields of the estimated state; the first six are position and velocity."""
    target: tuple[str, ...] = (
        "x",
        "y",
        "z",
        "vx",
        "vy",
        "vz",
        "ax",
        "ay",
        "az",
        "roll",
        "pitch",
        "yaw",
        "thrust",
    )
    """Fields of a set-point."""
    modes: tuple[str, ...] = ("x", "y", "z", "roll", "pitch", "yaw", "quat")
    """Axes of a set-point that have a mode."""


LOG_FIELDS = LogFields()


VARIANCE_FIELDS = {
    "X": "xy_pp",
    "Y": "xy_pp",
    "Z": "z_pp",
    "PX": "xy_vv",
    "PY": "xy_vv",
    "PZ": "z_vv",
}
"""Fields of the firmware's variances by its names: X is a position, PX a velocity."""
LARGEST_RAW_READING = 32767.0
"""Largest raw reading of an inertial sensor."""


@dataclass(frozen=True, slots=True)
class ControllerLogScales:
    """Units of the controllers' log variables."""

    radians_per_degree: float = math.pi / 180.0
    """rad a degree."""
    raw_per_rate: float = 65536.0 / 4000.0
    """Raw readings of the gyroscope a deg/s: its range is 2000 deg/s. Source: BMI088 data sheet."""


CONTROLLER_LOG_SCALES = ControllerLogScales()


# The PIDs: P, I, D and feed-forward of the last pass


def _read_proportional(rows: Fleet, i: int, pid: str) -> float:
    row = rows[pid][i]
    error = float(row["desired"]) - float(row["previous"])
    if pid == "yaw_pid" and math.isfinite(error):
        error = math.remainder(error, 360.0)
    return float(row["kp"]) * error


def _read_integral(rows: Fleet, i: int, pid: str) -> float:
    row = rows[pid][i]
    return float(row["ki"]) * float(row["integral"])


def _read_derivative(rows: Fleet, i: int, pid: str) -> float:
    row = rows[pid][i]
    return -float(row["kd"]) * float(row["slope"])


def _read_feed_forward(rows: Fleet, i: int, pid: str) -> float:
    row = rows[pid][i]
    return float(row["kff"]) * float(row["desired"])


PID_TERMS = {
    "P": _read_proportional,
    "I": _read_integral,
    "D": _read_derivative,
    "FF": _read_feed_forward,
}
"""Readers of the terms of a PID."""


def _pid_readers(pid: str, names: dict[str, str]) -> dict[str, FleetReader]:
    """Return the readers of the terms of a PID; names: {term: log variable}."""
    return {
        name: lambda rows, i, read=PID_TERMS[term]: read(rows, i, f"{pid}_pid")  # type: ignore[misc]
        for term, name in names.items()
    }


def _read_pids() -> dict[str, FleetReader]:
    readers: dict[str, FleetReader] = {}
    for axis in ("roll", "pitch", "yaw"):
        for group, pid in (("pid_attitude", axis), ("pid_rate", f"{axis}_rate")):
            names = {term: f"{group}.{axis}_out{term}" for term in PID_TERMS}
            readers |= _pid_readers(pid, names)
    for pid in ("x", "y", "z", "vx", "vy", "vz"):
        names = {term: f"posCtl.{pid.upper()}{term.lower()}" for term in PID_TERMS}
        readers |= _pid_readers(pid, names)
        readers[f"posCtl.target{pid.upper()}"] = lambda rows, i, pid=pid: float(  # type: ignore[misc]
            rows[f"{pid}_pid"][i]["desired"]
        )
    return readers


def _heading_reader(ahead: str, left: str, sign: float) -> FleetReader:
    """Return a reader of ahead cos(yaw) + sign left sin(yaw), of two fields."""

    def read(rows: Fleet, i: int) -> float:
        yaw = math.radians(rows["yaw"][i])
        if not math.isfinite(yaw):
            return math.nan
        turned = float(rows[left][i]) * math.sin(yaw)
        return float(rows[ahead][i]) * math.cos(yaw) + sign * turned

    return read


# Mellinger's and Lee's controllers


def _when(controller: int, read: FleetReader) -> FleetReader:
    """Return a reader that gives 0 unless this controller flies."""
    return lambda rows, i: read(rows, i) if rows["controller"][i] == controller else 0.0


def _part(part: str, name: str) -> FleetReader:
    return lambda rows, i: float(rows[part][i][name])


def _rate(axis: str, sign: float = 1.0) -> FleetReader:
    """Return a reader of the gyroscope in rad/s."""
    return _field_reader(f"g{axis}", sign * CONTROLLER_LOG_SCALES.radians_per_degree)


def _read_mellinger() -> dict[str, FleetReader]:
    readers = {
        "cmd_thrust": _field_reader("thrust"),
        "cmd_roll": _field_reader("roll_out"),
        "cmd_pitch": _field_reader("pitch_out"),
        "cmd_yaw": _field_reader("yaw_out"),
        "r_roll": _rate("x"),
        "r_pitch": _rate("y", -1.0),
        "r_yaw": _rate("z"),
        "accelz": _field_reader("az"),
        **{f"zd{axis}": _part("mellinger", f"zd{axis}") for axis in "xyz"},
        **{f"i_err_{axis}": _part("mellinger", f"i{axis}") for axis in "xyz"},
    }
    return {
        f"ctrlMel.{name}": _when(CONTROLLER_KINDS.mellinger, read)
        for name, read in readers.items()
    }


def _lee_error(target: str, limit: str) -> FleetReader:
    """Return a reader of an error of the set-point, limited as in the controller."""

    def read(rows: Fleet, i: int) -> float:
        error = float(rows["wanted"][i][target]) - float(rows[target][i])
        most = float(rows["lee"][i][limit])
        return min(max(error, -most), most)

    return read


def _lee_angle(axis: str) -> FleetReader:
    """Return a reader of an angle of the wanted attitude R_d, rad.

    R = Rz(yaw) Ry(pitch) Rx(roll)
    """

    def read(rows: Fleet, i: int) -> float:
        d = rows["lee"][i]
        if axis == "x":
            return math.atan2(d["left_z"], d["up_z"])
        if axis == "y":
            return math.asin(min(max(-float(d["ahead_z"]), -1.0), 1.0))
        return math.atan2(d["ahead_y"], d["ahead_x"])

    return read


def _read_lee() -> dict[str, FleetReader]:
    degree = CONTROLLER_LOG_SCALES.radians_per_degree
    gains = [f"{gain}{axis}" for gain in ("KR_", "Kw_") for axis in "xyz"]
    gains += [f"Kpos_{kind}{axis}" for kind in "PD" for axis in "xyz"]
    readers = {
        "thrustSi": _field_reader("force"),
        **{f"torque{axis}": _field_reader(f"torque_{axis}") for axis in "xyz"},
        "rpyx": _field_reader("roll", degree),
        "rpyy": _field_reader("pitch", -degree),
        "rpyz": _field_reader("yaw", degree),
        **{f"rpyd{axis}": _lee_angle(axis) for axis in "xyz"},
        **{f"error_pos{axis}": _lee_error(axis, "Kpos_P_limit") for axis in "xyz"},
        **{
            f"error_vel{axis}": _lee_error(f"v{axis}", "Kpos_D_limit") for axis in "xyz"
        },
        **{f"omega{axis}": _rate(axis) for axis in "xyz"},
        **{f"omegar{axis}": _part("lee", f"wd{axis}") for axis in "xyz"},
    }
    return {
        **{f"ctrlLee.{name}": _part("lee", name) for name in gains},
        **{
            f"ctrlLee.{name}": _when(CONTROLLER_KINDS.lee, read)
            for name, read in readers.items()
        },
    }


# The estimator and the gyroscope


def _body_velocity(k: int) -> FleetReader:
    """Return a reader of the velocity along the body's axis k, m/s."""

    def read(rows: Fleet, i: int) -> float:
        row = rows[i]
        q = (float(row["qx"]), float(row["qy"]), float(row["qz"]), float(row["qw"]))
        axis = rotation_columns(q)[k]
        v = (float(row["vx"]), float(row["vy"]), float(row["vz"]))
        return axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2]

    return read


def _attitude_error(rows: Fleet, i: int) -> float:
    """Return 0: the estimator moves the attitude error into the quaternion at each update."""
    return 0.0


def _raw_rate(axis: str) -> FleetReader:
    """Return a reader of the gyroscope's reading without unit; of the filtered rate, as chosen."""

    def read(rows: Fleet, i: int) -> float:
        raw = float(rows[f"g{axis}"][i]) * CONTROLLER_LOG_SCALES.raw_per_rate
        if math.isnan(raw):
            return 0.0
        return min(max(raw, -LARGEST_RAW_READING), LARGEST_RAW_READING)

    return read


CONTROLLER_LOG_READERS: dict[str, FleetReader] = {
    **_read_pids(),
    "posCtl.bodyX": _heading_reader("x", "y", 1.0),
    "posCtl.bodyY": _heading_reader("y", "x", -1.0),
    "posCtl.bodyVX": _heading_reader("vx", "vy", 1.0),
    "posCtl.bodyVY": _heading_reader("vy", "vx", -1.0),
    **_read_mellinger(),
    **_read_lee(),
    **{f"kalman.stateP{axis}": _body_velocity(k) for k, axis in enumerate("XYZ")},
    **{f"kalman.stateD{k}": _attitude_error for k in range(3)},
    "kalman.varD0": _field_reader("xy_tt"),
    "kalman.varD1": _field_reader("xy_tt"),
    "kalman.varD2": _field_reader("yaw_var"),
    **{f"gyro.{axis}Raw": _raw_rate(axis) for axis in "xyz"},
}
"""Readers of the log variables by name."""


ATTITUDE_FILTER_FIELDS = {
    **{f"q{axis}": f"q{axis}" for axis in "wxyz"},
    **{f"gravity{axis.upper()}": f"gravity_{axis}" for axis in "xyz"},
    "accZbase": "base_force",
    "isCalibrated": "calibrated",
}
"""Fields of the log variables of the group sensfusion6."""
INDI_FIELDS = {
    **{
        f"ctrlINDI.cmd_{name}": f"u_{letter}"
        for name, letter in (("roll", "p"), ("pitch", "q"), ("yaw", "r"))
    },
    **{f"ctrlINDI.u_act_dyn_{letter}": f"reached_{letter}" for letter in "pqr"},
    **{f"ctrlINDI.Omega_f_{letter}": f"rate_{letter}" for letter in "pqr"},
    "ctrlINDI.du_r": "du_r",
    "ctrlINDI.n_p": "wanted_roll",
    "ctrlINDI.n_q": "wanted_pitch",
    "ctrlINDI.n_r": "wanted_yaw",
    "posCtrlIndi.cmd_phi": "outer_roll",
    "posCtrlIndi.cmd_theta": "outer_pitch",
    "posCtrlIndi.T_incremented": "outer_thrust",
    "posCtrlIndi.T_inner": "reached_thrust",
}
"""Fields of the log variables of INDI."""
_supervisor = EntryPoints(supervisor)
FIRMWARE_LOG_READERS: dict[str, FleetReader] = {
    **CONTROLLER_LOG_READERS,
    **{f"stateEstimate.{name}": _field_reader(name) for name in LOG_FIELDS.state},
    **{
        f"stateEstimate.a{axis}": _field_reader(f"ac{axis}", 1.0 / FIRMWARE_GRAVITY)
        for axis in LOG_FIELDS.axes
    },
    **{
        f"stateEstimateZ.{name}": _int16_reader(name, 1000.0)
        for name in LOG_FIELDS.state[:6]
    },
    **{f"stateEstimateZ.a{axis}": _int16_reader(f"ac{axis}", 1000.0) for axis in "xy"},
    "stateEstimateZ.az": _int16_reader("acz", 1000.0, 1000.0 * FIRMWARE_GRAVITY),
    **{f"kalman.state{axis.upper()}": _field_reader(axis) for axis in LOG_FIELDS.axes},
    **{
        f"kalman.var{name}": _field_reader(field)
        for name, field in VARIANCE_FIELDS.items()
    },
    **{
        f"sensfusion6.{name}": _part_reader("complementary", field)
        for name, field in ATTITUDE_FILTER_FIELDS.items()
    },
    **{name: _part_reader("indi", field) for name, field in INDI_FIELDS.items()},
    "sensfusion6.isInit": lambda rows, i: 1.0,
    "posEstAlt.estimatedZ": _part_reader("complementary", "height"),
    "posEstAlt.estVZ": _part_reader("complementary", "climb"),
    "posEstAlt.velocityZ": _part_reader("complementary", "speed"),
    "baro.asl": _field_reader("asl"),
    **{
        f"health.motorVar{axis.upper()}M{k + 1}": _motor_variance_reader(axis, k)
        for axis in "xy"
        for k in range(4)
    },
    "health.motorPass": _part_reader("health", "passed"),
    "health.motorTestCount": _part_reader("health", "count"),
    "health.batterySag": _part_reader("health", "sag"),
    "health.batteryPass": _part_reader("health", "battery_passed"),
    **{f"kalman.q{k}": _field_reader(f"q{c}") for k, c in enumerate("wxyz")},
    **{
        f"stabilizer.{name}": _field_reader(name)
        for name in ("roll", "pitch", "yaw", "thrust")
    },
    **{f"gyro.{axis}": _field_reader(f"g{axis}") for axis in LOG_FIELDS.axes},
    **{f"acc.{axis}": _field_reader(f"a{axis}") for axis in LOG_FIELDS.axes},
    **{
        f"controller.{name}": _field_reader(f"target_{name}")
        for name in ("roll", "pitch", "yaw")
    },
    **{
        f"controller.{name}Rate": _field_reader(f"target_{name}_rate")
        for name in ("roll", "pitch", "yaw")
    },
    **{
        f"controller.cmd_{name}": _field_reader(f"{name}_out")
        for name in ("roll", "pitch", "yaw")
    },
    "controller.cmd_thrust": _field_reader("thrust"),
    **{f"ctrltarget.{n}": _target_reader(n) for n in LOG_FIELDS.target},
    **{f"ctrltarget.mode_{n}": _target_reader(f"mode_{n}") for n in LOG_FIELDS.modes},
    **{f"motor.m{k + 1}": _motor_reader("ratio", k) for k in range(4)},
    **{f"motor.m{k + 1}req": _motor_reader("uncapped_ratio", k) for k in range(4)},
    "pm.vbat": _field_reader("vbat"),
    "pm.vbatMV": _int16_reader("vbat", 1000.0),
    "supervisor.info": lambda rows, i: float(_supervisor.information(rows, i)),
    "sys.canfly": lambda rows, i: float(_supervisor.information(rows, i) >> 3 & 1),
    "sys.isFlying": _field_reader("flying"),
    "sys.isTumbled": _field_reader("tumbled"),
}


def read_log_variable(rows: Fleet, row: int, name: str) -> float:
    """Return a log variable now.

    Raises ConfigError with the nearest names if there is no such variable.
    """
    if name in FIRMWARE_LOG_READERS:
        return FIRMWARE_LOG_READERS[name](rows, row)
    near = (
        difflib.get_close_matches(name, FIRMWARE_LOG_READERS, n=3)
        or sorted(FIRMWARE_LOG_READERS)[:3]
    )
    raise ConfigError(
        "firmware log variable",
        name,
        f"the {len(FIRMWARE_LOG_READERS)} that are simulated, such as {', '.join(near)}",
    )
