"""Leaders of a formation: they stand, or fly one path side by side, while their followers fly accelerations."""

from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.math3d import Vec
from crazychoir.planning.drawing import Pen, drawing
from crazychoir.planning.feasibility import Limits
from crazychoir.planning.figure import circle
from crazychoir.planning.stroke import read_strokes
from crazychoir.planning.trajectory import Trajectory
from crazychoir.swarm.config import SwarmConfig
from crazychoir.types import FullState, Heard, Point, State

OPTIONS: dict[str, Any] = {
    "leaders": "still", "radius": 0.4, "period": 40.0, "laps": 1.0, "ramp": 5.0, "drawing": "", "begin": 4.0,
}  # fmt: skip
"""Of a mission whose leaders may move: what they do, m and s of the circle, the CSV file of the drawing, and s of the
law after which they begin."""


class Leader(CFDistributedFeedback):
    """Stands at its place, or flies a path that begins there: its references are places, its followers' accelerations.

    place: (3,) m, where it hovers when the law begins;  path: None to stand;  begin: s of the law before it starts.
    """

    def __init__(self, place: Point, path: Trajectory | None = None, begin: float = 0.0) -> None:
        self.place, self.path, self.begin = np.asarray(place, dtype=float), path, begin
        self._started: float | None = None

    def height(self) -> float:
        """Of its place."""
        return float(self.place[2]) - self.member.config.flight.ground

    def step(self, me: State, heard: Heard) -> FullState | None:
        """Where it is to be now."""
        if self.path is None:
            return None
        now = self.member.clock.now()
        self._started = now if self._started is None else self._started
        return shifted(self.path, self.place, now - self._started - self.begin)


def shifted(path: Trajectory, place: Vec, t: float) -> FullState:
    """The path at t, moved so that it begins at `place`; at rest before and after it."""
    flat = path.sample(min(max(t, 0.0), path.duration)).flat.copy()
    flat[0:3] += place - path.sample(0.0).p
    return FullState(flat)


def path_of(config: SwarmConfig) -> Trajectory | None:
    """What the leaders fly, by the mission's options; None if they stand. Raises ConfigError."""
    options = OPTIONS | config.mission_options
    kind, where = options["leaders"], f"swarm {config.name}: mission_options"
    if kind == "still":
        return None
    if kind == "circle":
        return circle(
            (0.0, 0.0, 0.0), options["radius"], options["period"], laps=options["laps"], ramp=options["ramp"]
        )  # fmt: skip
    if kind != "drawn":
        raise ConfigError(f"{where}.leaders", kind, '"still", "circle" or "drawn"')
    if not options["drawing"]:
        raise ConfigError(f"{where}.drawing", "nothing", "a CSV file of rows stroke, t, x, y")
    limits = Limits(v_max=0.5 * config.flight.speed_limit, a_max=0.25 * config.flight.acceleration_limit)
    return drawing(read_strokes(options["drawing"]), Pen(timing="drawn"), limits).path


def places(config: SwarmConfig) -> dict[int, Vec]:
    """Where every drone hovers when the law begins: over its home, at its own `options.height` if it has one."""
    ground, rise = config.flight.ground, config.flight.takeoff_height
    return {
        drone.id: np.array([*drone.home[:2], ground + float(drone.options.get("height", rise))])
        for drone in config.drones
    }


def leaders_of(config: SwarmConfig) -> dict[int, Vec]:
    """The leaders' places when the law begins."""
    at = places(config)
    return {drone.id: at[drone.id] for drone in config.drones if drone.leader}


def leaders_at_last(config: SwarmConfig, duration: float) -> dict[int, Vec]:
    """The leaders' places after `duration` s of the law."""
    path, begin = path_of(config), float((OPTIONS | config.mission_options)["begin"])
    if path is None:
        return leaders_of(config)
    return {i: shifted(path, place, duration - begin).p for i, place in leaders_of(config).items()}


def leader_of(i: int, config: SwarmConfig, duration: float) -> Leader:
    """The law of leader i."""
    leader = Leader(leaders_of(config)[i], path_of(config), float((OPTIONS | config.mission_options)["begin"]))
    leader.duration = duration
    return leader


def duration_of(config: SwarmConfig, settling: float) -> float:
    """s of the law: of the options; else `settling` to form up, and, where leaders move, their path and 5 s more."""
    if "duration" in config.mission_options:
        return float(config.mission_options["duration"])
    path = path_of(config)
    return settling if path is None else float((OPTIONS | config.mission_options)["begin"]) + path.duration + 5.0
