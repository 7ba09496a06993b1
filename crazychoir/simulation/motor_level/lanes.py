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
from crazychoir.numerics.math3d import clip
from crazychoir.platforms import EVEN_MOTORS, Platform
from crazychoir.types import Mat, Vec

Number = TypeVar("Number", np.float64, np.uint64)

LANE_COUNT = 8  # drones in a block

_next = count(6 * 13 * LANE_COUNT, LANE_COUNT)

# State: position (m, world), velocity (m/s, world), attitude (body to world), rates (rad/s, body).
# STAGE_STATE is the start of the same 13 numbers at a stage of the integration.
# SLOPE_1 to SLOPE_4 are the starts of their slopes.
(
    POSITION_X,
    POSITION_Y,
    POSITION_Z,
    VELOCITY_X,
    VELOCITY_Y,
    VELOCITY_Z,
    QUATERNION_X,
    QUATERNION_Y,
    QUATERNION_Z,
    QUATERNION_W,
    RATE_X,
    RATE_Y,
    RATE_Z,
) = range(0, 13 * LANE_COUNT, LANE_COUNT)
STAGE_STATE, SLOPE_1, SLOPE_2, SLOPE_3, SLOPE_4 = range(
    13 * LANE_COUNT, 6 * 13 * LANE_COUNT, 13 * LANE_COUNT
)

# Rotors 1 to 4.
# MOTOR_COMMAND: share of the firmware's greatest thrust
# GOAL_THRUST: N
# ROTOR_THRUST: thrust at the beginning of a step, N
# STAGE_THRUST: thrust at a stage, N
# THRUST_SLOPE: derivative of that thrust by the speed of the rotor, N/rpm
MOTOR_COMMAND_1, MOTOR_COMMAND_2, MOTOR_COMMAND_3, MOTOR_COMMAND_4 = (
    next(_next) for _ in range(4)
)
GOAL_THRUST_1, GOAL_THRUST_2, GOAL_THRUST_3, GOAL_THRUST_4 = (
    next(_next) for _ in range(4)
)
ROTOR_THRUST_1, ROTOR_THRUST_2, ROTOR_THRUST_3, ROTOR_THRUST_4 = (
    next(_next) for _ in range(4)
)
STAGE_THRUST_1, STAGE_THRUST_2, STAGE_THRUST_3, STAGE_THRUST_4 = (
    next(_next) for _ in range(4)
)
THRUST_SLOPE_1, THRUST_SLOPE_2, THRUST_SLOPE_3, THRUST_SLOPE_4 = (
    next(_next) for _ in range(4)
)

# All rotors together, on the body.
# TOTAL_LIFT: force along z, N
# ROTOR_TORQUE: torques, N m
# ROTOR_MOMENTUM: angular momentum of the rotors along z, kg m2/s
TOTAL_LIFT, ROTOR_TORQUE_X, ROTOR_TORQUE_Y, ROTOR_TORQUE_Z, ROTOR_MOMENTUM = (
    next(_next) for _ in range(5)
)
# From outside.
# EXTERNAL_FORCE: N, world
# EXTERNAL_TORQUE: N m, body
# WIND: m/s, world
(
    EXTERNAL_FORCE_X,
    EXTERNAL_FORCE_Y,
    EXTERNAL_FORCE_Z,
    EXTERNAL_TORQUE_X,
    EXTERNAL_TORQUE_Y,
    EXTERNAL_TORQUE_Z,
    WIND_X,
    WIND_Y,
    WIND_Z,
) = (next(_next) for _ in range(9))
# Sensors.
# SPECIFIC_FORCE: m/s2, body
# GYROSCOPE: reading, rad/s
# ACCELEROMETER: reading, m/s2
# GYROSCOPE_BIAS, ACCELEROMETER_BIAS: bias of the reading, in the same unit
SPECIFIC_FORCE_X, SPECIFIC_FORCE_Y, SPECIFIC_FORCE_Z = (next(_next) for _ in range(3))
(
    GYROSCOPE_X,
    GYROSCOPE_Y,
    GYROSCOPE_Z,
    ACCELEROMETER_X,
    ACCELEROMETER_Y,
    ACCELEROMETER_Z,
) = (next(_next) for _ in range(6))
(
    GYROSCOPE_BIAS_X,
    GYROSCOPE_BIAS_Y,
    GYROSCOPE_BIAS_Z,
    ACCELEROMETER_BIAS_X,
    ACCELEROMETER_BIAS_Y,
    ACCELEROMETER_BIAS_Z,
) = (next(_next) for _ in range(6))

# AIRBORNE_FLAG: 1 in the air, 0 on the floor
# IMPACT_SPEED: fastest touch-down, m/s
# MOTOR_ALIVE_1 to MOTOR_ALIVE_4: 1 until the motor is cut, then 0
AIRBORNE_FLAG, IMPACT_SPEED = (next(_next) for _ in range(2))
MOTOR_ALIVE_1, MOTOR_ALIVE_2, MOTOR_ALIVE_3, MOTOR_ALIVE_4 = (
    next(_next) for _ in range(4)
)
# Battery.
# BATTERY_CHARGE: remaining share of the charge, 1 is full
# BATTERY_VOLTAGE: V at its poles
# THRUST_CEILING: greatest thrust of one motor at that voltage, N
BATTERY_CHARGE, BATTERY_VOLTAGE, THRUST_CEILING = (next(_next) for _ in range(3))

# Constants of the platform, see `compute_constants`.
(
    BODY_MASS,
    INVERSE_MASS,
    INERTIA_X,
    INERTIA_Y,
    INERTIA_Z,
    INVERSE_INERTIA_X,
    INVERSE_INERTIA_Y,
    INVERSE_INERTIA_Z,
    ARM_LENGTH,
    DRAG_X,
    DRAG_Y,
    DRAG_Z,
) = (next(_next) for _ in range(12))
(
    THRUST_CURVE_1,
    THRUST_CURVE_2,
    SPEED_PER_SLOPE,
    TORQUE_CURVE_1,
    TORQUE_CURVE_2,
    ROTOR_INERTIA,
    INERTIA_PER_LAG,
) = (next(_next) for _ in range(7))
(
    HALF_STEP_DECAY,
    FULL_STEP_DECAY,
    GROUND_EFFECT_AREA,
    LARGEST_THRUST,
    SMALLEST_THRUST,
) = (next(_next) for _ in range(5))
# Effects that were identified in flight, see `platforms.BodyEffects`.
MOTOR_FACTOR_1, MOTOR_FACTOR_2, MOTOR_FACTOR_3, MOTOR_FACTOR_4 = (
    next(_next) for _ in range(4)
)
(
    DELAY_DECAY,
    SPEED_MOMENT_X,
    SPEED_MOMENT_Y,
    RATE_DAMPING_X,
    RATE_DAMPING_Y,
    RATE_DAMPING_Z,
) = (next(_next) for _ in range(6))
(
    CELL_FULL_VOLTAGE,
    CELL_EMPTY_VOLTAGE,
    CELL_RESISTANCE,
    CELL_CAPACITY,
    IDLE_CURRENT,
    POWER_FACTOR,
) = (next(_next) for _ in range(6))
VOLTAGE_CURVE_0, VOLTAGE_CURVE_1, VOLTAGE_CURVE_2, VOLTAGE_CURVE_3 = (
    next(_next) for _ in range(4)
)
BLOCK_SIZE = next(_next)  # numbers in a block

block_fields = np.dtype([("m", np.float64, (BLOCK_SIZE,))])
"""Type of a block for kernels: a record.

As an array it would be slower: counting the references to an array takes a twelfth of a step.
"""
blocks: Any = numba.from_dtype(block_fields)[::1]
Blocks = npt.NDArray[np.void]


def compute_constants(
    platform: Platform, h: float, ground_effect: bool
) -> dict[int, float]:
    """Return the constants of a platform by their place in a block.

    Units are SI, but rotor speeds are in rpm. HALF_STEP_DECAY and FULL_STEP_DECAY are the decays of the rotors' lag in
    h/2 and h s, DELAY_DECAY that of the motors' delay in h s.
    """
    rotor = platform.rotor
    cell = platform.battery
    hover = platform.weight / 4.0
    effects = platform.effects
    factors = effects.motor_factors or EVEN_MOTORS
    moment = effects.speed_moment or (0.0, 0.0)
    damping = effects.rate_damping or (0.0, 0.0, 0.0)
    delay = effects.delay or 0.0
    return {
        BODY_MASS: platform.mass,
        INERTIA_X: platform.inertia[0],
        INERTIA_Y: platform.inertia[1],
        INERTIA_Z: platform.inertia[2],
        INVERSE_MASS: 1.0 / platform.mass,
        INVERSE_INERTIA_X: 1.0 / platform.inertia[0],
        INVERSE_INERTIA_Y: 1.0 / platform.inertia[1],
        INVERSE_INERTIA_Z: 1.0 / platform.inertia[2],
        ARM_LENGTH: platform.arm,
        DRAG_X: platform.drag[0],
        DRAG_Y: platform.drag[1],
        DRAG_Z: platform.drag[2],
        THRUST_CURVE_1: rotor.thrust[0],
        THRUST_CURVE_2: rotor.thrust[1],
        TORQUE_CURVE_1: rotor.torque[0],
        TORQUE_CURVE_2: rotor.torque[1],
        SPEED_PER_SLOPE: 0.5 / rotor.thrust[1],
        ROTOR_INERTIA: rotor.inertia * math.pi / 30.0,
        INERTIA_PER_LAG: rotor.inertia * math.pi / 30.0 / rotor.lag,
        HALF_STEP_DECAY: math.exp(-0.5 * h / rotor.lag),
        FULL_STEP_DECAY: math.exp(-h / rotor.lag),
        GROUND_EFFECT_AREA: (0.25 * rotor.radius) ** 2 if ground_effect else 0.0,
        LARGEST_THRUST: platform.firmware.thrust_max,
        SMALLEST_THRUST: platform.firmware.thrust_min,
        MOTOR_FACTOR_1: factors[0],
        MOTOR_FACTOR_2: factors[1],
        MOTOR_FACTOR_3: factors[2],
        MOTOR_FACTOR_4: factors[3],
        DELAY_DECAY: math.exp(-h / delay) if delay > 0.0 else 0.0,
        SPEED_MOMENT_X: moment[0],
        SPEED_MOMENT_Y: moment[1],
        RATE_DAMPING_X: damping[0],
        RATE_DAMPING_Y: damping[1],
        RATE_DAMPING_Z: damping[2],
        CELL_FULL_VOLTAGE: cell.full,
        CELL_EMPTY_VOLTAGE: cell.empty,
        CELL_RESISTANCE: cell.resistance,
        CELL_CAPACITY: cell.capacity,
        IDLE_CURRENT: cell.idle,
        POWER_FACTOR: 0.25 * cell.hover_power / hover**1.5,
        VOLTAGE_CURVE_0: rotor.voltage[0],
        VOLTAGE_CURVE_1: rotor.voltage[1],
        VOLTAGE_CURVE_2: rotor.voltage[2],
        VOLTAGE_CURVE_3: rotor.voltage[3],
    }


def arrange_in_lanes(values: npt.NDArray[Number]) -> npt.NDArray[Number]:
    """Arrange values (N,) in lanes: (blocks, LANE_COUNT); empty lanes repeat the last value."""
    return np.pad(values, (0, -len(values) % LANE_COUNT), mode="edge").reshape(
        -1, LANE_COUNT
    )


@kernel()
def load_block(
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
    limited, and counted in `limited`.
    first: row of the first drone of the block
    x: (N, 13): states
    commands: (N, 4): shares of the greatest thrust
    force: (N, 3) N, world: external forces
    torque: (N, 3) N m, body: external torques
    below: (N,) N: downwash
    limited: (N,): counters of limited commands
    """
    for k in range(min(LANE_COUNT, x.shape[0] - first)):
        i = first + k
        beyond = 0.0
        for c in range(13):
            m[c * LANE_COUNT + k] = x[i, c]
            m[STAGE_STATE + c * LANE_COUNT + k] = x[i, c]
        for c in range(4):
            u = commands[i, c]
            beyond = beyond if 0.0 <= u <= 1.0 else 1.0
            m[MOTOR_COMMAND_1 + c * LANE_COUNT + k] = (
                clip(u, 0.0, 1.0)
                if math.isfinite(u)
                else m[MOTOR_COMMAND_1 + c * LANE_COUNT + k]
            )
        for c in range(3):
            m[EXTERNAL_FORCE_X + c * LANE_COUNT + k] = force[i, c]
            m[EXTERNAL_TORQUE_X + c * LANE_COUNT + k] = torque[i, c]
        m[EXTERNAL_FORCE_Z + k] -= below[i]
        limited[i] += beyond


@kernel()
def store_block(
    m: Vec, first: int, x: Mat, resting: Vec, impact: Vec, lift: Vec
) -> None:
    """Copy the results of a block back to the rows of its drones."""
    for k in range(min(LANE_COUNT, x.shape[0] - first)):
        for c in range(13):
            x[first + k, c] = m[c * LANE_COUNT + k]
        resting[first + k] = 1.0 - m[AIRBORNE_FLAG + k]
        impact[first + k] = m[IMPACT_SPEED + k]
        lift[first + k] = m[TOTAL_LIFT + k]
