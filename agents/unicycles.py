"""Four robots on wheels drive into a square: a formation by displacements.

Each robot uses only the places of its neighbours.

crazychoir run unicycles --fast
"""

import numpy as np

from crazychoir import SwarmConfig, Velocity
from crazychoir.config.checks import WORLD_URIS
from crazychoir.guidance.formation.plane import CornerHooks, PlaneLaw
from crazychoir.guidance.formation.shapes import polygon, ring
from crazychoir.guidance.mission_options import NoOptions
from crazychoir.types import Heard, State, Vec

POLYGON_SIDE = 1.0
"""m: side of the polygon."""
ROBOT_STARTS = [[-1.6, 1.2], [1.5, 1.6], [1.8, -1.0], [-1.2, -1.7]]
"""(2,) m each: starts of four robots."""
ROBOT_CORNERS = [[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]
"""(2,) m each: the square of four robots."""


class Formation(PlaneLaw):
    """u_i = k sum_j [ (p_j - d_j) - (p_i - d_i) ]

    In the plane all p_i - d_i converge to one point.

    i: id of the robot.
    corners: {id: (2,) m}, d.
    k: 1/s.
    Source: consensus with offsets, Ren & Beard 2008, Distributed Consensus in Multi-vehicle
    Cooperative Control, 3.
    """

    duration = 16.0

    def __init__(self, i: int, corners: dict[int, Vec], k: float = 0.8) -> None:
        self.k = k
        self.to = {j: corner - corners[i] for j, corner in corners.items()}

    def step(self, me: State, heard: Heard) -> Velocity:
        """Return a velocity in the plane. A robot that hears no neighbour stands still."""
        self.record(me)
        u = np.zeros(3)
        for j, other in heard.items():
            u[0:2] += self.k * (other.p[0:2] - me.p[0:2] - self.to[j])
        return Velocity(u)


def corners(config: SwarmConfig) -> dict[int, Vec]:
    """Return the corners {id: (2,) m}: a square for four robots, else a polygon."""
    n = len(config.ids)
    is_square = n == len(ROBOT_CORNERS)
    places = np.array(ROBOT_CORNERS) if is_square else polygon(n, POLYGON_SIDE)
    return dict(zip(config.ids, places, strict=True))


Options = NoOptions
hooks = CornerHooks(corners)
check = hooks.check
report = hooks.report
picture = hooks.picture


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return four robots, or another number on a wide circle. Their headings are arbitrary."""
    n = len(ROBOT_STARTS) if drones is None else drones
    is_square = n == len(ROBOT_STARTS)
    starts = ROBOT_STARTS if is_square else ring(n, 2.5).round(3).tolist()
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


def guidance(i: int, config: SwarmConfig) -> Formation:
    """Return the law of robot i."""
    return Formation(i, corners(config))
