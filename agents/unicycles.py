"""Four robots on wheels drive into a square: a formation by displacements.

Each robot uses only the places of its neighbours.

crazychoir run unicycles --fast
"""

from typing import Any

import numpy as np

from crazychoir import CFDistributedFeedback, SwarmConfig, Velocity
from crazychoir.config.checks import WORLD_URIS
from crazychoir.guidance.mission_options import NoOptions, given, require_none
from crazychoir.recording.analysis.tracks import draw_ways
from crazychoir.types import Heard, State, Vec

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
POLYGON_SIDE = 1.0
"""m: side of the polygon."""
ROBOT_STARTS = [[-1.6, 1.2], [1.5, 1.6], [1.8, -1.0], [-1.2, -1.7]]
"""(2,) m each: starts of four robots."""
ROBOT_CORNERS = [[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]
"""(2,) m each: the square of four robots."""
CORNER_TOLERANCE = 0.03
"""m: largest distance from the corner that the other robots leave free."""


class Formation(CFDistributedFeedback):
    """u_i = k sum_j [ (p_j - d_j) - (p_i - d_i) ]

    In the plane all p_i - d_i converge to one point.

    i: id of the robot.
    corners: {id: (2,) m}, d.
    k: 1/s.
    Source: consensus with offsets, Ren & Beard 2008, Distributed Consensus in Multi-vehicle
    Cooperative Control, 3.
    """

    rate = 25.0
    duration = 16.0

    def __init__(self, i: int, corners: dict[int, Vec], k: float = 0.8) -> None:
        self.k, self.to = k, {j: corner - corners[i] for j, corner in corners.items()}

    async def mission(self) -> dict[str, Any]:
        """Run the law; the result also holds `way`: rows [t s of the law, x, y m], one a step."""
        self.way: list[list[float]] = []
        return {**await super().mission(), "way": self.way}

    def step(self, me: State, heard: Heard) -> Velocity:
        """Return a velocity in the plane. A robot that hears no neighbour stands still."""
        self.way.append([len(self.way) / self.rate, *me.p[0:2].tolist()])
        u = np.zeros(3)
        for j, other in heard.items():
            u[0:2] += self.k * (other.p[0:2] - me.p[0:2] - self.to[j])
        return Velocity(u)


def guidance(i: int, config: SwarmConfig) -> Formation:
    """Return the law of robot i."""
    return Formation(i, corners(config))


def corners(config: SwarmConfig) -> dict[int, Vec]:
    """Return the corners {id: (2,) m}.

    They form a square for four robots, else a polygon with the same length of side.
    """
    n = len(config.ids)
    if n == len(ROBOT_CORNERS):
        return dict(zip(config.ids, np.array(ROBOT_CORNERS), strict=True))
    angles = 2.0 * np.pi * np.arange(n) / n
    polygon = (
        0.5
        * POLYGON_SIDE
        / np.sin(np.pi / max(n, 2))
        * np.column_stack([np.cos(angles), np.sin(angles)])
    )
    return dict(zip(config.ids, polygon, strict=True))


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return four robots, or another number on a wide circle, in a ring graph.

    Their headings are arbitrary.
    """
    n = len(ROBOT_STARTS) if drones is None else drones
    angles = 2.0 * np.pi * np.arange(n) / n
    starts = (
        ROBOT_STARTS
        if n == len(ROBOT_STARTS)
        else (2.5 * np.column_stack([np.cos(angles), np.sin(angles)])).round(3).tolist()
    )
    robots = [
        {"id": i, "home": [*p, 0.0], "yaw": float(i), "uri": WORLD_URIS.unicycle}
        for i, p in enumerate(starts)
    ]
    flight = {"speed_limit": 0.5}
    return SwarmConfig.of(
        {
            "name": "unicycles",
            "mission": "unicycles",
            "drones": robots,
            "flight": flight,
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check that there are no options. Raises ConfigError if there are."""
    given(config, NoOptions)
    require_none(config)
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Check that each robot is in its corner, relative to the centre of all robots."""
    wanted = corners(config)
    offsets = {
        i: np.array(result["place"][:2]) - wanted[i]
        for i, result in results.items()
        if "place" in result
    }
    middle = np.mean(list(offsets.values()), axis=0) if offsets else np.zeros(2)
    errors = {
        i: float(np.linalg.norm(offset - middle)) for i, offset in offsets.items()
    }
    off = {
        i: f"{far:.3f} m from its corner, allowed {CORNER_TOLERANCE} m"
        for i, far in errors.items()
        if far > CORNER_TOLERANCE
    }
    return {
        "worst_error_m": max(errors.values(), default=0.0),
        "success": not off,
        "reasons": off,
    }


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the paths from above, and each robot's distance from the final place of its corner."""
    ways = {i: np.array(results[i]["way"]) for i in config.ids}
    wanted = corners(config)
    middle = np.mean([way[-1, 1:3] - wanted[i] for i, way in ways.items()], axis=0)
    goals = {i: corner + middle for i, corner in wanted.items()}
    far = {i: np.linalg.norm(way[:, 1:3] - goals[i], axis=1) for i, way in ways.items()}
    draw_ways(
        path,
        {i: way.tolist() for i, way in ways.items()},
        far,
        "m from its corner",
        goals,
    )
