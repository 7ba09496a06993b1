"""Measure the noise of poses and gyroscope: what a smooth motion does not explain."""

import math

import numpy as np
from scipy.signal import savgol_coeffs

from crazychoir.simulation.identification.calibration.flight import (
    CalibrationFlight,
    smooth,
)
from crazychoir.simulation.identification.calibration.instruments import (
    BLOCK_ROWS,
    IdentifiedValues,
)
from crazychoir.simulation.identification.calibration.telemetry import (
    integrate_turns,
)
from crazychoir.simulation.identification.flights import FLIGHT_RULES
from crazychoir.types import Vec


def estimate_noise(flight: CalibrationFlight) -> IdentifiedValues:
    """Return the standard deviations of place (m), angles (rad) and gyroscope (rad/s): (3,).

    Each is the residual of a cubic over 110 ms. Half of the parts of 2 s are quieter than the value: fast motion
    in some does not count.
    """
    angles = integrate_turns(flight.q)
    rows = np.flatnonzero(flight.is_usable)
    parts = np.array_split(rows, max(len(rows) // BLOCK_ROWS, 1))
    measured = []
    for columns in (flight.p, angles, flight.gyro):
        rest = columns - smooth(columns)
        each = np.array([math.sqrt(np.mean(rest[part] ** 2)) for part in parts])
        measured.append(each * _correction())
    values = np.array([np.median(each) for each in measured])
    spread = np.array([np.std(each) / math.sqrt(len(each)) for each in measured])
    return IdentifiedValues(values, np.diag(spread**2))


def _correction() -> float:
    """Return the noise of a sample over that of its residual: the smoothed value contains it too."""
    weights: Vec = savgol_coeffs(FLIGHT_RULES.smoothing_rows, 3)
    middle = float(weights[len(weights) // 2])
    return 1.0 / math.sqrt(1.0 - middle)
