"""A user's own controller on board: what it is told and what it may answer."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.simulation.onboard.record import FORCE_TORQUE, LEGACY, MOTORS, Record
from crazychoir.types import State, Vec

AXES = ("x", "y", "z", "roll", "pitch", "yaw", "quat")
PERIOD = 0.002
"""s, between two calls of a law."""


@dataclass(frozen=True)
class Modes:
    """What a set-point asks of each axis: 0 nothing, 1 a value, 2 its rate (of x, y, z: a velocity)."""

    x: int
    y: int
    z: int
    roll: int
    pitch: int
    yaw: int
    quat: int
    body_velocity: bool


@dataclass(frozen=True)
class Setpoint:
    """What the commander asks for, SI.

    p m, v m/s, a m/s2, j m/s3: (3,) world (v along the heading with modes.body_velocity);  q: (4,) body to world;
    roll, pitch, yaw: rad, of R = Rz(yaw) Ry(pitch) Rx(roll);  w: (3,) rad/s body;  thrust: N, where modes.z is 0.
    """

    modes: Modes
    p: Vec
    v: Vec
    a: Vec
    j: Vec
    q: Vec
    roll: float
    pitch: float
    yaw: float
    w: Vec
    thrust: float


class ForceTorque(NamedTuple):
    """An answer: force N along the body's z, torque N m about the body axes."""

    force: float
    x: float
    y: float
    z: float


class MotorForces(NamedTuple):
    """An answer: N of each motor: front right, back right, back left, front left."""

    m1: float
    m2: float
    m3: float
    m4: float


class Legacy(NamedTuple):
    """An answer in the firmware's numbers: thrust 0..65535, roll, pitch (nose up), yaw -32767..32767."""

    thrust: float
    roll: float
    pitch: float
    yaw: float


Answer = ForceTorque | MotorForces | Legacy
Law = Callable[[Setpoint, State, Vec, float], Answer]
"""law(setpoint, estimate, gyro (3,) rad/s body, dt s), called every 2 ms."""


def _vector(sp: Record, names: str) -> Vec:
    return np.array([sp[name] for name in names.split()])


def setpoint_of(sp: Record, thrust_max: float) -> Setpoint:
    """The record in SI; thrust_max: N a motor."""
    x, y, z, roll, pitch, yaw, quat = (int(sp[f"mode_{axis}"]) for axis in AXES)
    modes = Modes(x, y, z, roll, pitch, yaw, quat, bool(sp["body_velocity"]))
    nose_up = -1.0 if modes.pitch == 2 else 1.0
    rates = np.radians([sp["roll_rate"], nose_up * sp["pitch_rate"], sp["yaw_rate"]])
    return Setpoint(
        modes,
        p=_vector(sp, "x y z"),
        v=_vector(sp, "vx vy vz"),
        a=_vector(sp, "ax ay az"),
        j=_vector(sp, "jx jy jz"),
        q=_vector(sp, "qx qy qz qw"),
        roll=math.radians(sp["roll"]),
        pitch=-math.radians(sp["pitch"]),
        yaw=math.radians(sp["yaw"]),
        w=rates,
        thrust=float(sp["thrust"]) / 65535.0 * 4.0 * thrust_max,
    )


def write_answer(fw: Record, name: str, answer: object) -> None:
    """Hand a law's answer to the power distribution; what is not a number stops the motors."""
    if not isinstance(answer, ForceTorque | MotorForces | Legacy):
        raise ConfigError(
            f"controller {name!r}: its answer",
            answer,
            "ForceTorque(force, x, y, z), MotorForces(m1, m2, m3, m4) or Legacy(thrust, roll, pitch, yaw)",
        )
    numbers = answer if math.isfinite(sum(answer)) else (0.0, 0.0, 0.0, 0.0)
    if isinstance(answer, MotorForces):
        fw["output"] = MOTORS
        fw["law_motors"] = [max(f, 0.0) / fw["thrust_max"] * 65535.0 for f in numbers]
    elif isinstance(answer, ForceTorque):
        fw["output"] = FORCE_TORQUE
        fw["force"], fw["torque_x"], fw["torque_y"], fw["torque_z"] = numbers
    else:
        fw["output"] = LEGACY
        fw["thrust"], fw["roll_out"], fw["pitch_out"], fw["yaw_out"] = numbers
