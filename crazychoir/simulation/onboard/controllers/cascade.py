"""Controller 1 of the firmware: position, velocity, attitude and rate PIDs in a cascade.

Angles are in degrees with the pitch positive nose up, as in the firmware, so the body's rate about
y is negated.
"""

import math
from typing import NamedTuple

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import clip
from crazychoir.platforms import LARGEST_AXIS_COMMAND
from crazychoir.simulation.onboard.controllers import pid
from crazychoir.simulation.onboard.record import (
    AXIS_MODES,
    OUTPUT_KINDS,
    Record,
)


class CascadeSettings(NamedTuple):
    """Rates and limits of the PIDs in the cascade."""

    attitude_rate: float = 500.0
    """Rate in Hz of the attitude and rate PIDs."""
    position_rate: float = 100.0
    """Rate in Hz of the position and velocity PIDs."""
    position_ticks: int = 10
    """Period in ms of the position and velocity PIDs."""
    limit_overhead: float = 1.1
    """Limits inside the position and velocity PIDs, relative to the parameters."""
    thrust_scale: float = 1000.0
    """Thrust command a unit of the vertical velocity PID."""
    largest_thrust: float = 65535.0
    """Greatest thrust command."""
    slowest_climb: float = 0.5
    """Lower bound in m/s of the limit of the vertical speed."""


CASCADE_SETTINGS = CascadeSettings()


@kernel()
def encode_modes(sp: Record) -> int:
    """Return the seven modes as one number, to detect that one has changed."""
    key = 0
    for mode in (
        sp.mode_x,
        sp.mode_y,
        sp.mode_z,
        sp.mode_roll,
        sp.mode_pitch,
        sp.mode_yaw,
        sp.mode_quat,
    ):
        key = 3 * key + mode
    return key


@kernel()
def reset(fw: Record) -> None:
    """Reset all PIDs; the wanted roll and pitch are the present ones, the wanted yaw stays.

    As in the firmware, the derivatives of rates and velocities are taken from 0 afterwards: while
    the drone turns, the next pass gives the motors a kick.
    """
    pid.reset(fw.roll_pid, fw.roll)
    pid.reset(fw.pitch_pid, fw.pitch)
    pid.reset(fw.yaw_pid, fw.yaw)
    pid.reset(fw.roll_rate_pid, 0.0)
    pid.reset(fw.pitch_rate_pid, 0.0)
    pid.reset(fw.yaw_rate_pid, 0.0)
    pid.reset(fw.x_pid, fw.x)
    pid.reset(fw.y_pid, fw.y)
    pid.reset(fw.z_pid, fw.z)
    pid.reset(fw.vx_pid, 0.0)
    pid.reset(fw.vy_pid, 0.0)
    pid.reset(fw.vz_pid, 0.0)
    fw.target_roll = fw.roll
    fw.target_pitch = fw.pitch


@kernel()
def run_position_pids(fw: Record, sp: Record) -> None:
    """Run the position PIDs, which give velocities in axes turned by the yaw alone; at 100 Hz."""
    c = math.cos(math.radians(fw.yaw))
    s = math.sin(math.radians(fw.yaw))
    fw.x_pid.limit = CASCADE_SETTINGS.limit_overhead * fw.x_vel_max
    fw.y_pid.limit = CASCADE_SETTINGS.limit_overhead * fw.y_vel_max
    fw.z_pid.limit = CASCADE_SETTINGS.limit_overhead * max(
        fw.z_vel_max, CASCADE_SETTINGS.slowest_climb
    )
    ahead = sp.vx if sp.body_velocity else sp.vx * c + sp.vy * s
    aside = sp.vy if sp.body_velocity else sp.vy * c - sp.vx * s
    if sp.mode_x == AXIS_MODES.absolute:
        ahead = pid.follow_smooth(
            fw.x_pid,
            sp.x * c + sp.y * s,
            fw.x * c + fw.y * s,
            CASCADE_SETTINGS.position_rate,
        )
    if sp.mode_y == AXIS_MODES.absolute:
        aside = pid.follow_smooth(
            fw.y_pid,
            sp.y * c - sp.x * s,
            fw.y * c - fw.x * s,
            CASCADE_SETTINGS.position_rate,
        )
    climb = sp.vz
    if sp.mode_z == AXIS_MODES.absolute:
        climb = pid.follow_smooth(fw.z_pid, sp.z, fw.z, CASCADE_SETTINGS.position_rate)
    fw.target_vx = ahead
    fw.target_vy = aside
    fw.target_vz = climb
    run_velocity_pids(fw, ahead, aside, climb, c, s)


@kernel()
def run_velocity_pids(
    fw: Record, ahead: float, aside: float, climb: float, c: float, s: float
) -> None:
    """Run the velocity PIDs, which give roll, pitch and thrust.

        pitch = -PID(v ahead), roll = -PID(v left), thrust = 1000 PID(v up) + base

    The tilt is not compensated.
    ahead: m/s: wanted velocity along the heading
    aside: m/s: wanted velocity to its left
    climb: m/s: wanted velocity upwards
    c: cosine of the yaw
    s: sine of the yaw
    """
    fw.vx_pid.limit = CASCADE_SETTINGS.limit_overhead * fw.pitch_limit
    fw.vy_pid.limit = CASCADE_SETTINGS.limit_overhead * fw.roll_limit
    pitch = -pid.follow_smooth(
        fw.vx_pid, ahead, fw.vx * c + fw.vy * s, CASCADE_SETTINGS.position_rate
    )
    roll = -pid.follow_smooth(
        fw.vy_pid, aside, fw.vy * c - fw.vx * s, CASCADE_SETTINGS.position_rate
    )
    fw.target_pitch = clip(pitch, -fw.pitch_limit, fw.pitch_limit)
    fw.target_roll = clip(roll, -fw.roll_limit, fw.roll_limit)
    thrust = (
        CASCADE_SETTINGS.thrust_scale
        * pid.follow_smooth(fw.vz_pid, climb, fw.vz, CASCADE_SETTINGS.position_rate)
        + fw.thrust_base
    )
    fw.position_thrust = clip(
        thrust, fw.thrust_minimum, CASCADE_SETTINGS.largest_thrust
    )


@kernel()
def _update_heading(fw: Record, sp: Record) -> None:
    """Update the heading to hold; a yaw rate is integrated."""
    if sp.mode_yaw == AXIS_MODES.velocity:
        yaw = fw.target_yaw + sp.yaw_rate / CASCADE_SETTINGS.attitude_rate
        if fw.yaw_max_delta > 0.0:
            ahead = pid.wrap_degrees(yaw - fw.yaw)
            yaw = fw.yaw + clip(ahead, -fw.yaw_max_delta, fw.yaw_max_delta)
        fw.target_yaw = pid.wrap_degrees(yaw)
    elif sp.mode_yaw == AXIS_MODES.absolute or sp.mode_quat == AXIS_MODES.absolute:
        fw.target_yaw = pid.wrap_degrees(sp.yaw)


@kernel()
def _run_attitude_pids(fw: Record, sp: Record) -> None:
    """Run the attitude PIDs, which give rates; an axis in rate mode takes the set-point's rate."""
    fw.target_roll_rate = pid.follow(
        fw.roll_pid, fw.target_roll, fw.roll, CASCADE_SETTINGS.attitude_rate
    )
    fw.target_pitch_rate = pid.follow(
        fw.pitch_pid, fw.target_pitch, fw.pitch, CASCADE_SETTINGS.attitude_rate
    )
    fw.target_yaw_rate = pid.follow_angle(
        fw.yaw_pid, fw.target_yaw, fw.yaw, CASCADE_SETTINGS.attitude_rate
    )
    if sp.mode_roll == AXIS_MODES.velocity:
        fw.target_roll_rate = sp.roll_rate
    if sp.mode_pitch == AXIS_MODES.velocity:
        fw.target_pitch_rate = sp.pitch_rate


@kernel()
def _truncate_to_int16(value: float) -> float:
    """Return the command as a 16-bit integer keeps it."""
    return float(np.trunc(clip(value, -LARGEST_AXIS_COMMAND, LARGEST_AXIS_COMMAND)))


@kernel()
def control(fw: Record, sp: Record) -> None:
    """Make one pass at 500 Hz: write thrust 0..65535 and roll, pitch, yaw -32767..32767.

    A change of any mode, or no thrust, resets all PIDs. Between two passes of the position part,
    thrust, roll and pitch stay as they are. Without thrust, the heading to hold is the present one.
    Source of the order: crazyflie-firmware, controller_pid.c.
    """
    key = encode_modes(sp)
    if key != fw.modes:
        fw.modes = key
        reset(fw)
    _update_heading(fw, sp)
    positioned = (
        sp.mode_x != AXIS_MODES.disabled
        or sp.mode_y != AXIS_MODES.disabled
        or sp.mode_z != AXIS_MODES.disabled
    )
    if positioned and fw.tick % CASCADE_SETTINGS.position_ticks == 0:
        run_position_pids(fw, sp)
    if sp.mode_z == AXIS_MODES.disabled:
        fw.position_thrust = sp.thrust
    if sp.mode_x == AXIS_MODES.disabled or sp.mode_y == AXIS_MODES.disabled:
        fw.target_roll = sp.roll
        fw.target_pitch = sp.pitch
    fw.output = OUTPUT_KINDS.legacy
    fw.thrust = fw.position_thrust
    if fw.thrust <= 0.0:
        fw.thrust = fw.roll_out = fw.pitch_out = fw.yaw_out = 0.0
        reset(fw)
        fw.target_yaw = fw.yaw
        return
    _run_attitude_pids(fw, sp)
    fw.roll_out = _truncate_to_int16(
        pid.follow(
            fw.roll_rate_pid, fw.target_roll_rate, fw.gx, CASCADE_SETTINGS.attitude_rate
        )
    )
    fw.pitch_out = _truncate_to_int16(
        pid.follow(
            fw.pitch_rate_pid,
            fw.target_pitch_rate,
            -fw.gy,
            CASCADE_SETTINGS.attitude_rate,
        )
    )
    fw.yaw_out = _truncate_to_int16(
        -pid.follow(
            fw.yaw_rate_pid, fw.target_yaw_rate, fw.gz, CASCADE_SETTINGS.attitude_rate
        )
    )
