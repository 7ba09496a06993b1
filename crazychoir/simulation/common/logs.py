"""Log variables of the drones of the lightweight world."""

import math
from collections.abc import Callable

from crazychoir.numerics.math3d import rotation
from crazychoir.types import State

StateReader = Callable[[State], float]


def _compute_attitude(state: State) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in degrees, with R = Rz(yaw) Ry(-pitch) Rx(roll).

    The sign of the pitch is the firmware's: positive with the nose up.
    """
    r = rotation(state.q)
    roll = math.atan2(r[2, 1], r[2, 2])
    pitch = math.asin(min(1.0, max(-1.0, r[2, 0])))
    return (
        math.degrees(roll),
        math.degrees(pitch),
        math.degrees(math.atan2(r[1, 0], r[0, 0])),
    )


def _state_reader(k: int, factor: float = 1.0) -> StateReader:
    return lambda state: factor * float(state.flat[k])


def _angle_reader(k: int) -> StateReader:
    return lambda state: _compute_attitude(state)[k]


LIGHTWEIGHT_LOG_READERS: dict[str, StateReader] = {
    **{
        f"stateEstimate.{name}": _state_reader(k)
        for k, name in enumerate(("x", "y", "z", "vx", "vy", "vz"))
    },
    **{
        f"gyro.{axis}": _state_reader(10 + k, math.degrees(1.0))
        for k, axis in enumerate("xyz")
    },
    **{
        f"stabilizer.{name}": _angle_reader(k)
        for k, name in enumerate(("roll", "pitch", "yaw"))
    },
}
"""Functions that compute each log variable of a lightweight drone from its state.

The drone has no firmware; the names and units are nevertheless those of the firmware.
"""
