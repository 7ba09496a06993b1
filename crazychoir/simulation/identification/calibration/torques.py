"""Find the imbalance of the motors, the moment of speed and the damping from the rates of a flight."""

from typing import NamedTuple

import numpy as np

from crazychoir.platforms import Platform
from crazychoir.simulation.identification.calibration.flight import (
    CalibrationFlight,
    smooth,
)
from crazychoir.simulation.identification.calibration.forces import BodyMotion
from crazychoir.simulation.identification.calibration.instruments import (
    IdentifiedValues,
    make_basis,
    number_blocks,
    shift_setpoint,
    solve_linear,
)
from crazychoir.types import Mat, Vec


class MixerSigns(NamedTuple):
    """Signs of motors 1 to 4 in the torques about the body's axes."""

    roll: tuple[int, int, int, int] = (-1, -1, 1, 1)
    pitch: tuple[int, int, int, int] = (-1, 1, 1, -1)
    yaw: tuple[int, int, int, int] = (-1, 1, -1, 1)


MIXER_SIGNS = MixerSigns()
DAMPING_ERROR = 1.0
"""1/s: error of the damping because motors are logged at one of the ten phases between two updates."""


class AxisTorque(NamedTuple):
    """What turns the drone about one axis, over the torque of its motors."""

    gain: float
    """Angular acceleration as a share of the platform's, for the same thrusts."""
    imbalance: float
    """N m: torque of equal motors in hover."""
    moment: float
    """N m per m/s."""
    damping: float
    """1/s."""


def estimate_torques(
    flight: CalibrationFlight,
    motion: BodyMotion,
    thrusts: Mat,
    thrust_factor: float,
    platform: Platform,
) -> IdentifiedValues:
    """Return moment, imbalance, damping and gain about roll, then pitch: (8,).

        J w' = g (l S f + c_y P f + k T + M v - J D w) + gyroscopic torques

    S f: difference of the thrusts about this axis, P f about the other one, T their sum over its mean
    M: moment of speed in N m per m/s; k: imbalance in N m; D: damping in 1/s; g: gain

    The torques of the motors are the measure of the others, so their gain cancels. The gain itself is biased: motors
    are logged each 10 ms, and between two rows the firmware answers each new attitude with a peak.

    thrusts: (n, 4) N: of the platform's rotors, behind their lag
    thrust_factor: true thrust as a share of the platform's
    """
    chosen = flight.is_usable
    block = number_blocks(chosen)
    basis = None
    if flight.sp is not None:
        shifted = smooth(shift_setpoint(flight.sp))
        basis = make_basis(np.column_stack([shifted, np.ones(len(flight.t))])[chosen])
    values = np.empty(8)
    covariance = np.zeros((8, 8))
    for axis in range(2):
        y, terms = _make_equation(flight, motion, thrusts, platform, axis)
        found = solve_linear(y[chosen], terms[chosen], basis, block)
        at = slice(4 * axis, 4 * axis + 4)
        values[at], covariance[at, at] = _divide_by_gain(
            found, thrust_factor, platform.inertia[axis]
        )
    return IdentifiedValues(values, covariance)


def _make_equation(
    flight: CalibrationFlight,
    motion: BodyMotion,
    thrusts: Mat,
    platform: Platform,
    axis: int,
) -> tuple[Vec, Mat]:
    """Return the angular acceleration (n,) in rad/s2 and its terms (n, 6), smoothed.

    The terms: motors of this axis, total thrust over its mean, speed, rate, motors of the other axis, other rate.
    """
    jx, jy, jz = platform.inertia
    w = flight.gyro
    signs = (np.array(MIXER_SIGNS.roll), np.array(MIXER_SIGNS.pitch))
    own = platform.arm / platform.inertia[axis]
    total = thrusts.sum(axis=1)
    speed = motion.velocity[:, 1] if axis == 0 else -motion.velocity[:, 0]
    gyroscopic = (
        w[:, 1] * w[:, 2] * (jy - jz) / jx
        if axis == 0
        else w[:, 2] * w[:, 0] * (jz - jx) / jy
    )
    raw = np.column_stack(
        [
            own * (thrusts @ signs[axis]),
            total / total[flight.is_usable].mean(),
            -w[:, axis],
            own * (thrusts @ signs[1 - axis]),
            w[:, 1 - axis],
            gyroscopic,
        ]
    )
    smoothed = smooth(raw)
    terms = np.column_stack(
        [
            smoothed[:, :2],
            speed,  # smoothed already
            smoothed[:, 2:5],
        ]
    )
    return smooth(w[:, axis], 1) - smoothed[:, 5], terms


def _divide_by_gain(
    found: IdentifiedValues, thrust_factor: float, inertia: float
) -> tuple[Vec, Mat]:
    """Return moment, imbalance, damping, gain (4,) of one axis, with their covariance.

    Ratios to the gain of the motors: J k c / g, with the platform's inertia J and the thrust factor k.
    """
    gain, imbalance, moment, damping = found.values[:4]
    unit = inertia * thrust_factor / gain
    values = np.array([moment * unit, imbalance * unit, damping, gain / thrust_factor])
    turn = np.zeros((4, len(found.values)))
    turn[0, 2] = unit
    turn[0, 0] = -values[0] / gain
    turn[1, 1] = unit
    turn[1, 0] = -values[1] / gain
    turn[2, 3] = 1.0
    turn[3, 0] = 1.0 / thrust_factor
    covariance = turn @ found.covariance @ turn.T
    covariance[2, 2] += DAMPING_ERROR**2
    return values, covariance


def find_yaw_imbalance(
    flight: CalibrationFlight, thrusts: Mat, platform: Platform
) -> float:
    """Return the yaw imbalance of the motors' factors: in the mean the torques of the rotors are in balance.

    sum_n s_n m(k_n f_n) = 0,   k_n = 1 + s_n c,   m proportional to f
    """
    mean = thrusts[flight.is_usable].mean(axis=0)
    return float(-(np.array(MIXER_SIGNS.yaw) @ mean) / mean.sum())


def make_motor_factors(
    roll: float, pitch: float, yaw: float, lift: float, arm: float
) -> Vec:
    """Return the factors (4,) of motors 1 to 4, with mean 1, of torques in N m.

    roll, pitch: N m: torques of equal commands in hover
    yaw: imbalance as a share
    lift: N: thrust of all motors in hover
    """
    return np.asarray(
        1.0
        + roll / (arm * lift) * np.array(MIXER_SIGNS.roll)
        + pitch / (arm * lift) * np.array(MIXER_SIGNS.pitch)
        + yaw * np.array(MIXER_SIGNS.yaw)
    )
