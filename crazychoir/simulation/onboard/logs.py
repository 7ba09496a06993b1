"""The firmware's log variables by name, in its units; the pitch is positive nose up."""

import difflib
import math
from collections.abc import Callable
from dataclasses import dataclass

from crazychoir.errors import ConfigError
from crazychoir.simulation.onboard import supervisor
from crazychoir.simulation.onboard.record import EntryPoints, Fleet
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY

FleetReader = Callable[[Fleet, int], float]


def _target_reader(name: str) -> FleetReader:
    """Return a reader of a field of the set-point; its yaw is the rate, as in the firmware."""
    field = "yaw_rate" if name == "yaw" else name
    return lambda rows, i: float(rows["wanted"][field][i])


def _field_reader(name: str, factor: float = 1.0) -> FleetReader:
    return lambda rows, i: float(rows[name][i]) * factor


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
_supervisor = EntryPoints(supervisor)
FIRMWARE_LOG_READERS: dict[str, FleetReader] = {
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
