"""Set-points of a thrust with body rates or angles, for one drone or for many, in SI units."""

import math

from crazychoir.numerics.kernels import kernel, matrix, vector, wholes
from crazychoir.numerics.math3d import clip
from crazychoir.simulation.onboard.commander import SETPOINT_PRIORITIES, rpyt
from crazychoir.simulation.onboard.record import Fleet, rows, whole
from crazychoir.simulation.onboard.supervisor import request_arming
from crazychoir.simulation.onboard.units import (
    FULL_THRUST_COMMAND,
    convert_roll_pitch_yaw_rate_to_raw,
    scale_thrust_to_raw,
)
from crazychoir.types import Ints, Mat, Vec

RADIO_PRIORITY = float(SETPOINT_PRIORITIES.crtp)
"""Priority of a set-point that the radio brings."""


@kernel(rows, whole, vector)
def give_thrust_setpoint(fleet: Fleet, i: int, u: Vec) -> bool:
    """Give drone i the set-point u; return False if it is refused.

    It is refused if a number is not finite, or if a source with a higher priority is in control.

    u: (4,): thrust N, then body rates rad/s; or roll, pitch rad and yaw rate rad/s, by the modes
        flightmode.stabModeRoll, .stabModePitch and .stabModeYaw. A positive pitch is nose down.
    """
    roll, pitch, yaw = convert_roll_pitch_yaw_rate_to_raw(u[1], u[2], u[3])
    thrust = scale_thrust_to_raw(u[0], fleet[i].thrust_max)
    if not math.isfinite(thrust) or not math.isfinite(roll + pitch + yaw):
        return False
    thrust = clip(thrust, 0.0, FULL_THRUST_COMMAND)
    return rpyt(fleet, i, roll, pitch, yaw, thrust, RADIO_PRIORITY)


@kernel(rows, whole, vector)
def stream_thrust_setpoint(fleet: Fleet, i: int, u: Vec) -> bool:
    """Unlock the thrust of drone i if it is locked, and give the set-point u.

    Returns False if the set-point is refused.
    """
    if fleet[i].locked_thrust != 0:
        rpyt(fleet, i, 0.0, 0.0, 0.0, 0.0, RADIO_PRIORITY)
    return give_thrust_setpoint(fleet, i, u)


@kernel(rows, matrix, wholes, wholes)
def stream_thrust_setpoints(
    fleet: Fleet, inputs: Mat, is_new: Ints, needs_arming: Ints
) -> None:
    """Stream the new set-points of all drones.

    The first set-point that turns the motors arms a drone that needs arming.

    inputs: (n, 4): rows as u of `give_thrust_setpoint`
    is_new: (n,): 1 for a drone with a new set-point
    needs_arming: (n,): 1 for a drone with a firmware that must be armed
    """
    for i in range(inputs.shape[0]):
        if is_new[i] == 0:
            continue
        u = inputs[i]
        is_idle = u[0] == 0.0 and u[1] == 0.0 and u[2] == 0.0 and u[3] == 0.0
        if needs_arming[i] != 0 and fleet[i].armed == 0 and not is_idle:
            request_arming(fleet, i)
        stream_thrust_setpoint(fleet, i, u)
