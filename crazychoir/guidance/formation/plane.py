"""Robots that move in the plane: a law that records its way, and what missions of robots need beside it."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.formation.formation_hooks import list_neighbors
from crazychoir.guidance.formation.rigidity import require_led
from crazychoir.guidance.mission_options import require_no_options
from crazychoir.guidance.mission_pictures import draw_ways
from crazychoir.guidance.mission_report import Results, describe_distances
from crazychoir.types import State, Vec

CORNER_TOLERANCE = 0.03
"""m: largest distance from the corner that the other robots leave free."""
EQUILIBRIUM_TOLERANCE = 0.01
"""m: largest distance from the equilibrium at the end."""


class PlaneLaw(CFDistributedFeedback):
    """A law of a robot in the plane.

    The result also holds `way`: rows [t s of the law, x, y m], one a step.
    """

    rate = 25.0

    async def mission(self) -> dict[str, Any]:
        """Run the law, and add the way."""
        self.way: list[list[float]] = []
        return {**await super().mission(), "way": self.way}

    def record(self, me: State) -> None:
        """Add the present place to the way. Every step calls this first."""
        self.way.append([len(self.way) / self.rate, *me.p[0:2].tolist()])


class CornerHooks:
    """The hooks of robots that form a shape in the plane, wherever its centre is.

    corners: returns the shape, {id: (2,) m}.
    """

    def __init__(self, corners: Callable[[SwarmConfig], dict[int, Vec]]) -> None:
        self.corners = corners

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that there are no options. Raises ConfigError if there are."""
        require_no_options(config)
        return []

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Check that each robot is in its corner, relative to the centre of all robots."""
        wanted = self.corners(config)
        offsets = {
            i: np.array(result["place"][:2]) - wanted[i]
            for i, result in results.items()
            if "place" in result
        }
        middle = np.mean(list(offsets.values()), axis=0) if offsets else np.zeros(2)
        errors = {
            i: float(np.linalg.norm(offset - middle)) for i, offset in offsets.items()
        }
        reasons = {
            i: f"{far:.3f} m from its corner, allowed {CORNER_TOLERANCE} m"
            for i, far in errors.items()
            if far > CORNER_TOLERANCE
        }
        return {
            "worst_error_m": max(errors.values(), default=0.0),
            "success": not reasons,
            "reasons": reasons,
        }

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the paths from above, and each robot's distance from the final place of its corner."""
        wanted = self.corners(config)
        ends = {i: np.array(results[i]["way"][-1][1:3]) for i in config.ids}
        middle = np.mean([ends[i] - wanted[i] for i in config.ids], axis=0)
        goals = {i: corner + middle for i, corner in wanted.items()}
        draw_distances(path, results, goals, "m from its corner")


class PointHooks:
    """The hooks of points that are drawn in between leaders that stand still."""

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that each follower hears a leader, directly or through others.

        Else it has no equilibrium.

        Raises Refused if not.
        """
        require_no_options(config)
        leaders = [robot.id for robot in config.drones if robot.leader]
        require_led(list_neighbors(config), leaders)
        return []

    def goal(self, config: SwarmConfig) -> dict[int, Vec]:
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

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Check that every follower is at the equilibrium of the leaders' places."""
        reasons = describe_distances(
            self.goal(config), results, EQUILIBRIUM_TOLERANCE, "its equilibrium"
        )
        return {"success": not reasons, "reasons": reasons}

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the paths from above, and each robot's distance from its equilibrium."""
        draw_distances(path, results, self.goal(config), "m from its equilibrium")


def draw_distances(
    path: str, results: Results, goals: Mapping[int, Vec], label: str
) -> None:
    """Write a picture of ways from above, and of the distances from the goals over time.

    path: the file to write.
    results: `way` has rows [t s, x, y m].
    goals: {id: (2,) m or more}.
    label: label of the distances.
    """
    ways = {i: results[i]["way"] for i in goals}
    far = {
        i: np.linalg.norm(np.array(way)[:, 1:3] - goals[i][0:2], axis=1)
        for i, way in ways.items()
    }
    draw_ways(path, ways, far, label, goals)
