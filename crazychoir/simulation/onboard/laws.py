"""Interface of a user's own controller on board: its inputs and its answers."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.simulation.onboard.record import OUTPUT_KINDS, Record
from crazychoir.types import State, Vec

MODE_AXES = ("x", "y", "z", "roll", "pitch", "yaw", "quat")
LAW_PERIOD = 0.002
"""Seconds between two calls of a law."""


@dataclass(frozen=True)
class Modes:
    """Mode of each axis of a set-point: 0 nothing, 1 a value, 2 a rate.

    For x, y and z the rate is a velocity. quat is the attitude as a quaternion.
    """

    x: int
    y: int
    z: int
    roll: int
    pitch: int
    yaw: int
    quat: int
    body_velocity: bool
    """True if the velocity is along the heading instead of along the world's axes."""


@dataclass(frozen=True)
class Setpoint:
    """A set-point of the commander, in SI units."""

    modes: Modes
    """Mode of each axis."""
    p: Vec
    """(3,) m, world: position."""
    v: Vec
    """(3,) m/s, world: velocity; along the heading if modes.body_velocity is True."""
    a: Vec
    """(3,) m/s2, world: acceleration."""
    j: Vec
    """(3,) m/s3, world: jerk."""
    q: Vec
    """(4,): attitude, body to world."""
    roll: float
    """Roll in rad, with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch: float
    """Pitch in rad."""
    yaw: float
    """Yaw in rad."""
    w: Vec
    """(3,) rad/s, body: rates."""
    thrust: float
    """Thrust in N; valid where modes.z is 0."""


class ForceTorque(NamedTuple):
    """An answer of a law: a force along the body's z axis and torques about the body axes."""

    force: float
    """N, along the body's z axis."""
    x: float
    """Torque about the body's x axis, N m."""
    y: float
    """Torque about the body's y axis, N m."""
    z: float
    """Torque about the body's z axis, N m."""


class MotorForces(NamedTuple):
    """An answer of a law: the thrust of each motor."""

    m1: float
    """N, front right."""
    m2: float
    """N, back right."""
    m3: float
    """N, back left."""
    m4: float
    """N, front left."""


class Legacy(NamedTuple):
    """An answer of a law in the firmware's numbers."""

    thrust: float
    """0..65535."""
    roll: float
    """-32767..32767."""
    pitch: float
    """-32767..32767, positive nose up."""
    yaw: float
    """-32767..32767."""


Answer = ForceTorque | MotorForces | Legacy
Law = Callable[[Setpoint, State, Vec, float], Answer]
"""A law is called every 2 ms as law(setpoint, estimate, gyro (3,) rad/s body, dt s)."""


def _read_vector(sp: Record, names: str) -> Vec:
    return np.array([sp[name] for name in names.split()])


def convert_setpoint(sp: Record, thrust_max: float) -> Setpoint:
    """Convert a set-point record to SI units.

    thrust_max: N: greatest thrust of a motor
    """
    x, y, z, roll, pitch, yaw, quat = (int(sp[f"mode_{axis}"]) for axis in MODE_AXES)
    modes = Modes(x, y, z, roll, pitch, yaw, quat, bool(sp["body_velocity"]))
    nose_up = -1.0 if modes.pitch == 2 else 1.0
    rates = np.radians([sp["roll_rate"], nose_up * sp["pitch_rate"], sp["yaw_rate"]])
    return Setpoint(
        modes,
        p=_read_vector(sp, "x y z"),
        v=_read_vector(sp, "vx vy vz"),
        a=_read_vector(sp, "ax ay az"),
        j=_read_vector(sp, "jx jy jz"),
        q=_read_vector(sp, "qx qy qz qw"),
        roll=math.radians(sp["roll"]),
        pitch=-math.radians(sp["pitch"]),
        yaw=math.radians(sp["yaw"]),
        w=rates,
        thrust=float(sp["thrust"]) / 65535.0 * 4.0 * thrust_max,
    )


def write_answer(fw: Record, name: str, answer: object) -> None:
    """Pass a law's answer to the power distribution; a number that is not finite stops the motors.

    Raises ConfigError if the answer has another type.
    """
    if not isinstance(answer, ForceTorque | MotorForces | Legacy):
        raise ConfigError(
            f"controller {name!r}: its answer",
            answer,
            "ForceTorque(force, x, y, z), MotorForces(m1, m2, m3, m4) or Legacy(thrust, roll, pitch, yaw)",
        )
    numbers = answer if math.isfinite(sum(answer)) else (0.0, 0.0, 0.0, 0.0)
    if isinstance(answer, MotorForces):
        fw["output"] = OUTPUT_KINDS.motors
        fw["law_motors"] = [max(f, 0.0) / fw["thrust_max"] * 65535.0 for f in numbers]
    elif isinstance(answer, ForceTorque):
        fw["output"] = OUTPUT_KINDS.force_torque
        fw["force"], fw["torque_x"], fw["torque_y"], fw["torque_z"] = numbers
    else:
        fw["output"] = OUTPUT_KINDS.legacy
        fw["thrust"], fw["roll_out"], fw["pitch_out"], fw["yaw_out"] = numbers
