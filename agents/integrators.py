"""Containment: points without and with inertia move into the triangle of leaders that stand still.

crazychoir run integrators --fast
"""

import numpy as np

from crazychoir import Acceleration, SwarmConfig, Velocity
from crazychoir.config.checks import WORLD_URIS
from crazychoir.guidance.formation.plane import PlaneLaw, PointHooks
from crazychoir.guidance.mission_options import NoOptions
from crazychoir.types import Heard, State

LEADER_PLACES = [[0.0, 1.8], [-1.6, -1.0], [1.6, -1.0]]
"""(2,) m each: places of the leaders."""
FOLLOWER_STARTS = [[2.2, 1.6], [-2.4, 1.0], [0.3, -2.4]]
"""(2,) m each: starts of the followers."""
POINT_EDGES = [[0, 3], [0, 4], [1, 4], [1, 5], [2, 5], [2, 3], [3, 4], [4, 5], [3, 5]]
"""The communication graph."""


class IntegratorContainment(PlaneLaw):
    """Leaders stand still. The law of a follower depends on the commands that it obeys:

        a velocity:       u_i = k sum_j (p_j - p_i)
        an acceleration:  u_i = k sum_j (p_j - p_i) - c v_i

    Followers end at p_f = - L_ff^-1 L_fl p_l, in the convex hull of the leaders.

    leader: the robot is a leader.
    inertia: the robot obeys accelerations.
    k: 1/s or 1/s2.
    c: 1/s.
    Source: Ji, Ferrari-Trecate, Egerstedt & Buffa 2008, IEEE TAC 53(8), 1972-1975.
    """

    duration = 12.0

    def __init__(
        self, leader: bool, inertia: bool, k: float = 0.6, c: float = 2.0
    ) -> None:
        self.leader = leader
        self.inertia = inertia
        self.k = k
        self.c = c

    def step(self, me: State, heard: Heard) -> Velocity | Acceleration | None:
        """Return the reference of the law; None for a leader."""
        self.record(me)
        if self.leader:
            return None
        pull = self.k * sum((other.p - me.p for other in heard.values()), np.zeros(3))
        return Acceleration(pull - self.c * me.v) if self.inertia else Velocity(pull)


Options = NoOptions
hooks = PointHooks()
goal = hooks.goal
check = hooks.check
report = hooks.report
picture = hooks.picture


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return three leaders and three followers: one obeys velocities, two obey accelerations."""
    uris = [WORLD_URIS.single_integrator] * 4 + [WORLD_URIS.double_integrator] * 2
    robots = [
        {"id": i, "home": [*p, 0.5], "uri": uris[i], "leader": i < len(LEADER_PLACES)}
        for i, p in enumerate(LEADER_PLACES + FOLLOWER_STARTS)
    ]
    return SwarmConfig.of(
        {
            "name": "integrators",
            "mission": "integrators",
            "edges": POINT_EDGES,
            "drones": robots,
        }
    )


def guidance(i: int, config: SwarmConfig) -> IntegratorContainment:
    """Return the law of robot i."""
    robot = config.drone(i)
    return IntegratorContainment(
        robot.leader, inertia=robot.uri == WORLD_URIS.double_integrator
    )
