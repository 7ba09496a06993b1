"""The effect of set-points, plans and stops, from the units of packets to SI units."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.firmware.memories import TRAJECTORY_KINDS
from crazychoir.radio.protocol.compressed import unpack_quaternion
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.units import convert_thrust_to_newtons


@dataclass(frozen=True, slots=True)
class PacketUnits:
    """The units of packets in SI units."""

    thousandth: float = 1e-3
    """SI units in a thousandth."""
    degree: float = math.pi / 180.0
    """Radians in a degree."""


PACKET_UNITS = PacketUnits()


def _set_full_state(on: Onboard, *values: float) -> None:
    """Apply a full state in mm, mm/s, mm/s2, and mrad/s of the body."""
    milli = np.array([*values[:9], *values[10:]]) * PACKET_UNITS.thousandth
    on.setpoints.full_state(
        np.array([*milli[:9], *unpack_quaternion(int(values[9])), *milli[9:]])
    )


def _spiral(on: Onboard, group: int, sideways: int, clockwise: int, *arc: float) -> int:
    angle, r0, r1, climb, duration = arc
    return on.planner.spiral(
        angle, r0, r1, climb, duration, bool(sideways), bool(clockwise)
    )


def _take_off(
    on: Onboard, group: int, height: float, yaw: float, keep: bool, duration: float
) -> int:
    return on.planner.take_off(height, duration, None if keep else yaw)


def _land(
    on: Onboard, group: int, height: float, yaw: float, keep: bool, duration: float
) -> int:
    return on.planner.land(height, duration, None if keep else yaw)


def _take_off_at_speed(
    on: Onboard,
    group: int,
    height: float,
    relative: bool,
    yaw: float,
    keep: bool,
    speed: float,
) -> int:
    here = _planned_height(on)
    goal = here + height if relative else height
    return on.planner.take_off(
        goal, abs(goal - here) / speed if speed > 0.0 else None, None if keep else yaw
    )


def _land_at_speed(
    on: Onboard,
    group: int,
    height: float,
    relative: bool,
    yaw: float,
    keep: bool,
    speed: float,
) -> int:
    here = _planned_height(on)
    goal = here - height if relative else height
    return on.planner.land(
        goal, abs(goal - here) / speed if speed > 0.0 else None, None if keep else yaw
    )


def _planned_height(on: Onboard) -> float:
    """Return the height of the planner's last set-point, m."""
    return float(on.record["planner"]["last"][2])


def _go_to(on: Onboard, group: int, relative: int, linear: int, *goal: float) -> int:
    x, y, z, yaw, duration = goal
    return on.planner.go_to((x, y, z), yaw, duration, bool(relative), bool(linear))


def _start_trajectory(
    on: Onboard,
    group: int,
    relative: int,
    rel_yaw: int,
    reverse: int,
    slot: int,
    timescale: float,
) -> int:
    return on.planner.start_trajectory(
        slot, timescale, bool(relative), bool(rel_yaw), bool(reverse)
    )


def _define_trajectory(
    on: Onboard, slot: int, location: int, kind: int, offset: int, pieces: int
) -> int:
    is_known = location == TRAJECTORY_KINDS.memory and kind in (
        TRAJECTORY_KINDS.polynomial,
        TRAJECTORY_KINDS.compressed,
    )
    return on.trajectories.define_trajectory(
        slot, offset, pieces if is_known else 0, kind == TRAJECTORY_KINDS.compressed
    )


def _stop_planner(on: Onboard, group: int) -> int:
    on.planner.stop()
    return 0


def _set_z_distance(
    on: Onboard, roll: float, pitch: float, rate: float, z: float
) -> None:
    on.setpoints.z_distance(
        PACKET_UNITS.degree * roll,
        -PACKET_UNITS.degree * pitch,
        PACKET_UNITS.degree * rate,
        z,
    )


def _set_altitude_hold(
    on: Onboard, roll: float, pitch: float, rate: float, vz: float
) -> None:
    on.setpoints.altitude_hold(
        PACKET_UNITS.degree * roll,
        -PACKET_UNITS.degree * pitch,
        PACKET_UNITS.degree * rate,
        vz,
    )


def _set_velocity(on: Onboard, vx: float, vy: float, vz: float, rate: float) -> None:
    on.setpoints.velocity((vx, vy, vz), PACKET_UNITS.degree * rate)


def _set_hover(on: Onboard, vx: float, vy: float, rate: float, z: float) -> None:
    on.setpoints.hover(vx, vy, PACKET_UNITS.degree * rate, z)


def apply_manual(
    on: Onboard, roll: float, pitch: float, yaw: float, thrust: float, rates: int
) -> None:
    """Apply a manual set-point.

    roll: deg, or deg/s if `rates` is 1
    pitch: deg, or deg/s if `rates` is 1; positive nose up
    yaw: deg/s
    thrust: 0 to 65535
    """
    on.setpoints.manual(
        convert_thrust_to_newtons(thrust, on.firmware),
        PACKET_UNITS.degree * roll,
        -PACKET_UNITS.degree * pitch,
        PACKET_UNITS.degree * yaw,
        rates == 1,
    )


def _ignore_result(taken: bool) -> None:
    """Ignore whether a set-point was accepted: it gets no answer."""


COMMAND_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "stop": lambda on: _ignore_result(on.setpoints.stop_setpoint()),
    "velocity_world_legacy": lambda on, vx, vy, vz, rate: _set_velocity(
        on, vx, vy, vz, -rate
    ),
    "z_distance_legacy": lambda on, roll, pitch, rate, z: _set_z_distance(
        on, roll, pitch, -rate, z
    ),
    "hover_legacy": lambda on, vx, vy, rate, z: _set_hover(on, vx, vy, -rate, z),
    "altitude_hold": _set_altitude_hold,
    "full_state": _set_full_state,
    "velocity_world": _set_velocity,
    "z_distance": _set_z_distance,
    "hover": _set_hover,
    "position": lambda on, x, y, z, yaw: _ignore_result(
        on.setpoints.position((x, y, z), PACKET_UNITS.degree * yaw)
    ),
    "manual": apply_manual,
    "notify_setpoint_stop": lambda on, remain: on.notify_setpoint_stop(),
    "planner_stop": _stop_planner,
    "define_trajectory": _define_trajectory,
    "take_off": _take_off,
    "land": _land,
    "take_off_with_velocity": _take_off_at_speed,
    "land_with_velocity": _land_at_speed,
    "spiral": _spiral,
    "go_to": _go_to,
    "go_to_legacy": lambda on, group, relative, *goal: _go_to(
        on, group, relative, 0, *goal
    ),
    "start_trajectory": _start_trajectory,
    "start_trajectory_legacy": lambda on, group, relative, *rest: _start_trajectory(
        on, group, relative, 0, *rest
    ),
    "emergency_stop": lambda on: on.emergency_stop(),
    "emergency_stop_watchdog": lambda on: on.emergency_stop_watchdog(),
    "supervisor_stop": lambda on: on.emergency_stop(),
    "supervisor_watchdog": lambda on: on.emergency_stop_watchdog(),
}
"""Function of each form; its result is the answer if the port answers."""
