"""Each drone flies straight to its goal: only the collision filter keeps the drones apart.

Its own swarm loses one message in ten, in bursts of four on average. `--loss 0` switches that off.

crazychoir run crossing --fast --drones 6 --picture out/crossing.png
"""

from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.config.drone_room import room_of
from crazychoir.config.flight_room import room_text
from crazychoir.config.tables import Height, Speed, SwarmTable
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.mission_options import (
    Duration,
    Length,
    Offset,
    given,
    require_none,
)
from crazychoir.recording.analysis.tracks import draw_tracks
from crazychoir.types import FullState, Heard, State, Vec

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
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


class Options(SwarmTable, frozen=True, kw_only=True):
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


class Straight(CFDistributedFeedback):
    """Fly a straight line from a to b, without regard to other drones.

        p_d(t) = a + min(speed t, |b - a|) w,   w = (b - a) / |b - a|

    start: (3,) m, world: a.
    goal: (3,) m, world: b.
    speed: m/s.
    duration: s: duration of the law.
    """

    def __init__(self, start: Vec, goal: Vec, speed: float, duration: float) -> None:
        self.start = start
        self.goal = goal
        self.speed = speed
        self.duration = duration
        self.far = float(np.linalg.norm(goal - start))
        self.way = (goal - start) / self.far
        self.steps = 0
        self.arrived: float | None = None

    def height(self) -> float:
        """Return the height of the start above the ground, in m."""
        return float(self.start[2] - self.member.config.flight.ground)

    def step(self, me: State, heard: Heard) -> FullState:
        """Return the point of the straight line that is due now."""
        t = self.steps / self.rate
        self.steps += 1
        if np.linalg.norm(me.p - self.goal) > GOAL_DISTANCE:
            self.arrived = None
        elif self.arrived is None:
            self.arrived = t
        gone = self.speed * t
        on_its_way = gone < self.far
        return FullState.at(
            self.start + min(gone, self.far) * self.way,
            on_its_way * self.speed * self.way,
        )

    async def mission(self) -> dict[str, Any]:
        """Take off, cross, land.

        The result also holds arrived_s: s of the law after which the drone stayed at its goal,
        None: never.
        """
        return await super().mission() | {"arrived_s": self.arrived}


def guidance(i: int, config: SwarmConfig) -> Straight:
    """Return the law of drone i."""
    options, (starts, goals) = given(config, Options), places(config)
    return Straight(starts[i], goals[i], options.speed, options.duration)


def places(config: SwarmConfig) -> tuple[dict[int, Vec], dict[int, Vec]]:
    """Return the starts and the goals, (3,) m each, by drone."""
    options = given(config, Options)
    n = len(config.ids)
    draw = np.random.default_rng(config.seed)
    starts = _circle(draw, n, options, 0.0)
    goals = _circle(draw, n, options, np.pi)
    if options.pattern == "permutation":
        goals = starts[_deranged(draw, n)]
    return dict(zip(config.ids, starts, strict=True)), dict(
        zip(config.ids, goals, strict=True)
    )


def _circle(draw: np.random.Generator, n: int, options: Options, turn: float) -> Vec:
    """Return n places near a circle, shifted at random and clear of each other."""
    angles = turn + 2.0 * np.pi * np.arange(n) / n
    flat = options.radius * np.column_stack([np.cos(angles), np.sin(angles)])
    off = options.jitter
    for _ in range(1000):
        heights = draw.uniform(options.low, options.high, n)
        found = np.column_stack([flat + draw.uniform(-off, off, (n, 2)), heights])
        apart = np.linalg.norm(
            (found[:, None] - found[None]) * SPACING_SCALE, axis=2
        ) + 9.0 * np.eye(n)
        if apart.min() >= SMALLEST_SPACING:
            return found
    raise ConfigError(
        "mission_options.radius",
        options.radius,
        f"room for {n} drones",
        "Take a larger one.",
    )


def _deranged(draw: np.random.Generator, n: int) -> list[int]:
    """Return a permutation that moves every element."""
    while True:
        order = draw.permutation(n)
        if n == 1 or np.all(order != np.arange(n)):
            return [int(k) for k in order]


def swarm(drones: int | None = None) -> SwarmConfig:
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
    fence = {
        "min": [-radius - 1.0, -radius - 1.0, 0.0],
        "max": [max(n, radius) + 1.0, radius + 1.0, 3.0],
    }
    raw = {
        "name": "crossing",
        "mission": "crossing",
        "graph": "ring",
        "drones": rows,
        "fence": fence,
    }
    return scatter(
        SwarmConfig.of(
            raw
            | {
                "network": {"loss": 0.1, "burst": 4.0},
                "mission_options": {"radius": float(radius)},
            }
        )
    )


def scatter(config: SwarmConfig) -> SwarmConfig:
    """Return the swarm with each home below the start that the seed gives."""
    starts, _ = places(config)
    ground = config.flight.ground
    rows = [
        msgspec.to_builtins(drone) | {"home": [*starts[drone.id][:2].tolist(), ground]}
        for drone in config.drones
    ]
    return config.replace(drones=rows)


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check the options and the places, and refuse too many drones in one point.

    Raises ConfigError for wrong options, and for places outside the fence. Raises Refused without
    `force` if too many drones would fly through one point at the same time.
    """
    where = f"swarm {config.name}: mission_options"
    options = given(config, Options)
    require_none(config)
    if options.low > options.high:
        raise ConfigError(
            f"{where}.low", options.low, f"at most high = {options.high:g}"
        )
    for which, found in zip(("start", "goal"), places(config), strict=True):
        for i, p in found.items():
            low, high = room_of(config, i)
            if np.any(p < low) or np.any(p > high):
                raise ConfigError(
                    f"{where}: {which} of drone {i}",
                    p.round(2).tolist(),
                    room_text(low, high),
                    "Widen it.",
                )
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


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """Return the goals by drone."""
    return places(config)[1]


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
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


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the flown paths from above, and the goals."""
    draw_tracks(results, path, marks={"goal": np.array(list(goal(config).values()))})
