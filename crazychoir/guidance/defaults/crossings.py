"""What the crossing needs beside its law: options, random places, its own swarm, checks, report."""

from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from crazychoir.config.drone_room import room_of
from crazychoir.config.flight_room import room_text
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Height, Speed, SwarmTable
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.mission_options import (
    Duration,
    Length,
    Offset,
    given,
    require_none,
)
from crazychoir.guidance.mission_pictures import draw_tracks
from crazychoir.guidance.mission_report import Results
from crazychoir.types import Vec

SMALLEST_SPACING = 0.34
"""m: smallest distance between two starts, and between two goals, with heights scaled by SPACING_SCALE."""
SPACING_SCALE = (1.0, 1.0, 0.4)
"""Scale of x, y and z in these distances, as in the standard [collision]."""
GOAL_DISTANCE = 0.05
"""m: a drone has arrived when it stays nearer to its goal than this."""
LARGEST_TRIED_CROWD = 30
"""Largest number of drones that have been flown through one point at the same time.

A hundred drones press against each other there.
"""
Pattern = Annotated[
    Literal["antipodal", "permutation"],
    Meta(
        description='"antipodal" (to the other side of the circle) or "permutation" (to another\'s start)',
        examples=["permutation"],
    ),
]


class CrossingOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]. The seed of the swarm determines all random places."""

    pattern: Pattern = "antipodal"
    """How goals follow from starts."""
    radius: Length = 3.0
    """m: radius of the circle."""
    speed: Speed = 0.8
    """m/s."""
    low: Height = 0.3
    """m: lowest start or goal."""
    high: Height = 2.2
    """m: highest start or goal."""
    jitter: Offset = 0.1
    """m: largest random distance of starts and goals from the circle, along x and y."""
    duration: Duration = 20.0
    """s: duration of the law."""


class CrossingHooks:
    """The hooks of drones that cross from random starts near a circle to their goals.

    options: the table of [mission_options].
    """

    def __init__(self, options: type[CrossingOptions]) -> None:
        self.options = options

    def given(self, config: SwarmConfig) -> CrossingOptions:
        """Return [mission_options]. Raises ConfigError with the key that is wrong."""
        return given(config, self.options)

    def places(self, config: SwarmConfig) -> tuple[dict[int, Vec], dict[int, Vec]]:
        """Return the starts and the goals, (3,) m each, by drone."""
        options = self.given(config)
        n = len(config.ids)
        draw = np.random.default_rng(config.seed)
        starts = _draw_circle(draw, n, options, 0.0)
        goals = _draw_circle(draw, n, options, np.pi)
        if options.pattern == "permutation":
            goals = starts[_draw_derangement(draw, n)]
        by_start = dict(zip(config.ids, starts, strict=True))
        return by_start, dict(zip(config.ids, goals, strict=True))

    def swarm(self, drones: int | None = None) -> SwarmConfig:
        """Return drones at motor level; one in ten of their messages is lost, in bursts."""
        n = drones or 30
        radius = max(3.0, 0.6 * n / (2.0 * np.pi))
        rows = [
            {
                "id": k,
                "home": [float(k), 0.0, 0.0],
                "uri": "sim://motors",
                "platform": "cf21",
            }
            for k in range(n)
        ]
        config = SwarmConfig.of(
            {
                "name": "crossing",
                "mission": "crossing",
                "graph": "ring",
                "drones": rows,
                "fence": {
                    "min": [-radius - 1.0, -radius - 1.0, 0.0],
                    "max": [max(n, radius) + 1.0, radius + 1.0, 3.0],
                },
                "network": {"loss": 0.1, "burst": 4.0},
                "mission_options": {"radius": float(radius)},
            }
        )
        return self.scatter(config)

    def scatter(self, config: SwarmConfig) -> SwarmConfig:
        """Return the swarm with each home below the start that the seed gives."""
        starts, _ = self.places(config)
        ground = config.flight.ground
        rows = []
        for drone in config.drones:
            home = [*starts[drone.id][:2].tolist(), ground]
            rows.append(msgspec.to_builtins(drone) | {"home": home})
        return config.replace(drones=rows)

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check the options and the places, and refuse too many drones in one point.

        Raises ConfigError for wrong options, and for places outside the fence. Raises Refused
        without `force` if too many drones would fly through one point at the same time.
        """
        options = self.given(config)
        require_none(config)
        if options.low > options.high:
            where = f"swarm {config.name}: mission_options.low"
            raise ConfigError(where, options.low, f"at most high = {options.high:g}")
        self._require_room(config)
        if options.pattern != "antipodal" or len(config.ids) <= LARGEST_TRIED_CROWD:
            return []
        crowd = (
            f"{len(config.ids)} drones fly through one point at once; {LARGEST_TRIED_CROWD} "
            "have been tried, and a hundred met there"
        )
        if not force:
            raise Refused(
                "crossing",
                f'{crowd}. Take pattern = "permutation" in [mission_options], or --force.',
            )
        return [crowd]

    def _require_room(self, config: SwarmConfig) -> None:
        """Raise ConfigError for a start or a goal that is outside the room of its drone."""
        for which, found in zip(("start", "goal"), self.places(config), strict=True):
            for i, p in found.items():
                low, high = room_of(config, i)
                if np.any(p < low) or np.any(p > high):
                    raise ConfigError(
                        f"swarm {config.name}: mission_options: {which} of drone {i}",
                        p.round(2).tolist(),
                        room_text(low, high),
                        "Widen it.",
                    )

    def goal(self, config: SwarmConfig) -> dict[int, Vec]:
        """Return the goals by drone."""
        return self.places(config)[1]

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report when the last drone arrived. A drone that never stayed at its goal has failed."""
        times = {i: result.get("arrived_s") for i, result in results.items()}
        late = {
            i: f"never stayed within {GOAL_DISTANCE} m of its goal"
            for i, time in times.items()
            if time is None
        }
        arrived = [time for time in times.values() if time is not None]
        return {
            "success": not late,
            "reasons": late,
            "arrived_s": max(arrived) if arrived and not late else None,
        }

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the flown paths from above, and the goals."""
        goals = np.array(list(self.goal(config).values()))
        draw_tracks(results, path, marks={"goal": goals})


def _draw_circle(
    draw: np.random.Generator, n: int, options: CrossingOptions, turn: float
) -> Vec:
    """Return n places near a circle, shifted at random and clear of each other."""
    angles = turn + 2.0 * np.pi * np.arange(n) / n
    flat = options.radius * np.column_stack([np.cos(angles), np.sin(angles)])
    off = options.jitter
    for _ in range(1000):
        heights = draw.uniform(options.low, options.high, n)
        found = np.column_stack([flat + draw.uniform(-off, off, (n, 2)), heights])
        gaps = (found[:, None] - found[None]) * SPACING_SCALE
        apart = np.linalg.norm(gaps, axis=2) + 9.0 * np.eye(n)
        if apart.min() >= SMALLEST_SPACING:
            return found
    raise ConfigError(
        "mission_options.radius",
        options.radius,
        f"room for {n} drones",
        "Take a larger one.",
    )


def _draw_derangement(draw: np.random.Generator, n: int) -> list[int]:
    """Return a permutation that moves every element."""
    while True:
        order = draw.permutation(n)
        if n == 1 or np.all(order != np.arange(n)):
            return [int(k) for k in order]
