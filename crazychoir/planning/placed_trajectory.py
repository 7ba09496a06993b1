"""A trajectory of a file, as a drone flies it: slower, raised, from rest to rest, and within limits."""

import math

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import Limits, compute_peaks
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.scaling import compute_slowdown

LARGEST_END_SPEED = (
    0.1  # m/s: a trajectory with faster ends does not begin or end at rest
)
SLOWDOWN_STEP = 0.01  # step of the factor that an error advises
SLOWDOWN_TOLERANCE = 1e-3  # share by which a trajectory may be too fast


def place_trajectory(
    path: Piecewise,
    limits: Limits,
    where: str,
    slower: float = 1.0,
    height: float | None = None,
) -> Piecewise:
    """Return the trajectory in `slower` times the time, with its start at this height.

    limits: speed, acceleration and other rates; its fence is not checked here
    where: name of the file, for errors
    slower: factor on its duration
    height: m, world: height of its start; None: as in the file
    Raises ConfigError for a trajectory that moves at its start or end, or is too fast.
    """
    _require_rest(path, where)
    slowed = path.slowed(slower)
    rates = Limits(
        v_max=limits.v_max, a_max=limits.a_max, yaw_rate_max=limits.yaw_rate_max
    )
    factor = compute_slowdown(slowed, rates)
    if factor > 1.0 + SLOWDOWN_TOLERANCE:
        peaks = compute_peaks(slowed)
        needed = math.ceil(slower * factor / SLOWDOWN_STEP) * SLOWDOWN_STEP
        raise ConfigError(
            where,
            f"up to {peaks['speed']:.2f} m/s and {peaks['acceleration']:.2f} m/s2",
            f"at most {limits.v_max:g} m/s and {limits.a_max:g} m/s2",
            f"Fly it slower: slower = {needed:.2f}, or raise the limits of [flight].",
        )
    if height is None:
        return slowed
    return slowed.shifted((0.0, 0.0, height - float(slowed.sample(0.0).p[2])))


def _require_rest(path: Piecewise, where: str) -> None:
    """Raise ConfigError for a trajectory that moves at its start or at its end."""
    ends = {"start": path.sample(0.0).v, "end": path.end[3:6]}
    for name, velocity in ends.items():
        speed = float(np.linalg.norm(velocity))
        if speed > LARGEST_END_SPEED:
            raise ConfigError(
                f"{where}: {name}",
                f"{speed:.2f} m/s",
                f"at rest, at most {LARGEST_END_SPEED:g} m/s",
                "Add a piece that brings it to rest.",
            )
