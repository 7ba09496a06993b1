"""A list of targets, one after the other: on to the next within 5 cm of one.

crazychoir run targets --fast
crazychoir run targets --fast --drones 3

[mission_options]: targets: [[x, y, z], ...] m, from a drone's home.
"""

from typing import Any

import msgspec
import numpy as np

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.timed import TargetList
from crazychoir.math3d import Mat, Vec
from crazychoir.recording.tracks import draw_ways

Results = dict[int, dict[str, Any]]
TARGETS = ((0.8, 0.0, 1.0), (0.8, 0.8, 1.3), (0.0, 0.8, 1.0), (-0.4, 0.4, 0.6), (0.0, 0.0, 1.0))
SPACING = 2.0


class Options(msgspec.Struct, frozen=True, kw_only=True):
    """[mission_options]."""

    targets: tuple[tuple[float, float, float], ...] = TARGETS


def targets(i: int, config: SwarmConfig) -> Mat:
    """(k, 3) m, world, of drone i; raises ConfigError that names the key."""
    try:
        given = msgspec.convert(config.mission_options, Options)
    except msgspec.ValidationError as error:
        raise ConfigError(f"swarm {config.name}: mission_options", str(error), "targets = [[x, y, z], ...]") from error
    places: Mat = np.array(given.targets).reshape(-1, 3) + config.drone(i).home
    return places


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Drone i, around its home."""
    return TargetList(list(targets(i, config)), config.drone(i).home, config.flight)


def swarm(drones: int | None = None) -> SwarmConfig:
    """Side by side along y, each with room for its targets."""
    n = 1 if drones is None else drones
    return SwarmConfig.of(
        {
            "name": "tourists",
            "mission": "targets",
            "graph": "ring" if n > 1 else "empty",
            "drones": [{"id": i, "home": [0.0, SPACING * i, 0.0]} for i in range(n)],
            "fence": {"min": [-2.0, -2.0, 0.0], "max": [2.0, SPACING * n + 2.0, 3.0]},
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """There are targets, all of them inside the fence."""
    low, high = config.fence.min, config.fence.max
    for i in config.ids:
        places = targets(i, config)
        if not len(places):
            raise ConfigError(f"swarm {config.name}: mission_options.targets", "none", "one target or more")
        for k, place in enumerate(places):
            if not (np.all(place >= low) and np.all(place <= high)):
                where = f"swarm {config.name}: mission_options.targets[{k}]"
                allowed = f"inside [fence], {list(low)} to {list(high)} m"
                raise ConfigError(where, f"{place.tolist()} of drone {i}", allowed, "Move it, or widen [fence].")
    return []


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """The last targets."""
    return {i: targets(i, config)[-1] for i in config.ids}


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """When each target was reached."""
    reached = {i: results.get(i, {}).get("reached_s", []) for i in config.ids}
    many = len(targets(config.ids[0], config))
    reasons = {
        i: f"reached {len(times)} of {many} targets" for i, times in reached.items() if len(times) < many
    }  # fmt: skip
    return {"success": not reasons, "reasons": reasons, "targets": many, "reached_s": reached}


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """The ways from above, and their heights."""
    heights = {i: np.array(results[i]["way"])[:, 3] for i in config.ids}
    draw_ways(path, {i: results[i]["way"] for i in config.ids}, heights, "z [m]", goal(config))
