"""Log variables of the drones of the lightweight world."""

import math
from collections.abc import Callable

from crazychoir.numerics.math3d import rotation
from crazychoir.types import State

Read = Callable[[State], float]


def _attitude(state: State) -> tuple[float, float, float]:
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


def _flat(k: int, factor: float = 1.0) -> Read:
    return lambda state: factor * float(state.flat[k])


def _angle(k: int) -> Read:
    return lambda state: _attitude(state)[k]


LIGHT: dict[str, Read] = {
    **{
        f"stateEstimate.{name}": _flat(k)
        for k, name in enumerate(("x", "y", "z", "vx", "vy", "vz"))
    },
    **{
        f"gyro.{axis}": _flat(10 + k, math.degrees(1.0)) for k, axis in enumerate("xyz")
    },
    **{
        f"stabilizer.{name}": _angle(k)
        for k, name in enumerate(("roll", "pitch", "yaw"))
    },
}
"""Functions that compute each log variable of a lightweight drone from its state.

The drone has no firmware; the names and units are nevertheless those of the firmware.
"""
