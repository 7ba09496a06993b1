"""The firmware's log variables by name, in its units; the pitch is positive nose up."""

import difflib
import math
from collections.abc import Callable

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import GRAVITY
from crazychoir.simulation.onboard import supervisor
from crazychoir.simulation.onboard.record import Fleet, entries
from crazychoir.simulation.onboard.units import FULL

Read = Callable[[Fleet, int], float]


def _target(name: str) -> Read:
    return lambda rows, i: float(rows["wanted"][name][i])


def _field(name: str, factor: float = 1.0) -> Read:
    return lambda rows, i: float(rows[name][i]) * factor


def whole(value: float, low: float, high: float) -> int:
    """Truncate to an integer within a range; 0 for a value that is not a number."""
    return 0 if math.isnan(value) else int(min(max(value, low), high))


def _whole(name: str, factor: float = 1.0) -> Read:
    """Return a reader of a field, scaled by factor and limited to a 16-bit integer."""
    return lambda rows, i: float(
        whole(float(rows[name][i]) * factor, -32768.0, 32767.0)
    )


def _motor(k: int) -> Read:
    return lambda rows, i: float(whole(float(rows["request"][i, k]), 0.0, FULL))


AXES = ("x", "y", "z")
STATE = (
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
TARGET = (
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
MODES = ("x", "y", "z", "roll", "pitch", "yaw", "quat")
VARIANCES = {
    "X": "xy_pp",
    "Y": "xy_pp",
    "Z": "z_pp",
    "PX": "xy_vv",
    "PY": "xy_vv",
    "PZ": "z_vv",
}
"""Fields of the firmware's variances by its names: X is a position, PX a velocity."""
_supervisor = entries(supervisor)
TABLE: dict[str, Read] = {
    **{f"stateEstimate.{name}": _field(name) for name in STATE},
    **{f"stateEstimate.a{axis}": _field(f"ac{axis}", 1.0 / GRAVITY) for axis in AXES},
    **{f"stateEstimateZ.{name}": _whole(name, 1000.0) for name in STATE[:6]},
    **{f"stateEstimateZ.a{axis}": _whole(f"ac{axis}", 1000.0) for axis in AXES},
    **{f"kalman.state{axis.upper()}": _field(axis) for axis in AXES},
    **{f"kalman.var{name}": _field(field) for name, field in VARIANCES.items()},
    **{f"kalman.q{k}": _field(f"q{c}") for k, c in enumerate("wxyz")},
    **{
        f"stabilizer.{name}": _field(name)
        for name in ("roll", "pitch", "yaw", "thrust")
    },
    **{f"gyro.{axis}": _field(f"g{axis}") for axis in AXES},
    **{f"acc.{axis}": _field(f"a{axis}") for axis in AXES},
    **{
        f"controller.{name}": _field(f"target_{name}")
        for name in ("roll", "pitch", "yaw")
    },
    **{
        f"controller.{name}Rate": _field(f"target_{name}_rate")
        for name in ("roll", "pitch", "yaw")
    },
    **{
        f"controller.cmd_{name}": _field(f"{name}_out")
        for name in ("roll", "pitch", "yaw")
    },
    "controller.cmd_thrust": _field("thrust"),
    **{f"ctrltarget.{n}": _target(n) for n in TARGET},
    **{f"ctrltarget.mode_{n}": _target(f"mode_{n}") for n in MODES},
    **{f"motor.m{k + 1}": _motor(k) for k in range(4)},
    **{f"motor.m{k + 1}req": _motor(k) for k in range(4)},
    "pm.vbat": _field("vbat"),
    "pm.vbatMV": _whole("vbat", 1000.0),
    "supervisor.info": lambda rows, i: float(_supervisor.information(rows, i)),
    "sys.canfly": lambda rows, i: float(_supervisor.can_fly(rows, i)),
    "sys.isFlying": _field("flying"),
    "sys.isTumbled": _field("tumbled"),
}


def read(rows: Fleet, row: int, name: str) -> float:
    """Return a log variable now.

    Raises ConfigError with the nearest names if there is no such variable.
    """
    if name in TABLE:
        return TABLE[name](rows, row)
    near = difflib.get_close_matches(name, TABLE, n=3) or sorted(TABLE)[:3]
    raise ConfigError(
        "firmware log variable",
        name,
        f"the {len(TABLE)} that are simulated, such as {', '.join(near)}",
    )
