"""Find the lag of the rotors from the vertical accelerometer."""

import math

import numpy as np
from scipy.signal import butter, lfilter, lfilter_zi

from crazychoir.simulation.identification.calibration.flight import CalibrationFlight
from crazychoir.simulation.identification.calibration.instruments import (
    IdentifiedValues,
    ParameterPriors,
    make_basis,
    number_blocks,
    shift_setpoint,
    solve_nonlinear,
)
from crazychoir.simulation.identification.flights import FLIGHT_TIME_STEP
from crazychoir.types import Mat, Vec

FINE_STEPS = 10
"""Steps of 1 ms in a row."""
WHITENING_SHARE = 0.98
"""Share of the last residual that the next one is expected to have: slow forces do not decide."""


LAG_PRIORS = ParameterPriors(
    expected=np.array([0.06, 0.006, 0.3, 1.0, 0.4, 0.0]),
    deviations=np.array([math.inf, 0.01, 0.3, math.inf, math.inf, math.inf]),
    smallest=np.array([0.01, 0.0, 0.0, 0.3, -1.0, -20.0]),
    largest=np.array([0.2, 0.06, 1.0, 3.0, 3.0, 20.0]),
    scales=np.array([0.06, 0.02, 1.0, 1.0, 1.0, 1.0]),
)
"""What is known of lag (s), delay (s), phase, gain, drag (1/s) and bias (m/s2).

A smooth flight does not tell lag, delay and phase apart: delay and phase then stay near what is expected.
"""
ACC_FILTER = butter(2, 30.0, fs=1000.0)
"""Low-pass of the firmware for the accelerometer: 30 Hz."""


def estimate_lag(
    flight: CalibrationFlight, thrust: Vec, vertical_speed: Vec
) -> IdentifiedValues:
    """Return lag and delay (2,) in s.

        a_z = B(s) k F / ((lag s + 1) (delay s + 1)) - d v_z + bias

    B is the filter of the accelerometer. The thrust changes when the firmware controls the height, each 10 ms; at
    which phase between two rows is found too.

    thrust: (n,) m/s2: thrust that the motors settle at, over the mass
    vertical_speed: (n,) m/s, along the body's z
    """
    assert flight.acc is not None  # noqa: S101 - the caller asks for it
    chosen = flight.is_usable[1:] & flight.is_usable[:-1]
    later = _hold(thrust, 1)
    earlier = _hold(thrust, 0)
    measured = flight.acc[:, 2]

    def residual(x: Vec) -> Vec:
        lag, delay, phase, gain, drag, bias = x
        fine = (1.0 - phase) * later + phase * earlier
        made = _filter(_lag_fine(_lag_fine(fine, lag), delay))[::FINE_STEPS]
        return _whiten(measured - gain * made + drag * vertical_speed - bias)[chosen]

    basis = None
    if flight.sp is not None:
        instruments = np.column_stack(
            [shift_setpoint(flight.sp[:, 2:]), np.ones(len(thrust))]
        )
        basis = make_basis(_whiten(instruments)[chosen])
    found = solve_nonlinear(residual, LAG_PRIORS, basis, number_blocks(chosen))
    order = [0, 1] if found.values[0] >= found.values[1] else [1, 0]
    return IdentifiedValues(found.values[order], found.covariance[np.ix_(order, order)])


def delay_thrusts(thrusts: Mat, lag: float, delay: float = 0.0) -> Mat:
    """Return thrusts (n, c) behind the lag and the delay in s, both of first order, at the rows.

    Between two rows the thrusts are taken as a straight line.
    """
    for tau in (lag, delay):
        if tau <= 1e-4:
            continue
        a = np.exp(-FLIGHT_TIME_STEP / tau)
        share = tau / FLIGHT_TIME_STEP * (1.0 - a)
        now = 1.0 - share
        before = share - a
        thrusts = lfilter(
            [now, before], [1.0, -a], thrusts, axis=0, zi=(1.0 - now) * thrusts[:1]
        )[0]
    return np.asarray(thrusts)


def _hold(values: Vec, late: int) -> Vec:
    """Return values (n,) each 1 ms: between two rows the earlier (0) or the later one (1)."""
    ahead = np.minimum(np.arange(len(values)) + late, len(values) - 1)
    held = np.repeat(values[ahead], FINE_STEPS)
    return np.asarray(np.concatenate([values[:1], held[:-1]]))


def _lag_fine(x: Vec, tau: float) -> Vec:
    """Return x (m,), a value each 1 ms, behind a lag of first order.

    Its step response is late by tau exactly, also for a tau below 1 ms.
    """
    a = tau / (tau + FLIGHT_TIME_STEP / FINE_STEPS)
    return np.asarray(lfilter([1.0 - a], [1.0, -a], x, zi=[a * x[0]])[0])


def _filter(x: Vec) -> Vec:
    return np.asarray(lfilter(*ACC_FILTER, x, zi=lfilter_zi(*ACC_FILTER) * x[0])[0])


def _whiten(x: Mat) -> Mat:
    return np.asarray(x[1:] - WHITENING_SHARE * x[:-1])
