"""Containment: the followers move into the convex hull of the leaders' places.

crazychoir run containment --fast
crazychoir run deploy/containment_random.toml --fast    # edges that come and go
"""

import numpy as np

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.guidance.formation.containment_hooks import (
    ContainmentHooks,
    ContainmentOptions,
)
from crazychoir.guidance.formation.formation_hooks import Follower
from crazychoir.guidance.formation.random_edges import RandomEdges, count_ticks
from crazychoir.types import Acceleration, Heard, State


class Containment(Follower):
    """u_i = - 1/(d_i s^2) sum_j c_ij(k) [ kp (p_i - p_j) + kv (v_i - v_j) ]

    d_i is the number of neighbours of i. Static edges: c_ij = 1, s = 1. Random edges: in tick k
    each drone chooses each of its neighbours with probability s. c_ij(k) = 1 if i chose j and j
    chose i, else 0. The mean of the law is therefore that of static edges.

    Where the law is at rest each follower is at the mean of its neighbours, so in the hull of the
    leaders.

    edges: to the neighbours that drone i hears, with c_ij(k) and s.
    kp: 1/s2.
    kv: 1/s.
    Source: Ji, Ferrari-Trecate, Egerstedt & Buffa 2008, IEEE TAC 53(8), for single integrators.
    """

    def __init__(self, edges: RandomEdges, kp: float, kv: float) -> None:
        self.edges = edges
        self.kp = kp
        self.kv = kv

    def step(self, me: State, heard: Heard) -> Acceleration:
        """Return the acceleration of the law, over the edges that count in this tick."""
        return self.pulled(me, heard, count_ticks(self.member.clock, self.rate))

    def pulled(self, me: State, heard: Heard, k: int) -> Acceleration:
        """Return the acceleration of the law in tick k."""
        u = np.zeros(3)
        weight = 1.0 / (len(self.edges.neighbors) * self.edges.share**2)
        for j in self.edges.neighbors:
            if j in heard and self.edges.counts(j, k):
                u -= weight * (
                    self.kp * (me.p - heard[j].p) + self.kv * (me.v - heard[j].v)
                )
        return Acceleration(u)


Options = ContainmentOptions
hooks = ContainmentHooks(Options)
DroneOptions = hooks.drone_options
swarm = hooks.swarm
goal = hooks.goal
check = hooks.check
report = hooks.report
picture = hooks.picture


def guidance(i: int, config: SwarmConfig) -> CFDistributedFeedback:
    """Return the law of drone i: the law of a leader or of a follower."""
    if config.drone(i).leader:
        return hooks.leader(i, config)
    options = hooks.given(config)
    law = Containment(hooks.edges(i, config), options.kp, options.kv)
    law.duration = hooks.duration(config)
    return law


def share(options: Options) -> float:
    """Return the share of its neighbours that a drone chooses in each tick; 1 for static edges."""
    return options.share if options.edges == "random" else 1.0


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return four leaders on a square of 2.4 m, and four followers outside of it.

    Each follower hears two leaders and two followers.
    """
    if drones not in (None, 8):
        raise ConfigError("--drones", drones, "8", "Or write a swarm file.")
    inner = [(1.2, 1.2), (-1.2, 1.2), (-1.2, -1.2), (1.2, -1.2)]
    outer = [(0.5, 2.2), (-2.2, 0.5), (-0.5, -2.2), (2.2, -0.5)]
    edges = [[4 + k, leader] for k in range(4) for leader in (k, (k + 1) % 4)]
    edges += [[4 + k, 4 + (k + 1) % 4] for k in range(4)]
    return SwarmConfig.of(
        {
            "name": "containment",
            "mission": "containment",
            "edges": edges,
            "drones": [
                {"id": i, "home": [*p, 0.0], "leader": i < 4}
                for i, p in enumerate(inner + outer)
            ],
        }
    )


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """Return the equilibrium with the leaders at their last places: L_ff p_f = - L_fl p_l.

    Each follower is at the mean of its neighbours.
    """
    leaders = leader.leaders_at_last(config, given(config, Options))
    l_ff, l_fl = grounded_laplacian(_neighbors(config), leaders)
    p = -np.linalg.solve(l_ff, l_fl @ np.array([leaders[i] for i in sorted(leaders)]))
    return leaders | dict(
        zip((i for i in config.ids if i not in leaders), p, strict=True)
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check the graph, the gains and the paths of the leaders.

    Raises Refused for a follower that no leader reaches, and for gains that are not stable. Raises
    ConfigError for paths that the leaders cannot fly.
    """
    options = given(config, Options)
    leaders = leader.leaders_of(config)
    if len(leaders) == len(config.ids):
        raise Refused(
            "containment",
            "every drone is a leader. Name only the drones that are not to be led.",
        )
    require_led(_neighbors(config), leaders)
    _require_stable(config, options, leaders)
    leader.require_flyable(config, options)
    return []


def _require_stable(
    config: SwarmConfig, options: Options, leaders: dict[int, Vec]
) -> None:
    """Raise Refused for gains that are not stable if all edges count in each tick.

    Random edges all count for a while, now and then.
    """
    chosen = share(options)
    kp = options.kp / chosen**2
    kv = options.kv / chosen**2
    eigenvalues = np.abs(
        np.linalg.eigvals(grounded_laplacian(_neighbors(config), leaders)[0])
    ).tolist()
    both = 2 * eigenvalues, [n < len(eigenvalues) for n in range(2 * len(eigenvalues))]
    if compute_mode_margin(*both, kp, kv, AccelerationChain()) <= 0.0:
        of, do = (
            (f" over share^2 = {chosen**2:.3g}", ", or raise share")
            if chosen < 1.0
            else ("", "")
        )
        text = f"kp = {options.kp:g}, kv = {options.kv:g}{of} are unstable behind the attitude loop. Lower them{do}."
        raise Refused("containment", text)


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
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


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the flown paths from above."""
    draw_tracks(
        results,
        path,
        leaders=list(leader.leaders_of(config)),
        edges=config.graph().edges(),
    )


def _neighbors(config: SwarmConfig) -> dict[int, tuple[int, ...]]:
    graph = config.graph()
    return {i: graph.in_neighbors(i) for i in graph.ids}
