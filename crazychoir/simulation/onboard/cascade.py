"""Controller 1 of the firmware: position, velocity, attitude and rate PIDs in a cascade.

Angles are in degrees with the pitch positive nose up, as in the firmware, so the body's rate about
y is negated.
"""

import math

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import clip
from crazychoir.platforms import MOST_TURN
from crazychoir.simulation.onboard import pid
from crazychoir.simulation.onboard.record import (
    ABSOLUTE,
    DISABLE,
    LEGACY,
    VELOCITY,
    Record,
)

ATTITUDE_RATE = 500.0  # Hz: attitude and rate PIDs
POSITION_RATE = 100.0  # Hz: position and velocity PIDs
POSITION_TICKS = 10  # ms: period of the position and velocity PIDs
OVERHEAD = (
    1.1  # limits inside the position and velocity PIDs, relative to the parameters
)
THRUST_SCALE = 1000.0  # thrust command a unit of the vertical velocity PID
MOST_THRUST = 65535.0  # greatest thrust command
SLOWEST_CLIMB = 0.5  # m/s: lower bound of the limit of the vertical speed


@kernel()
def modes(sp: Record) -> int:
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
def _reset_attitude(fw: Record) -> None:
    pid.reset(fw.roll_pid)
    pid.reset(fw.pitch_pid)
    pid.reset(fw.yaw_pid)
    pid.reset(fw.roll_rate_pid)
    pid.reset(fw.pitch_rate_pid)
    pid.reset(fw.yaw_rate_pid)


@kernel()
def _reset_position(fw: Record) -> None:
    pid.reset(fw.x_pid)
    pid.reset(fw.y_pid)
    pid.reset(fw.z_pid)
    pid.reset(fw.vx_pid)
    pid.reset(fw.vy_pid)
    pid.reset(fw.vz_pid)


@kernel()
def reset(fw: Record) -> None:
    """Reset all PIDs; the heading to hold is the present one."""
    _reset_attitude(fw)
    _reset_position(fw)
    fw.target_yaw = fw.yaw


@kernel()
def position(fw: Record, sp: Record) -> None:
    """Run the position PIDs, which give velocities in axes turned by the yaw alone; at 100 Hz."""
    c = math.cos(math.radians(fw.yaw))
    s = math.sin(math.radians(fw.yaw))
    fw.x_pid.limit = OVERHEAD * fw.x_vel_max
    fw.y_pid.limit = OVERHEAD * fw.y_vel_max
    fw.z_pid.limit = OVERHEAD * max(fw.z_vel_max, SLOWEST_CLIMB)
    ahead = sp.vx if sp.body_velocity else sp.vx * c + sp.vy * s
    aside = sp.vy if sp.body_velocity else sp.vy * c - sp.vx * s
    if sp.mode_x == ABSOLUTE:
        ahead = pid.follow_smooth(
            fw.x_pid, sp.x * c + sp.y * s, fw.x * c + fw.y * s, POSITION_RATE
        )
    if sp.mode_y == ABSOLUTE:
        aside = pid.follow_smooth(
            fw.y_pid, sp.y * c - sp.x * s, fw.y * c - fw.x * s, POSITION_RATE
        )
    climb = sp.vz
    if sp.mode_z == ABSOLUTE:
        climb = pid.follow_smooth(fw.z_pid, sp.z, fw.z, POSITION_RATE)
    fw.target_vx = ahead
    fw.target_vy = aside
    fw.target_vz = climb
    velocity(fw, ahead, aside, climb, c, s)


@kernel()
def velocity(
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
    fw.vx_pid.limit = OVERHEAD * fw.pitch_limit
    fw.vy_pid.limit = OVERHEAD * fw.roll_limit
    pitch = -pid.follow_smooth(fw.vx_pid, ahead, fw.vx * c + fw.vy * s, POSITION_RATE)
    roll = -pid.follow_smooth(fw.vy_pid, aside, fw.vy * c - fw.vx * s, POSITION_RATE)
    fw.target_pitch = clip(pitch, -fw.pitch_limit, fw.pitch_limit)
    fw.target_roll = clip(roll, -fw.roll_limit, fw.roll_limit)
    thrust = (
        THRUST_SCALE * pid.follow_smooth(fw.vz_pid, climb, fw.vz, POSITION_RATE)
        + fw.thrust_base
    )
    fw.position_thrust = clip(thrust, fw.thrust_minimum, MOST_THRUST)


@kernel()
def _heading(fw: Record, sp: Record) -> None:
    """Update the heading to hold; a yaw rate is integrated."""
    if sp.mode_yaw == VELOCITY:
        yaw = fw.target_yaw + sp.yaw_rate / ATTITUDE_RATE
        if fw.yaw_max_delta > 0.0:
            ahead = pid.wrap_degrees(yaw - fw.yaw)
            yaw = fw.yaw + clip(ahead, -fw.yaw_max_delta, fw.yaw_max_delta)
        fw.target_yaw = pid.wrap_degrees(yaw)
    elif sp.mode_yaw == ABSOLUTE or sp.mode_quat == ABSOLUTE:
        fw.target_yaw = sp.yaw


@kernel()
def _attitude(fw: Record, sp: Record) -> None:
    """Run the attitude PIDs, which give rates; an axis in rate mode takes the set-point's rate."""
    if sp.mode_roll == VELOCITY:
        fw.target_roll_rate = sp.roll_rate
        pid.reset(fw.roll_pid)
    else:
        fw.target_roll_rate = pid.follow(
            fw.roll_pid, fw.target_roll, fw.roll, ATTITUDE_RATE
        )
    if sp.mode_pitch == VELOCITY:
        fw.target_pitch_rate = sp.pitch_rate
        pid.reset(fw.pitch_pid)
    else:
        fw.target_pitch_rate = pid.follow(
            fw.pitch_pid, fw.target_pitch, fw.pitch, ATTITUDE_RATE
        )
    fw.target_yaw_rate = pid.follow_angle(
        fw.yaw_pid, fw.target_yaw, fw.yaw, ATTITUDE_RATE
    )


@kernel()
def _whole(value: float) -> float:
    """Return the command as a 16-bit integer keeps it."""
    return float(np.trunc(clip(value, -MOST_TURN, MOST_TURN)))


@kernel()
def control(fw: Record, sp: Record) -> None:
    """Make one pass at 500 Hz: write thrust 0..65535 and roll, pitch, yaw -32767..32767.

    A change of any mode, or no thrust, resets all PIDs.
    Chosen: the position part runs at once after a change of mode.
    """
    key = modes(sp)
    changed = key != fw.modes
    if changed:
        fw.modes = key
        reset(fw)
    positioned = sp.mode_x != DISABLE or sp.mode_y != DISABLE or sp.mode_z != DISABLE
    if positioned and (changed or fw.tick % POSITION_TICKS == 0):
        position(fw, sp)
    if sp.mode_x == DISABLE or sp.mode_y == DISABLE:
        fw.target_roll = sp.roll
        fw.target_pitch = sp.pitch
    fw.output = LEGACY
    fw.thrust = sp.thrust if sp.mode_z == DISABLE else fw.position_thrust
    if fw.thrust <= 0.0:
        fw.thrust = fw.roll_out = fw.pitch_out = fw.yaw_out = 0.0
        reset(fw)
        return
    _heading(fw, sp)
    _attitude(fw, sp)
    fw.roll_out = _whole(
        pid.follow(fw.roll_rate_pid, fw.target_roll_rate, fw.gx, ATTITUDE_RATE)
    )
    fw.pitch_out = _whole(
        pid.follow(fw.pitch_rate_pid, fw.target_pitch_rate, -fw.gy, ATTITUDE_RATE)
    )
    fw.yaw_out = _whole(
        -pid.follow(fw.yaw_rate_pid, fw.target_yaw_rate, fw.gz, ATTITUDE_RATE)
    )
