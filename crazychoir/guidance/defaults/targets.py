"""What a mission with lists of targets needs: options, its own swarm, checks, report."""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from crazychoir.config.drone_room import room_of
from crazychoir.config.flight_room import room_text
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import Place, given, require_none
from crazychoir.guidance.mission_pictures import draw_heights
from crazychoir.guidance.mission_report import Results
from crazychoir.types import Mat, Vec

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


class TargetOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    targets: Targets = DEFAULT_TARGETS
    """(3,) m each, relative to the home of a drone."""


class TargetHooks:
    """The hooks of drones that each fly to a list of targets.

    options: the table of [mission_options].
    """

    def __init__(self, options: type[TargetOptions]) -> None:
        self.options = options

    def targets(self, i: int, config: SwarmConfig) -> Mat:
        """Return the targets of drone i, (k, 3) m, world.

        Raises ConfigError with the key that is wrong.
        """
        return np.add(given(config, self.options).targets, config.drone(i).home)

    def swarm(self, drones: int | None = None) -> SwarmConfig:
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

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that there are targets, all inside the fence. Raises ConfigError if not."""
        require_none(config)
        for i in config.ids:
            low, high = room_of(config, i)
            for k, place in enumerate(self.targets(i, config)):
                if not (np.all(place >= low) and np.all(place <= high)):
                    raise ConfigError(
                        f"swarm {config.name}: mission_options.targets[{k}]",
                        f"{place.tolist()} of drone {i}",
                        room_text(low, high),
                        "Move it, or widen [fence].",
                    )
        return []

    def goal(self, config: SwarmConfig) -> dict[int, Vec]:
        """Return the last target of each drone."""
        return {i: self.targets(i, config)[-1] for i in config.ids}

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report when each target was reached."""
        reached = {i: results.get(i, {}).get("reached_s", []) for i in config.ids}
        count = len(self.targets(config.ids[0], config))
        reasons = {
            i: f"reached {len(times)} of {count} targets"
            for i, times in reached.items()
            if len(times) < count
        }
        return {
            "success": not reasons,
            "reasons": reasons,
            "targets": count,
            "reached_s": reached,
        }

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the paths from above, and their heights."""
        draw_heights(path, results, self.goal(config))
