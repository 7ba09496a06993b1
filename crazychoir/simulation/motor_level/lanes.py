"""Memory layout of the motor-level world: eight drones side by side for vector instructions.

A block is one flat array. Number c of the drone in lane l lies at m[c + l]; the names below are
the values of c. In a loop over the lanes of a block, all numbers that are read or written have
constant distances, so the compiler can use vector instructions. Each lane computes the same bits
as it would alone.
"""

import math
from itertools import count
from typing import Any, TypeVar

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.numerics.kernels import kernel
from crazychoir.platforms import Platform
from crazychoir.types import Mat, Vec

Number = TypeVar("Number", np.float64, np.uint64)

LANES = 8  # drones in a block

_next = count(6 * 13 * LANES, LANES)

# State.
# PX, PY, PZ: position, m, world
# VX, VY, VZ: velocity, m/s, world
# QX, QY, QZ, QW: attitude, body to world
# WX, WY, WZ: rates, rad/s, body
# STAGE is the start of the same 13 numbers at a stage of the integration, SLOPE1 to 4 those of its
# slopes.
PX, PY, PZ, VX, VY, VZ, QX, QY, QZ, QW, WX, WY, WZ = range(0, 13 * LANES, LANES)
STAGE, SLOPE1, SLOPE2, SLOPE3, SLOPE4 = range(13 * LANES, 6 * 13 * LANES, 13 * LANES)

# Rotors 1 to 4.
# U: command, share of the firmware's greatest thrust
# G: goal thrust, N
# F: thrust at the beginning of a step, N
# N: thrust at a stage, N
# S: derivative of that thrust by the speed of the rotor, N/rpm
U1, U2, U3, U4 = (next(_next) for _ in range(4))
G1, G2, G3, G4 = (next(_next) for _ in range(4))
F1, F2, F3, F4 = (next(_next) for _ in range(4))
N1, N2, N3, N4 = (next(_next) for _ in range(4))
S1, S2, S3, S4 = (next(_next) for _ in range(4))

# All rotors together, on the body.
# LIFT: force along z, N
# TX, TY, TZ: torques, N m
# SPIN: angular momentum of the rotors along z, kg m2/s
LIFT, TX, TY, TZ, SPIN = (next(_next) for _ in range(5))
# From outside.
# EX, EY, EZ: force, N, world
# OX, OY, OZ: torque, N m, body
# AIRX, AIRY, AIRZ: wind, m/s, world
EX, EY, EZ, OX, OY, OZ, AIRX, AIRY, AIRZ = (next(_next) for _ in range(9))
# Sensors.
# SX, SY, SZ: specific force, m/s2, body
# GYROX..: reading of the gyroscope, rad/s; ACCX..: reading of the accelerometer, m/s2
# BIAS1 to 3: bias of the gyroscope; BIAS4 to 6: bias of the accelerometer
SX, SY, SZ = (next(_next) for _ in range(3))
GYROX, GYROY, GYROZ, ACCX, ACCY, ACCZ = (next(_next) for _ in range(6))
BIAS1, BIAS2, BIAS3, BIAS4, BIAS5, BIAS6 = (next(_next) for _ in range(6))

# FREE: 1 in the air, 0 on the floor
# IMPACT: fastest touch-down, m/s
# ALIVE1 to 4: 1 until the motor is cut, then 0
FREE, IMPACT = (next(_next) for _ in range(2))
ALIVE1, ALIVE2, ALIVE3, ALIVE4 = (next(_next) for _ in range(4))
# Battery.
# CHARGE: remaining share of the charge, 1 is full
# VOLTAGE: V at its poles
# CEILING: greatest thrust of one motor at that voltage, N
CHARGE, VOLTAGE, CEILING = (next(_next) for _ in range(3))

# Constants of the platform, see `constants`.
MASS, LIGHT, JX, JY, JZ, IJX, IJY, IJZ, ARM, DRAGX, DRAGY, DRAGZ = (
    next(_next) for _ in range(12)
)
CURVE1, CURVE2, SPEED, TORQUE1, TORQUE2, INERTIA, BOOST = (
    next(_next) for _ in range(7)
)
HALF, FULL, GROUND, MOST, LEAST = (next(_next) for _ in range(5))
CELL_FULL, CELL_EMPTY, RESISTANCE, CAPACITY, IDLE, POWER = (
    next(_next) for _ in range(6)
)
C0, C1, C2, C3 = (next(_next) for _ in range(4))
SIZE = next(_next)  # numbers in a block

block_fields = np.dtype([("m", np.float64, (SIZE,))])
"""Type of a block for kernels: a record.

As an array it would be slower: counting the references to an array takes a twelfth of a step.
"""
blocks: Any = numba.from_dtype(block_fields)[::1]
Blocks = npt.NDArray[np.void]


def constants(platform: Platform, h: float, ground_effect: bool) -> dict[int, float]:
    """Return the constants of a platform by their place in a block.

    Units are SI, but rotor speeds are in rpm. HALF and FULL are the decays of the rotors' lag in
    h/2 and h s.
    """
    rotor = platform.rotor
    cell = platform.battery
    hover = platform.weight / 4.0
    return {
        MASS: platform.mass,
        JX: platform.inertia[0],
        JY: platform.inertia[1],
        JZ: platform.inertia[2],
        LIGHT: 1.0 / platform.mass,
        IJX: 1.0 / platform.inertia[0],
        IJY: 1.0 / platform.inertia[1],
        IJZ: 1.0 / platform.inertia[2],
        ARM: platform.arm,
        DRAGX: platform.drag[0],
        DRAGY: platform.drag[1],
        DRAGZ: platform.drag[2],
        CURVE1: rotor.thrust[0],
        CURVE2: rotor.thrust[1],
        TORQUE1: rotor.torque[0],
        TORQUE2: rotor.torque[1],
        SPEED: 0.5 / rotor.thrust[1],
        INERTIA: rotor.inertia * math.pi / 30.0,
        BOOST: rotor.inertia * math.pi / 30.0 / rotor.lag,
        HALF: math.exp(-0.5 * h / rotor.lag),
        FULL: math.exp(-h / rotor.lag),
        GROUND: (0.25 * rotor.radius) ** 2 if ground_effect else 0.0,
        MOST: platform.firmware.thrust_max,
        LEAST: platform.firmware.thrust_min,
        CELL_FULL: cell.full,
        CELL_EMPTY: cell.empty,
        RESISTANCE: cell.resistance,
        CAPACITY: cell.capacity,
        IDLE: cell.idle,
        POWER: 0.25 * cell.hover_power / hover**1.5,
        C0: rotor.voltage[0],
        C1: rotor.voltage[1],
        C2: rotor.voltage[2],
        C3: rotor.voltage[3],
    }


def in_lanes(values: npt.NDArray[Number]) -> npt.NDArray[Number]:
    """Arrange values (N,) in lanes: (blocks, LANES); empty lanes repeat the last value."""
    return np.pad(values, (0, -len(values) % LANES), mode="edge").reshape(-1, LANES)


@kernel()
def take(
    m: Vec,
    first: int,
    x: Mat,
    commands: Mat,
    force: Mat,
    torque: Mat,
    below: Vec,
    limited: Vec,
) -> None:
    """Copy states, motor commands and external forces of the drones into their block.

    A command that is not finite is ignored, so the one before stays. A command outside 0..1 is
    counted in `limited`.
    first: row of the first drone of the block
    x: (N, 13): states
    commands: (N, 4): shares of the greatest thrust
    force: (N, 3) N, world: external forces
    torque: (N, 3) N m, body: external torques
    below: (N,) N: downwash
    limited: (N,): counters of limited commands
    """
    for k in range(min(LANES, x.shape[0] - first)):
        i = first + k
        beyond = 0.0
        for c in range(13):
            m[c * LANES + k] = x[i, c]
            m[STAGE + c * LANES + k] = x[i, c]
        for c in range(4):
            u = commands[i, c]
            beyond = beyond if 0.0 <= u <= 1.0 else 1.0
            m[U1 + c * LANES + k] = u if math.isfinite(u) else m[U1 + c * LANES + k]
        for c in range(3):
            m[EX + c * LANES + k] = force[i, c]
            m[OX + c * LANES + k] = torque[i, c]
        m[EZ + k] -= below[i]
        limited[i] += beyond


@kernel()
def give(m: Vec, first: int, x: Mat, resting: Vec, impact: Vec, lift: Vec) -> None:
    """Copy the results of a block back to the rows of its drones."""
    for k in range(min(LANES, x.shape[0] - first)):
        for c in range(13):
            x[first + k, c] = m[c * LANES + k]
        resting[first + k] = 1.0 - m[FREE + k]
        impact[first + k] = m[IMPACT + k]
        lift[first + k] = m[LIFT + k]
