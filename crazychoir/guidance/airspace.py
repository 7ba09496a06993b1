"""Separation in space: each drone flies at a level of its own."""

from collections.abc import Sequence

from crazychoir.errors import ConfigError


def levels(ids: Sequence[int], lowest: float, spacing: float, highest: float) -> dict[int, float]:
    """m above the ground of each drone, in the order of their ids; raises ConfigError if they do not fit."""
    found = {i: lowest + spacing * n for n, i in enumerate(sorted(ids))}
    top = max(found.values())
    if top > highest:
        do = "Take a smaller level_spacing, a lower takeoff_height, a higher fence or fewer drones."
        raise ConfigError("levels of the drones", f"{top:.2f} m for the highest", f"at most {highest:.2f} m", do)
    return found
