"""Fit the parameters of the plant to windows of recorded flights."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np
from scipy.optimize import least_squares

from crazychoir.platforms import Platform
from crazychoir.simulation.identification.open_loop import (
    TrimSource,
    find_predictable,
    follow_plant,
    predict_plant,
)
from crazychoir.simulation.identification.parameters import (
    PHYSICAL_PARAMETERS,
    PlantParameters,
)
from crazychoir.simulation.identification.scores import (
    SCORED_ROWS,
    attitude_errors,
)
from crazychoir.simulation.identification.windows import FlightWindows
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class FitRules:
    """Weights and limits of a fit."""

    position_scales: tuple[float, float, float] = (0.001, 0.008, 0.050)
    """m: errors of the position that count 1, at the scored times."""
    attitude_scales: tuple[float, float, float] = (0.024, 0.070, 0.122)
    """rad: errors of the attitude that count 1, at the scored times: 1.4, 4 and 7 deg."""
    largest_residual: float = 30.0
    """A weighted error counts at most so much: a window that diverges does not decide the fit."""
    relative_step: float = 1e-3
    """Step of the differences that give the derivatives, in scales."""
    most_evaluations: int = 25
    """Largest number of steps of the solver."""


FIT_RULES = FitRules()


@dataclass(frozen=True, slots=True)
class ParameterRange:
    """What a fit may try for one parameter, in the unit of the parameter."""

    scale: float
    """Typical value, by which the solver divides."""
    smallest: float
    """Smallest value."""
    largest: float
    """Largest value."""


PARAMETER_RANGES = {
    "lag": ParameterRange(scale=0.06, smallest=0.015, largest=0.15),
    "delay": ParameterRange(scale=0.02, smallest=0.0, largest=0.08),
    "torque_gain": ParameterRange(scale=0.5, smallest=0.05, largest=2.0),
    "roll_moment": ParameterRange(scale=30.0, smallest=0.0, largest=100.0),
    "pitch_moment": ParameterRange(scale=30.0, smallest=0.0, largest=100.0),
    "damping": ParameterRange(scale=5.0, smallest=0.0, largest=60.0),
    "yaw_damping": ParameterRange(scale=5.0, smallest=0.0, largest=60.0),
    "drag": ParameterRange(scale=0.4, smallest=0.1, largest=1.0),
    "vertical_drag": ParameterRange(scale=0.5, smallest=0.0, largest=3.0),
}
"""Range of each of the PlantParameters."""
FITTED_SOURCES = (TrimSource.LAST, TrimSource.FIRST)
"""Trims with which the fitted set must predict well, both at once."""


def fit_parameters(windows: FlightWindows, platform: Platform) -> PlantParameters:
    """Return the parameters with the least weighted errors of position and attitude, by least squares.

    The errors are those at the scored times, once for each of the FITTED_SOURCES.
    """
    parts = {
        source: windows.choose(find_predictable(windows, source))
        for source in FITTED_SOURCES
    }
    ranges = [PARAMETER_RANGES[field.name] for field in fields(PlantParameters)]
    scale = np.array([one.scale for one in ranges])

    def weigh_errors(x: Vec) -> Vec:
        plant = PlantParameters(*(x * scale).tolist()).apply(platform)
        followed = follow_plant(windows, plant)
        return np.concatenate(
            [
                _weigh(part, predict_plant(part, followed, source))
                for source, part in parts.items()
            ]
        )

    found = least_squares(
        weigh_errors,
        np.array(astuple(PHYSICAL_PARAMETERS)) / scale,
        bounds=(
            np.array([one.smallest for one in ranges]) / scale,
            np.array([one.largest for one in ranges]) / scale,
        ),
        diff_step=FIT_RULES.relative_step,
        max_nfev=FIT_RULES.most_evaluations,
    )
    return PlantParameters(*(found.x * scale).tolist())


def _weigh(windows: FlightWindows, states: Mat) -> Vec:
    """Return the errors of position and attitude at the scored times over their scales, flat."""
    weighted = []
    scales = zip(
        SCORED_ROWS,
        FIT_RULES.position_scales,
        FIT_RULES.attitude_scales,
        strict=True,
    )
    for row, position, attitude in scales:
        predicted = states[:, row]
        recorded = windows.recorded(row)
        weighted.append((predicted[:, :3] - recorded[:, :3]) / position)
        weighted.append(attitude_errors(predicted, recorded) / attitude)
    most = FIT_RULES.largest_residual
    return np.clip(np.concatenate(weighted).ravel(), -most, most)


def predict_left_out(
    windows: FlightWindows, platform: Platform, sources: Sequence[TrimSource]
) -> list[Mat]:
    """Predict each flight with parameters that were fitted to all others.

    Returns for each source of trims the states (w, rows + 1, 13).
    """
    predicted: list[Mat] = [np.empty(0) for _ in sources]
    for number in range(len(windows.flights)):
        is_own = windows.flight == number
        if not is_own.any():
            continue
        parameters = fit_parameters(windows.choose(~is_own), platform)
        own = windows.choose(is_own)
        plant = follow_plant(own, parameters.apply(platform))
        for n, source in enumerate(sources):
            states = predict_plant(own, plant, source)
            if not predicted[n].size:
                predicted[n] = np.empty((len(windows.start), *states.shape[1:]))
            predicted[n][is_own] = states
    return predicted
