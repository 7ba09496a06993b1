"""Set-points: their priorities, their age, and the meaning of each kind.

Angles are in deg, rates in deg/s, and thrusts in 0..65535, as in the packets, where a function does
not say otherwise. A positive pitch means nose up, except in full-state set-points.
"""

import math
from typing import NamedTuple

from crazychoir.firmware.planning import PLANNER_STATES
from crazychoir.numerics.kernels import kernel, real, vector
from crazychoir.numerics.math3d import clip
from crazychoir.simulation.onboard.record import (
    AXIS_MODES,
    YAW_MODES,
    Fleet,
    Record,
    rows,
    whole,
)
from crazychoir.simulation.onboard.units import (
    FULL_THRUST_COMMAND,
    convert_roll_pitch_yaw_rate_to_raw,
    scale_thrust_to_raw,
)
from crazychoir.types import Vec


class SetpointPriorities(NamedTuple):
    """Priorities of the sources of set-points."""

    no_sender: int = 0
    """No source is in control."""
    high_level: int = 1
    """The planner."""
    crtp: int = 2
    """The radio."""
    external: int = 3
    """An external receiver."""


SETPOINT_PRIORITIES = SetpointPriorities()


RPYT_LEAST_THRUST = 1000.0  # thrust command; a smaller one is none
RPYT_MOST_THRUST = 60000.0  # thrust command; a larger one is reduced to this
RPYT_REST_THRUST = 32767.0  # thrust command that holds the height in flightmode.althold
RPYT_DEGREES_PER_SPEED = 30.0  # deg a m/s in flightmode.poshold
RPYT_THRUST_PER_METRE = 1000.0  # thrust commands a m in flightmode.posSet
HALF_RIGHT_ANGLE_COSINE = math.sqrt(0.5)  # cosine and sine of 45 deg


@kernel()
def clear_setpoint(sp: Record) -> None:
    """Write the null set-point: all modes disabled, no thrust."""
    sp.mode_x = sp.mode_y = sp.mode_z = sp.mode_roll = sp.mode_pitch = sp.mode_yaw = (
        sp.mode_quat
    ) = AXIS_MODES.disabled
    sp.body_velocity = 0
    sp.x = sp.y = sp.z = sp.vx = sp.vy = sp.vz = sp.ax = sp.ay = sp.az = sp.jx = (
        sp.jy
    ) = sp.jz = 0.0
    sp.roll = sp.pitch = sp.yaw = sp.roll_rate = sp.pitch_rate = sp.yaw_rate = (
        sp.thrust
    ) = 0.0
    sp.qx = sp.qy = sp.qz = 0.0
    sp.qw = 1.0


@kernel()
def take_control(fw: Record, priority: int) -> bool:
    """Give control to a source of this priority; return False if a higher priority is in control.

    A source above the planner stops the planner's plan. Since crazyflie-firmware 2023.11 the
    planner is idle then: when it is in control again without a new plan, it switches the motors
    off.
    """
    if priority < fw.priority:
        return False
    fw.priority = priority
    fw.stamp = fw.tick
    if priority > SETPOINT_PRIORITIES.high_level:
        fw.planner.state = PLANNER_STATES.idle
    clear_setpoint(fw.wanted)
    return True


@kernel(rows, whole)
def relax(fleet: Fleet, i: int) -> None:
    """Let the planner take over again (notify_setpoint_stop)."""
    fw = fleet[i]
    fw.priority = SETPOINT_PRIORITIES.high_level


@kernel()
def _turn_axes(fw: Record, roll: float, pitch: float) -> None:
    """Write roll and pitch as angles or rates, by flightmode.stabModeRoll and .stabModePitch."""
    sp = fw.wanted
    if fw.rate_roll_mode:
        sp.mode_roll = AXIS_MODES.absolute
        sp.roll = roll
    else:
        sp.mode_roll = AXIS_MODES.velocity
        sp.roll_rate = roll
    if fw.rate_pitch_mode:
        sp.mode_pitch = AXIS_MODES.absolute
        sp.pitch = pitch
    else:
        sp.mode_pitch = AXIS_MODES.velocity
        sp.pitch_rate = pitch


@kernel()
def _hold_height(sp: Record, thrust: float) -> None:
    """Write a climb instead of the thrust: up to 1 m/s at 65535, 0 at 32767."""
    sp.thrust = 0.0
    sp.mode_z = AXIS_MODES.velocity
    sp.vz = (thrust - RPYT_REST_THRUST) / RPYT_REST_THRUST


@kernel()
def _hold_position(sp: Record, roll: float, pitch: float) -> None:
    """Write a velocity in the world instead of roll and pitch: 1 m/s for 30 deg."""
    sp.mode_x = sp.mode_y = AXIS_MODES.velocity
    sp.vx = pitch / RPYT_DEGREES_PER_SPEED
    sp.vy = roll / RPYT_DEGREES_PER_SPEED


@kernel()
def _set_position(
    sp: Record, roll: float, pitch: float, yaw: float, thrust: float
) -> None:
    """Write the position (-pitch, roll, thrust / 1000) m and the heading, deg."""
    sp.mode_x = sp.mode_y = sp.mode_z = sp.mode_yaw = AXIS_MODES.absolute
    sp.x = -pitch
    sp.y = roll
    sp.z = thrust / RPYT_THRUST_PER_METRE
    sp.yaw = yaw
    sp.thrust = 0.0


@kernel()
def _turn_yaw(fw: Record, yaw: float) -> None:
    """Write the heading as an angle or a rate, by flightmode.stabModeYaw.

    With a rate, motor 1 is the front in the plus mode: roll and pitch are turned by 45 deg.
    """
    sp = fw.wanted
    if fw.rate_yaw_mode:
        sp.mode_yaw = AXIS_MODES.absolute
        sp.yaw = yaw
        return
    sp.mode_yaw = AXIS_MODES.velocity
    sp.yaw_rate = -yaw
    if fw.yaw_mode == YAW_MODES.plus:
        roll = sp.roll
        sp.roll = HALF_RIGHT_ANGLE_COSINE * (roll - sp.pitch)
        sp.pitch = HALF_RIGHT_ANGLE_COSINE * (sp.pitch + roll)


@kernel(rows, whole, real, real, real, real, real)
def rpyt(
    fleet: Fleet,
    i: int,
    roll: float,
    pitch: float,
    yaw: float,
    thrust: float,
    priority: float,
) -> bool:
    """Accept an RPYT packet: roll, pitch, yaw (angles or rates) and thrust.

    Thrust is locked until a packet without thrust arrives, and as long as no source has had control.
    A thrust below 1000 counts as none, above 60000 as 60000. The yaw rate has inverted sign in this
    kind of packet only. The modes flightmode.althold, .poshold and .posSet give the numbers another
    meaning. Source: crazyflie-firmware, crtp_commander_rpyt.c.
    """
    fw = fleet[i]
    if fw.priority == SETPOINT_PRIORITIES.no_sender:
        fw.locked_thrust = 1
    if thrust == 0.0:
        fw.locked_thrust = 0
    if not take_control(fw, int(priority)):
        return False
    sp = fw.wanted
    if not fw.locked_thrust and thrust >= RPYT_LEAST_THRUST:
        sp.thrust = min(thrust, RPYT_MOST_THRUST)
    if fw.holds_height:
        _hold_height(sp, thrust)
    if fw.holds_position:
        _hold_position(sp, roll, pitch)
    elif fw.sets_position and thrust != 0.0:
        _set_position(sp, roll, pitch, yaw, thrust)
    else:
        _turn_axes(fw, roll, pitch)
    if not fw.sets_position:
        _turn_yaw(fw, yaw)
    return True


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
    return rpyt(fleet, i, roll, pitch, yaw, thrust, float(SETPOINT_PRIORITIES.crtp))


@kernel(rows, whole, vector)
def stream_thrust_setpoint(fleet: Fleet, i: int, u: Vec) -> bool:
    """Unlock the thrust of drone i if it is locked, and give the set-point u.

    Returns False if the set-point is refused.
    """
    if fleet[i].locked_thrust != 0:
        rpyt(fleet, i, 0.0, 0.0, 0.0, 0.0, float(SETPOINT_PRIORITIES.crtp))
    return give_thrust_setpoint(fleet, i, u)


@kernel(rows, whole, real)
def nothing(fleet: Fleet, i: int, priority: float) -> bool:
    """Accept generic packet 0, stop: the null set-point."""
    fw = fleet[i]
    return take_control(fw, int(priority))


@kernel(rows, whole, real, real, real, real, real)
def velocity(
    fleet: Fleet,
    i: int,
    vx: float,
    vy: float,
    vz: float,
    yaw_rate: float,
    priority: float,
) -> bool:
    """Accept generic packet 8: velocity in the world, yaw rate."""
    fw = fleet[i]
    if not take_control(fw, int(priority)):
        return False
    sp = fw.wanted
    sp.mode_x = sp.mode_y = sp.mode_z = sp.mode_yaw = AXIS_MODES.velocity
    sp.vx = vx
    sp.vy = vy
    sp.vz = vz
    sp.yaw_rate = yaw_rate
    return True


@kernel(rows, whole, real, real, real, real, real)
def z_distance(
    fleet: Fleet,
    i: int,
    roll: float,
    pitch: float,
    yaw_rate: float,
    z: float,
    priority: float,
) -> bool:
    """Accept generic packet 9: roll, pitch, yaw rate and height."""
    fw = fleet[i]
    if not take_control(fw, int(priority)):
        return False
    sp = fw.wanted
    sp.mode_z = sp.mode_roll = sp.mode_pitch = AXIS_MODES.absolute
    sp.mode_yaw = AXIS_MODES.velocity
    sp.z = z
    sp.roll = roll
    sp.pitch = pitch
    sp.yaw_rate = yaw_rate
    return True


@kernel(rows, whole, real, real, real, real, real)
def altitude_hold(
    fleet: Fleet,
    i: int,
    roll: float,
    pitch: float,
    yaw_rate: float,
    vz: float,
    priority: float,
) -> bool:
    """Accept generic packet 4: roll, pitch, yaw rate and speed upwards."""
    fw = fleet[i]
    if not take_control(fw, int(priority)):
        return False
    sp = fw.wanted
    sp.mode_z = sp.mode_yaw = AXIS_MODES.velocity
    sp.mode_roll = sp.mode_pitch = AXIS_MODES.absolute
    sp.vz = vz
    sp.roll = roll
    sp.pitch = pitch
    sp.yaw_rate = yaw_rate
    return True


@kernel(rows, whole, real, real, real, real, real)
def hover(
    fleet: Fleet,
    i: int,
    ahead: float,
    left: float,
    yaw_rate: float,
    z: float,
    priority: float,
) -> bool:
    """Accept generic packet 10: velocity ahead and to the left, yaw rate and height."""
    fw = fleet[i]
    if not take_control(fw, int(priority)):
        return False
    sp = fw.wanted
    sp.mode_x = sp.mode_y = sp.mode_yaw = AXIS_MODES.velocity
    sp.mode_z = AXIS_MODES.absolute
    sp.body_velocity = 1
    sp.vx = ahead
    sp.vy = left
    sp.yaw_rate = yaw_rate
    sp.z = z
    return True


@kernel(rows, whole, real, real, real, real, real)
def position(
    fleet: Fleet, i: int, x: float, y: float, z: float, yaw: float, priority: float
) -> bool:
    """Accept generic packet 7: position and heading."""
    fw = fleet[i]
    if not take_control(fw, int(priority)):
        return False
    sp = fw.wanted
    sp.mode_x = sp.mode_y = sp.mode_z = sp.mode_yaw = AXIS_MODES.absolute
    sp.x = x
    sp.y = y
    sp.z = z
    sp.yaw = yaw
    return True


@kernel(rows, whole, real, real, real, real, real, real)
def manual(
    fleet: Fleet,
    i: int,
    roll: float,
    pitch: float,
    yaw_rate: float,
    thrust: float,
    rate: float,
    priority: float,
) -> bool:
    """Accept generic packet 11: roll, pitch (rates if `rate` is above 0), yaw rate, thrust.

    Choice of this model: there is no thrust lock, and the sign of the yaw rate is not inverted.
    """
    fw = fleet[i]
    if not take_control(fw, int(priority)):
        return False
    sp = fw.wanted
    if rate > 0.0:
        sp.mode_roll = sp.mode_pitch = AXIS_MODES.velocity
        sp.roll_rate = roll
        sp.pitch_rate = pitch
    else:
        sp.mode_roll = sp.mode_pitch = AXIS_MODES.absolute
        sp.roll = roll
        sp.pitch = pitch
    sp.mode_yaw = AXIS_MODES.velocity
    sp.yaw_rate = yaw_rate
    sp.thrust = thrust
    return True


@kernel(rows, whole, vector, real)
def full_state(fleet: Fleet, i: int, s: Vec, priority: float) -> bool:
    """Accept generic packet 6, a full state.

    s: (16,): p m, v m/s, a m/s2 world, q body to world, w rad/s body. A positive pitch rate means
        nose down, as for a right-handed axis
    """
    fw = fleet[i]
    if not take_control(fw, int(priority)):
        return False
    sp = fw.wanted
    sp.mode_x = sp.mode_y = sp.mode_z = sp.mode_quat = AXIS_MODES.absolute
    sp.x = s[0]
    sp.y = s[1]
    sp.z = s[2]
    sp.vx = s[3]
    sp.vy = s[4]
    sp.vz = s[5]
    sp.ax = s[6]
    sp.ay = s[7]
    sp.az = s[8]
    sp.qx = s[9]
    sp.qy = s[10]
    sp.qz = s[11]
    sp.qw = s[12]
    sp.roll_rate = math.degrees(s[13])
    sp.pitch_rate = math.degrees(s[14])
    sp.yaw_rate = math.degrees(s[15])
    x = s[9]
    y = s[10]
    z = s[11]
    w = s[12]
    sp.yaw = math.degrees(
        math.atan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z))
    )
    return True


@kernel()
def write_level_setpoint(fw: Record, old: Record) -> None:
    """Write the set-point that is flown after set-points have ended.

    It is level without a yaw rate; height and thrust stay as before.

    old: set-point that is flown otherwise
    """
    sp = fw.level
    clear_setpoint(sp)
    sp.mode_roll = sp.mode_pitch = AXIS_MODES.absolute
    sp.mode_yaw = AXIS_MODES.velocity
    sp.mode_z = old.mode_z
    sp.z = old.z
    sp.vz = old.vz
    sp.thrust = old.thrust
