"""Drive the bodies of the motor-level simulator with recorded motors and batteries.

The kernels call those of `motor_level.body`: what is compared with a flight is the simulator itself, without a copy of
its equations. Flights, or parts of flights, lie side by side in the lanes of a block.
"""

import math
from typing import Any

import numba
import numpy as np

from crazychoir.numerics.kernels import kernel, matrix, memory
from crazychoir.platforms import Platform
from crazychoir.simulation.identification.flights import FLIGHT_TIME_STEP
from crazychoir.simulation.motor_level.body import (
    integrate_bodies,
    set_goal_thrusts,
)
from crazychoir.simulation.motor_level.lanes import (
    AIRBORNE_FLAG,
    BLOCK_SIZE,
    EXTERNAL_TORQUE_X,
    GOAL_THRUST_1,
    INVERSE_INERTIA_X,
    LANE_COUNT,
    MOTOR_ALIVE_1,
    MOTOR_COMMAND_1,
    MOTOR_FACTOR_1,
    RATE_X,
    ROTOR_THRUST_1,
    SLOPE_1,
    STAGE_STATE,
    STAGE_THRUST_1,
    THRUST_CEILING,
    THRUST_CURVE_1,
    THRUST_CURVE_2,
    THRUST_SLOPE_1,
    VELOCITY_X,
    compute_constants,
)
from crazychoir.simulation.motor_level.motors import MOTOR_TIME_STEP
from crazychoir.types import Mat, Vec

STEPS_PER_ROW = round(FLIGHT_TIME_STEP / MOTOR_TIME_STEP)
"""Steps of the simulator in a row of a flight."""

cube: Any = numba.types.Array(numba.float64, 3, "C", readonly=True)
"""An array (l, m, n) that a kernel reads."""
cubes: Any = numba.float64[:, :, ::1]
"""An array (l, m, n) that a kernel writes."""


@kernel()
def _place(m: Vec, k: int, x: Vec) -> None:
    """Set the state of lane k to x (13,)."""
    for c in range(13):
        m[c * LANE_COUNT + k] = x[c]
        m[STAGE_STATE + c * LANE_COUNT + k] = x[c]


@kernel()
def _set_rotors(m: Vec, k: int, f: Vec, goal: Vec) -> None:
    """Set the thrusts f (4,) and the goals (4,) of the rotors of lane k, in N."""
    for n in range(4):
        row = n * LANE_COUNT + k
        m[GOAL_THRUST_1 + row] = goal[n]
        m[ROTOR_THRUST_1 + row] = f[n]
        m[STAGE_THRUST_1 + row] = f[n]
        c1 = m[THRUST_CURVE_1 + k]
        m[THRUST_SLOPE_1 + row] = math.sqrt(
            c1 * c1 + 4.0 * m[THRUST_CURVE_2 + k] * f[n]
        )


@kernel()
def _command(m: Vec, k: int, u: Vec, ceiling: float) -> None:
    """Set the commands u (4,) of lane k, and the thrust in N that its battery allows."""
    m[THRUST_CEILING + k] = ceiling
    for n in range(4):
        m[MOTOR_COMMAND_1 + n * LANE_COUNT + k] = u[n]


@kernel(memory, cube, matrix, cube, cubes, cubes)
def follow_flights(
    m: Vec, commands: Mat, ceilings: Mat, states: Mat, rotors: Mat, slopes: Mat
) -> None:
    """Run the rotors of one block over whole flights, with the bodies held at the recorded states.

    m: block
    commands: (LANE_COUNT, n, 4): motor commands
    ceilings: (LANE_COUNT, n) N: thrust of a motor that the battery allows
    states: (LANE_COUNT, n, 13): recorded states
    rotors: (LANE_COUNT, n, 8) N: thrusts and goals of the rotors at each row; result
    slopes: (LANE_COUNT, n, 6): accelerations of v (world) and w (body) at each row; result
    """
    for k in range(LANE_COUNT):
        m[AIRBORNE_FLAG + k] = 0.0
    for r in range(commands.shape[1]):
        for k in range(LANE_COUNT):
            _place(m, k, states[k, r])
            _command(m, k, commands[k, r], ceilings[k, r])
            for n in range(4):
                rotors[k, r, n] = m[ROTOR_THRUST_1 + n * LANE_COUNT + k]
                rotors[k, r, 4 + n] = m[GOAL_THRUST_1 + n * LANE_COUNT + k]
        for step in range(STEPS_PER_ROW):
            set_goal_thrusts(m)
            integrate_bodies(m, MOTOR_TIME_STEP)
            if step == 0:
                for k in range(LANE_COUNT):
                    for c in range(3):
                        at = SLOPE_1 + c * LANE_COUNT + k
                        slopes[k, r, c] = m[at + VELOCITY_X]
                        slopes[k, r, 3 + c] = m[at + RATE_X]


@kernel(memory, cube, matrix, matrix, matrix, matrix, matrix, cubes)
def predict_windows(
    m: Vec,
    commands: Mat,
    ceilings: Mat,
    starts: Mat,
    rotors: Mat,
    factors: Mat,
    torques: Mat,
    states: Mat,
) -> None:
    """Predict windows open loop, LANE_COUNT at a time.

    m: block
    commands: (w, n, 4): motor commands of each row
    ceilings: (w, n) N: thrust of a motor that the battery allows
    starts: (w, 13): states at the start
    rotors: (w, 8) N: thrusts and goals of the rotors at the start
    factors: (w, 4): MOTOR_FACTOR of each motor
    torques: (w, 3) N m, body: external torques
    states: (w, n + 1, 13): predicted states, from the start; result
    """
    windows = commands.shape[0]
    for first in range(0, windows, LANE_COUNT):
        lanes = min(LANE_COUNT, windows - first)
        for k in range(LANE_COUNT):
            i = first + min(k, lanes - 1)
            m[AIRBORNE_FLAG + k] = 1.0
            _place(m, k, starts[i])
            _set_rotors(m, k, rotors[i, :4], rotors[i, 4:])
            for n in range(4):
                m[MOTOR_FACTOR_1 + n * LANE_COUNT + k] = factors[i, n]
            for c in range(3):
                m[EXTERNAL_TORQUE_X + c * LANE_COUNT + k] = torques[i, c]
        for r in range(commands.shape[1]):
            for k in range(lanes):
                i = first + k
                for c in range(13):
                    states[i, r, c] = m[c * LANE_COUNT + k]
                _command(m, k, commands[i, r], ceilings[i, r])
            for _ in range(STEPS_PER_ROW):
                set_goal_thrusts(m)
                integrate_bodies(m, MOTOR_TIME_STEP)
        for k in range(lanes):
            for c in range(13):
                states[first + k, commands.shape[1], c] = m[c * LANE_COUNT + k]


def make_block(platform: Platform, rotates: bool = True) -> Vec:
    """Return a block with the constants of the platform in every lane, in still air.

    rotates: whether torques turn the body; otherwise its rates stay
    """
    m = np.zeros(BLOCK_SIZE)
    for name, value in compute_constants(platform, MOTOR_TIME_STEP, True).items():
        m[name : name + LANE_COUNT] = value
    m[MOTOR_ALIVE_1 : MOTOR_ALIVE_1 + 4 * LANE_COUNT] = 1.0
    m[THRUST_SLOPE_1 : THRUST_SLOPE_1 + 4 * LANE_COUNT] = abs(platform.rotor.thrust[0])
    if not rotates:
        m[INVERSE_INERTIA_X : INVERSE_INERTIA_X + 3 * LANE_COUNT] = 0.0
    return m
