"""Each drone flies to a list of targets, one after the other.

It goes on to the next target when it is within 5 cm of the present one.

crazychoir run targets --fast
crazychoir run targets --fast --drones 3
"""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.config.drone_room import room_of
from crazychoir.config.flight_room import room_text
from crazychoir.config.tables import SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import Place, given, require_none
from crazychoir.guidance.timed import TargetList
from crazychoir.recording.analysis.tracks import draw_ways
from crazychoir.types import Mat, Vec

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
DEFAULT_TARGETS = (
    (0.8, 0.0, 1.0),
    (0.8, 0.8, 1.3),
    (0.0, 0.8, 1.0),
    (-0.4, 0.4, 0.6),
    (0.0, 0.0, 1.0),
)
"""(3,) m each: default targets, relative to the home of a drone."""
HOME_SPACING = 2.0
"""m: distance between two homes."""
Targets = Annotated[
    tuple[Place, ...],
    Meta(
        min_length=1,
        description="one place [x, y, z] or more, in m, within 1000 m",
        examples=[[[0.8, 0.0, 1.0]]],
    ),
]


class Options(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    targets: Targets = DEFAULT_TARGETS
    """(3,) m each, relative to the home of a drone."""


def targets(i: int, config: SwarmConfig) -> Mat:
    """Return the targets of drone i, (k, 3) m, world.

    Raises ConfigError with the key that is wrong.
    """
    return np.add(given(config, Options).targets, config.drone(i).home)


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i: its targets around its home."""
    return TargetList(list(targets(i, config)), config.drone(i).home, config.flight)


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return drones side by side along y, each with room for its targets."""
    n = 1 if drones is None else drones
    return SwarmConfig.of(
        {
            "name": "tourists",
            "mission": "targets",
            "graph": "ring" if n > 1 else "empty",
            "drones": [
                {"id": i, "home": [0.0, HOME_SPACING * i, 0.0]} for i in range(n)
            ],
            "fence": {
                "min": [-2.0, -2.0, 0.0],
                "max": [2.0, HOME_SPACING * n + 2.0, 3.0],
            },
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check that there are targets, all inside the fence. Raises ConfigError if not."""
    require_none(config)
    for i in config.ids:
        low, high = room_of(config, i)
        places = targets(i, config)
        for k, place in enumerate(places):
            if not (np.all(place >= low) and np.all(place <= high)):
                where = f"swarm {config.name}: mission_options.targets[{k}]"
                raise ConfigError(
                    where,
                    f"{place.tolist()} of drone {i}",
                    room_text(low, high),
                    "Move it, or widen [fence].",
                )
    return []


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """Return the last target of each drone."""
    return {i: targets(i, config)[-1] for i in config.ids}


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Report when each target was reached."""
    reached = {i: results.get(i, {}).get("reached_s", []) for i in config.ids}
    many = len(targets(config.ids[0], config))
    reasons = {
        i: f"reached {len(times)} of {many} targets"
        for i, times in reached.items()
        if len(times) < many
    }
    return {
        "success": not reasons,
        "reasons": reasons,
        "targets": many,
        "reached_s": reached,
    }


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the paths from above, and their heights."""
    heights = {i: np.array(results[i]["way"])[:, 3] for i in config.ids}
    draw_ways(
        path, {i: results[i]["way"] for i in config.ids}, heights, "z [m]", goal(config)
    )
