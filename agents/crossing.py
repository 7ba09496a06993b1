"""Each drone flies straight to its goal, whoever is in its way: what keeps them apart is the collision filter alone.

crazychoir run crossing --fast --drones 30 --picture out/crossing.png

[mission_options]: pattern = "antipodal" | "permutation";  radius: m;  speed: m/s;  low, high: m, of starts and goals;
jitter: m, of starts and goals sideways;  time: s of the law.
"""

from typing import Any

import msgspec
import numpy as np

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.types import FullState, Heard, State, Vec

DEFAULTS: dict[str, Any] = {
    "pattern": "antipodal", "radius": 3.0, "speed": 0.8, "low": 0.3, "high": 2.2, "jitter": 0.1, "time": 30.0,
}  # fmt: skip
ARRIVED = 0.05
"""m from its goal: there, once it stays there."""
Results = dict[int, dict[str, Any]]


class Straight(CFDistributedFeedback):
    """p_d(t) = a + min(speed t, |b - a|) (b - a) / |b - a|."""

    def __init__(self, start: Vec, goal: Vec, speed: float, time: float) -> None:
        self.start, self.goal, self.speed, self.duration = start, goal, speed, time
        self.far = float(np.linalg.norm(goal - start))
        self.way = (goal - start) / self.far
        self.arrived: float | None = None
        self.steps = 0

    def height(self) -> float:
        """Where it starts."""
        return float(self.start[2])

    def step(self, me: State, heard: Heard) -> FullState:
        """The straight line."""
        t = self.steps / self.rate
        self.steps += 1
        if np.linalg.norm(me.p - self.goal) > ARRIVED:
            self.arrived = None
        elif self.arrived is None:
            self.arrived = t
        gone = self.speed * t
        if gone >= self.far:
            return FullState.at(self.goal)
        return FullState.at(self.start + gone * self.way, self.speed * self.way)

    async def mission(self) -> dict[str, Any]:
        """Rise to the start, cross, land at the goal."""
        return await super().mission() | {"arrived_s": self.arrived}


def guidance(i: int, config: SwarmConfig) -> Straight:
    """The way of drone i."""
    options = DEFAULTS | config.mission_options
    starts, goals = places(config)
    n = config.ids.index(i)
    return Straight(starts[n], goals[n], options["speed"], options["time"])


def places(config: SwarmConfig) -> tuple[Vec, Vec]:
    """Starts and goals, (n, 3) m each, from the swarm's seed."""
    options, n = DEFAULTS | config.mission_options, len(config.ids)
    draw = np.random.default_rng(config.seed)
    while True:
        starts, goals = _circle(draw, n, options, 0.0), _circle(draw, n, options, np.pi)
        if options["pattern"] == "permutation":
            goals = starts[draw.permutation(n)]
        if _apart(starts) > 0.34 and _apart(goals) > 0.34 and np.linalg.norm(goals - starts, axis=1).min() > 0.1:
            return starts, goals


def _circle(draw: np.random.Generator, n: int, options: dict[str, Any], turn: float) -> Vec:
    angles = turn + 2.0 * np.pi * np.arange(n) / n
    flat = options["radius"] * np.column_stack([np.cos(angles), np.sin(angles)])
    heights = draw.uniform(options["low"], options["high"], n)
    return np.column_stack([flat + draw.uniform(-options["jitter"], options["jitter"], (n, 2)), heights])


def _apart(p: Vec) -> float:
    d = (p[:, None] - p[None]) * [1.0, 1.0, 0.4]
    return float((np.linalg.norm(d, axis=2) + 9.0 * np.eye(len(p))).min())


def scatter(config: SwarmConfig) -> SwarmConfig:
    """The same swarm with its homes below the starts."""
    starts, _ = places(config)
    rows = [{**msgspec.to_builtins(config.drone(i)), "home": [*starts[n, :2].tolist(), 0.0]} for n, i in enumerate(config.ids)]
    return config.replace(drones=rows)


def swarm(drones: int | None = None) -> SwarmConfig:
    """Thirty drones at motor level that lose one message in ten, on a circle."""
    n = drones or 30
    angles = 2.0 * np.pi * np.arange(n) / n
    homes = 3.0 * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    rows = [{"id": k, "home": homes[k].round(3).tolist(), "uri": "sim://motors", "platform": "cf21"} for k in range(n)]
    return SwarmConfig.of(
        {
            "name": "crossing", "mission": "crossing", "drones": rows, "graph": "ring",
            "network": {"loss": 0.1, "burst": 4.0},
            "fence": {"min": [-4.0, -4.0, 0.0], "max": [4.0, 4.0, 3.0]},
        }
    )  # fmt: skip
