"""Largest numbers of an instance.

Beyond them, the rounding of a sum exceeds the tolerance of the limits.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class InstanceLimits:
    """Limits of the numbers of an instance, within which the tolerances of solvers hold."""

    distance_or_speed: float = 1e5
    """m, largest coordinate or distance; m/s, largest speed."""
    amount: float = 1e6
    """Units of load, or m: largest load, capacity, penalty or fixed cost."""
    slowest_speed: float = 1e-3
    """m/s."""
    latest_time: float = 1e7
    """s."""


INSTANCE_LIMITS = InstanceLimits()
