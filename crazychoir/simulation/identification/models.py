"""The models that `crazychoir validate` compares with recorded flights."""

from collections.abc import Callable

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.simulation.identification.fitting import (
    FITTED_SOURCES,
    predict_left_out,
)
from crazychoir.simulation.identification.open_loop import (
    TrimSource,
    find_predictable,
    follow_plant,
    predict_constant,
    predict_plant,
)
from crazychoir.simulation.identification.parameters import (
    FITTED_PARAMETERS,
    PHYSICAL_PARAMETERS,
    remove_request_limit,
)
from crazychoir.simulation.identification.scores import OpenLoopErrors, score
from crazychoir.simulation.identification.windows import FlightWindows

CONSTANT_MODEL = "velocity and rates stay"
"""Dead reckoning."""
NO_TORQUE_MODEL = "rates stay, thrust trim"
"""Gravity, drag and the thrusts of the rotors, without their torques."""
PLANT_MODEL = "simulator as it is"
"""The platform's plant with its firmware's limit, without trims."""
FITTED_MODEL = f"fitted set, {TrimSource.LAST}"
"""Parameters that predict best."""
SHOWN_MODELS = {
    CONSTANT_MODEL: "stays",
    PLANT_MODEL: "as it is",
    FITTED_MODEL: "fitted set",
}
"""Models that the table of flights shows, and their headings."""


def compare_models(
    windows: FlightWindows, platform: Platform, fits: bool, tell: Callable[[str], None]
) -> list[OpenLoopErrors]:
    """Predict the windows with all models and return their errors.

    fits: whether the parameters are also fitted, for each flight to the others
    tell: gets a line of progress before what takes long
    Raises ConfigError if there are too few flights for a fit.
    """
    flying = len(set(windows.flight.tolist()))
    if fits and flying < 2:
        raise ConfigError(
            "--fit", f"{flying} flight with windows", "two flights or more"
        )
    plain = follow_plant(windows, platform)
    free = follow_plant(windows, remove_request_limit(platform))
    physical = follow_plant(windows, PHYSICAL_PARAMETERS.apply(platform))
    fitted = follow_plant(windows, FITTED_PARAMETERS.apply(platform))
    later = find_predictable(windows, TrimSource.FIRST)
    remaining = windows.choose(later)
    scored = [
        score(CONSTANT_MODEL, windows, predict_constant(windows)),
        score(
            NO_TORQUE_MODEL,
            windows,
            predict_plant(windows, free, TrimSource.LAST, rotates=False),
        ),
        score(PLANT_MODEL, windows, predict_plant(windows, plain, TrimSource.NONE)),
    ]
    for name, plant in (
        ("simulator", free),
        ("physical set", physical),
        ("fitted set", fitted),
    ):
        states = predict_plant(windows, plant, TrimSource.LAST)
        scored.append(score(f"{name}, {TrimSource.LAST}", windows, states))
    if later.any():
        states = predict_plant(remaining, fitted, TrimSource.FIRST)
        scored.append(score(f"fitted set, {TrimSource.FIRST}", remaining, states))
    if fits:
        tell("fits each flight's parameters to the others: half a minute a flight")
        left_out = predict_left_out(windows, platform, FITTED_SOURCES)
        for source, states in zip(FITTED_SOURCES, left_out, strict=True):
            kept = find_predictable(windows, source)
            name = f"fitted to the others, {source}"
            scored.append(score(name, windows.choose(kept), states[kept]))
    return scored
