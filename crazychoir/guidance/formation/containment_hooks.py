"""What containment needs beside its law: options, its own swarm, equilibrium, checks, report."""

from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Share
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.formation import leader
from crazychoir.guidance.formation.formation_hooks import FormationHooks, list_neighbors
from crazychoir.guidance.formation.leader import LeaderOptions
from crazychoir.guidance.formation.modes import AccelerationChain, compute_mode_margin
from crazychoir.guidance.formation.random_edges import RandomEdges
from crazychoir.guidance.formation.rigidity import (
    distance_to_hull,
    grounded_laplacian,
    require_led,
)
from crazychoir.guidance.mission_options import Gain
from crazychoir.guidance.mission_report import Results
from crazychoir.types import Vec

HULL_TOLERANCE = 0.02
"""m: a follower farther outside of the hull is not inside."""
LEADER_SQUARE = ((1.2, 1.2), (-1.2, 1.2), (-1.2, -1.2), (1.2, -1.2))
"""(2,) m each: homes of the leaders."""
FOLLOWER_HOMES = ((0.5, 2.2), (-2.2, 0.5), (-0.5, -2.2), (2.2, -0.5))
"""(2,) m each: homes of the followers, outside of the leaders' square."""
EdgeKind = Annotated[
    Literal["static", "random"],
    Meta(description='"static" or "random"', examples=["random"]),
]


class ContainmentOptions(LeaderOptions, frozen=True, kw_only=True):
    """[mission_options]."""

    edges: EdgeKind = "static"
    """Edges that always count, or random edges."""
    share: Share = 0.5
    """Share of its neighbours that a drone chooses in each tick, for random edges."""
    kp: Gain = 0.8
    """1/s2: gain of the positions."""
    kv: Gain = 1.6
    """1/s: gain of the velocities."""


class ContainmentHooks(FormationHooks[ContainmentOptions]):
    """The hooks of followers that move into the convex hull of their leaders."""

    def share(self, config: SwarmConfig) -> float:
        """Return the share of its neighbours that a drone chooses in each tick; 1 for static edges."""
        options = self.given(config)
        return options.share if options.edges == "random" else 1.0

    def edges(self, i: int, config: SwarmConfig) -> RandomEdges:
        """Return the edges of drone i to the neighbours that it hears."""
        neighbors = config.graph().in_neighbors(i)
        return RandomEdges(i, neighbors, self.share(config), config.seed)

    def swarm(self, drones: int | None = None) -> SwarmConfig:
        """Return four leaders on a square of 2.4 m, and four followers outside of it.

        Each follower hears two leaders and two followers.
        """
        if drones not in (None, 8):
            raise ConfigError("--drones", drones, "8", "Or write a swarm file.")
        edges = [[4 + k, other] for k in range(4) for other in (k, (k + 1) % 4)]
        edges += [[4 + k, 4 + (k + 1) % 4] for k in range(4)]
        return SwarmConfig.of(
            {
                "name": "containment",
                "mission": "containment",
                "edges": edges,
                "drones": [
                    {"id": i, "home": [*p, 0.0], "leader": i < len(LEADER_SQUARE)}
                    for i, p in enumerate(LEADER_SQUARE + FOLLOWER_HOMES)
                ],
            }
        )

    def goal(self, config: SwarmConfig) -> dict[int, Vec]:
        """Return the equilibrium with the leaders at their last places: L_ff p_f = - L_fl p_l.

        Each follower is at the mean of its neighbours.
        """
        leaders = leader.leaders_at_last(config, self.given(config))
        l_ff, l_fl = grounded_laplacian(list_neighbors(config), leaders)
        places = np.array([leaders[i] for i in sorted(leaders)])
        p = -np.linalg.solve(l_ff, l_fl @ places)
        followers = (i for i in config.ids if i not in leaders)
        return leaders | dict(zip(followers, p, strict=True))

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check the graph, the gains and the paths of the leaders.

        Raises Refused for a follower that no leader reaches, and for gains that are not stable.
        Raises ConfigError for paths that the leaders cannot fly.
        """
        self.given(config)
        leaders = leader.leaders_of(config)
        if len(leaders) == len(config.ids):
            raise Refused(
                "containment",
                "every drone is a leader. Name only the drones that are not to be led.",
            )
        require_led(list_neighbors(config), leaders)
        self._require_stable(config, leaders)
        return super().check(config, force)

    def _require_stable(self, config: SwarmConfig, leaders: dict[int, Vec]) -> None:
        """Raise Refused for gains that are not stable if all edges count in each tick.

        Random edges all count for a while, now and then.
        """
        options = self.given(config)
        share = self.share(config)
        laplacian, _ = grounded_laplacian(list_neighbors(config), leaders)
        modes = np.abs(np.linalg.eigvals(laplacian)).tolist()
        margin = compute_mode_margin(
            2 * modes,
            len(modes) * [True] + len(modes) * [False],
            options.kp / share**2,
            options.kv / share**2,
            AccelerationChain(),
        )
        if margin > 0.0:
            return
        over = f" over share^2 = {share**2:.3g}" if share < 1.0 else ""
        raise_share = ", or raise share" if share < 1.0 else ""
        raise Refused(
            "containment",
            f"kp = {options.kp:g}, kv = {options.kv:g}{over} are unstable behind the attitude loop. "
            f"Lower them{raise_share}.",
        )

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Check that every follower has come into the hull of the leaders' places."""
        flown = {
            i: np.array(result["place"])
            for i, result in results.items()
            if "place" in result
        }
        corners = [flown[i] for i in leader.leaders_of(config) if i in flown]
        outside = {
            i: distance_to_hull(corners, p)
            for i, p in flown.items()
            if not config.drone(i).leader and corners
        }
        reasons = {
            i: f"{far:.3f} m outside of the leaders' hull"
            for i, far in outside.items()
            if far > HULL_TOLERANCE
        }
        return {
            "outside_m": max(outside.values(), default=None),
            "success": not reasons,
            "reasons": reasons,
        }
