"""Containment: points without and with inertia move into the triangle of leaders that stand still.

crazychoir run integrators --fast
"""

from typing import Any

import numpy as np

from crazychoir import Acceleration, CFDistributedFeedback, SwarmConfig, Velocity
from crazychoir.config.checks import WORLD_URIS
from crazychoir.guidance.formation.rigidity import require_led
from crazychoir.guidance.mission_options import NoOptions, given, require_none
from crazychoir.recording.analysis.tracks import draw_ways
from crazychoir.types import Heard, State, Vec

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
LEADER_PLACES = [[0.0, 1.8], [-1.6, -1.0], [1.6, -1.0]]
"""(2,) m each: places of the leaders."""
FOLLOWER_STARTS = [[2.2, 1.6], [-2.4, 1.0], [0.3, -2.4]]
"""(2,) m each: starts of the followers."""
CONTAINMENT_EDGES = [
    [0, 3],
    [0, 4],
    [1, 4],
    [1, 5],
    [2, 5],
    [2, 3],
    [3, 4],
    [4, 5],
    [3, 5],
]
"""The communication graph."""
EQUILIBRIUM_TOLERANCE = 0.01
"""m: largest distance from the equilibrium at the end."""


class IntegratorContainment(CFDistributedFeedback):
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

    rate = 25.0
    duration = 12.0

    def __init__(
        self, leader: bool, inertia: bool, k: float = 0.6, c: float = 2.0
    ) -> None:
        self.leader = leader
        self.inertia = inertia
        self.k = k
        self.c = c

    async def mission(self) -> dict[str, Any]:
        """Run the law; the result also holds `way`: rows [t s of the law, x, y m], one a step."""
        self.way: list[list[float]] = []
        return {**await super().mission(), "way": self.way}

    def step(self, me: State, heard: Heard) -> Velocity | Acceleration | None:
        """Return the reference of the law; None for a leader."""
        self.way.append([len(self.way) / self.rate, *me.p[0:2].tolist()])
        if self.leader:
            return None
        pull = self.k * sum((other.p - me.p for other in heard.values()), np.zeros(3))
        return Acceleration(pull - self.c * me.v) if self.inertia else Velocity(pull)


def guidance(i: int, config: SwarmConfig) -> IntegratorContainment:
    """Return the law of robot i."""
    robot = config.drone(i)
    return IntegratorContainment(
        robot.leader, inertia=robot.uri == WORLD_URIS.double_integrator
    )


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return three leaders and three followers: one obeys velocities, two obey accelerations."""
    uris = [WORLD_URIS.single_integrator] * 4 + [WORLD_URIS.double_integrator] * 2
    robots = [
        {"id": i, "home": [*p, 0.5], "uri": uri, "leader": i < len(LEADER_PLACES)}
        for i, (p, uri) in enumerate(
            zip(LEADER_PLACES + FOLLOWER_STARTS, uris, strict=True)
        )
    ]
    return SwarmConfig.of(
        {
            "name": "integrators",
            "mission": "integrators",
            "edges": CONTAINMENT_EDGES,
            "drones": robots,
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check that each follower hears a leader, directly or through others.

    Else it has no equilibrium.

    Raises Refused if not.
    """
    given(config, NoOptions)
    require_none(config)
    graph = config.graph()
    leaders = [robot.id for robot in config.drones if robot.leader]
    require_led({i: graph.in_neighbors(i) for i in graph.ids}, leaders)
    return []


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """Return p_f = - L_ff^-1 L_fl p_l for the followers, and the own places for the leaders."""
    ids = config.ids
    graph = config.graph()
    laplacian = np.array(
        [[-1.0 if j in graph.in_neighbors(i) else 0.0 for j in ids] for i in ids]
    )
    laplacian -= np.diag(laplacian.sum(axis=1))
    leads = np.array([config.drone(i).leader for i in ids])
    places = np.array([config.drone(i).home for i in ids])
    follow = ~leads
    places[follow] = -np.linalg.solve(
        laplacian[follow][:, follow], laplacian[follow][:, leads] @ places[leads]
    )
    return dict(zip(ids, places, strict=True))


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Check that every follower is at the equilibrium of the leaders' places."""
    goals = goal(config)
    off = {}
    for i, result in results.items():
        far = (
            float(np.linalg.norm(goals[i] - result["place"]))
            if "place" in result
            else 0.0
        )
        if far > EQUILIBRIUM_TOLERANCE:
            off[i] = (
                f"{far:.3f} m from its equilibrium, allowed {EQUILIBRIUM_TOLERANCE} m"
            )
    return {"success": not off, "reasons": off}


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the paths from above, and each robot's distance from its equilibrium."""
    ways = {i: np.array(results[i]["way"]) for i in config.ids}
    goals = goal(config)
    far = {
        i: np.linalg.norm(way[:, 1:3] - goals[i][0:2], axis=1)
        for i, way in ways.items()
    }
    draw_ways(
        path,
        {i: way.tolist() for i, way in ways.items()},
        far,
        "m from its equilibrium",
        goals,
    )
