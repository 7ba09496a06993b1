"""Find the resistance and the capacity of a battery, and its voltage between the samples of a slow log."""

import math

import numpy as np
from scipy.ndimage import uniform_filter1d

from crazychoir.platforms import Platform
from crazychoir.simulation.identification.calibration.flight import (
    CalibrationFlight,
    compute_motor_thrusts,
)
from crazychoir.simulation.identification.calibration.instruments import (
    IdentifiedValues,
    number_blocks,
    solve_linear,
)
from crazychoir.simulation.identification.calibration.rotors import delay_thrusts
from crazychoir.simulation.identification.flights import FLIGHT_TIME_STEP
from crazychoir.simulation.motor_level.battery import OPEN_CIRCUIT_CURVE
from crazychoir.types import Mat, Vec

VOLTAGE_ROWS = 51
"""Rows over which voltage and power are averaged before they are compared."""
REST_ROWS = 201
"""Rows over which the voltage at rest is averaged: 2 s."""
TREND_ORDER = 3
"""Order of the polynomial by which the voltage falls over a flight."""
VOLTAGE_ERROR = 0.01
"""V: error of a voltage at rest, from which the error of the capacity follows."""


def estimate_resistance(
    flight: CalibrationFlight, platform: Platform
) -> IdentifiedValues:
    """Return the resistance (1,) in ohm by which the voltage answers the power of the motors.

        V = E(t) - R I,   I = P / V + I_idle,   P = a sum_n f_n^1.5

    E(t) is a polynomial of the time. The power in hover is the platform's: power and resistance are not told apart.
    Both sides are averaged over 0.5 s, because batteries are logged slowly.
    """
    chosen = flight.is_usable
    power = uniform_filter1d(compute_power(flight, platform), VOLTAGE_ROWS)
    volts = uniform_filter1d(flight.vbat, VOLTAGE_ROWS)
    span = np.linspace(-1.0, 1.0, len(flight.t))
    terms = np.column_stack(
        [-power, *(span**order for order in range(TREND_ORDER + 1))]
    )
    found = solve_linear(volts[chosen], terms[chosen], None, number_blocks(chosen))
    v = float(volts[chosen].mean())
    slope = float(found.values[0])
    factor = v / (1.0 + slope * float(power[chosen].mean()) / v)
    return IdentifiedValues(
        found.values[:1] * factor, found.covariance[:1, :1] * factor**2
    )


def compute_power(
    flight: CalibrationFlight, platform: Platform, lag: float | None = None
) -> Vec:
    """Return the power (n,) in W of the motors, from the duty cycles and the platform's power in hover.

    lag: s: of the rotors; None for that of the platform
    """
    nominal = compute_motor_thrusts(platform, flight.duty, flight.vbat)
    thrusts = delay_thrusts(nominal, platform.rotor.lag if lag is None else lag)
    a = 0.25 * platform.battery.hover_power / (0.25 * platform.weight) ** 1.5
    return np.asarray(a * (thrusts**1.5).sum(axis=1))


def compute_thrusts(
    flight: CalibrationFlight, platform: Platform, resistance: float, lag: float
) -> Mat:
    """Return the thrusts (n, 4) in N that the platform's motors would settle at.

    Batteries are logged slowly, so their sag is computed: V = E - R P / V, with E smoothed over some seconds.
    The voltage is that of the row before: duty cycles of a row have acted since then.

    resistance: ohm
    lag: s: of the rotors
    """
    sag = resistance * compute_power(flight, platform, lag) / flight.vbat
    volts = uniform_filter1d(flight.vbat + sag, REST_ROWS) - sag
    before = np.concatenate([volts[:1], volts[:-1]])
    return compute_motor_thrusts(platform, flight.duty, before)


def estimate_capacity(
    flight: CalibrationFlight, platform: Platform, resistance: float
) -> IdentifiedValues:
    """Return the capacity (1,) in A s: the charge that was used over the share by which the rest voltage fell.

    The standard error is that of an error of VOLTAGE_ERROR at both ends; infinite if the voltage did not fall.
    """
    a, b = flight.airborne
    cell = platform.battery
    power = compute_power(flight, platform)
    current = power / flight.vbat + cell.idle
    rest = uniform_filter1d(flight.vbat + resistance * current, 2 * VOLTAGE_ROWS)
    begin = min(a + VOLTAGE_ROWS, b - 2)
    end = max(b - VOLTAGE_ROWS, begin + 1)
    used = float(current[begin:end].sum()) * FLIGHT_TIME_STEP

    def share(volts: float) -> float:
        wanted = (volts - cell.empty) / (cell.full - cell.empty)
        levels = np.linspace(0.0, 1.0, len(OPEN_CIRCUIT_CURVE))
        return float(np.interp(wanted, OPEN_CIRCUIT_CURVE, levels))

    fall = share(float(rest[begin])) - share(float(rest[end]))
    if fall <= 0.0:
        return IdentifiedValues(np.array([cell.capacity]), np.array([[math.inf]]))
    wrong = sum(
        (share(float(rest[row]) + VOLTAGE_ERROR) - share(float(rest[row]))) ** 2
        for row in (begin, end)
    )
    value = used / fall
    return IdentifiedValues(np.array([value]), np.array([[value**2 * wrong / fall**2]]))
