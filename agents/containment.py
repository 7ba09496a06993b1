"""Containment: the followers come to lie among their leaders, in the convex hull of their places.

crazychoir run containment --fast
crazychoir run deploy/containment_random.toml --fast    # edges that come and go

[mission_options]: edges = "static" | "random";  share: of its neighbours that a drone chooses in each tick, of random
edges;  kp: 1/s2, kv: 1/s;  duration: s;  and those of guidance/leader.py, as leaders = "circle".
"""

from typing import Any

import numpy as np

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance import leader
from crazychoir.guidance.modes import Chain, mode_margin
from crazychoir.guidance.rigidity import distance_to_hull, grounded_laplacian, require_led
from crazychoir.recording.tracks import draw_tracks
from crazychoir.types import Acceleration, Heard, State, Vec

Results = dict[int, dict[str, Any]]
DEFAULTS: dict[str, Any] = {"edges": "static", "share": 0.5, "kp": 0.8, "kv": 1.6}
TOLERANCE = 0.02
"""m: a follower that is farther outside of the hull has not come in."""


class Containment(CFDistributedFeedback):
    """u_i = - 1/(d_i s^2) sum_j c_ij(k) [ kp (p_i - p_j) + kv (v_i - v_j) ]

    d_i: how many drones i has as neighbours;  static edges: c_ij = 1, s = 1.  Random edges: in tick k each drone
    chooses each of its neighbours with probability s, and c_ij(k) = 1 where i chose j and j chose i, else 0; so on
    average nothing changes. The draws are a function of (seed, i, j, k): both ends know them without a word.
    Where the law is at rest each follower is at the mean of its neighbours, so in the hull of the leaders.
    kp: 1/s2;  kv: 1/s;  share: s, 1 for static edges.
    Source: Ji, Ferrari-Trecate, Egerstedt & Buffa 2008, IEEE TAC 53(8), for single integrators.
    """

    def __init__(self, i: int, neighbors: tuple[int, ...], kp: float, kv: float, share: float, seed: int) -> None:
        self.neighbors, self.kp, self.kv, self.share, self.k = neighbors, kp, kv, share, 0
        self.draws = {
            j: [np.random.default_rng([seed, a, b]) for a, b in ((i, j), (j, i))] for j in neighbors
        }  # fmt: skip

    def step(self, me: State, heard: Heard) -> Acceleration:
        """The law, over those edges that count in this tick."""
        u, weight = np.zeros(3), 1.0 / (len(self.neighbors) * self.share**2)
        counted = [j for j in self.neighbors if self.counts(j)]
        for j in counted:
            if j in heard:
                u -= weight * (self.kp * (me.p - heard[j].p) + self.kv * (me.v - heard[j].v))
        return Acceleration(u)

    def counts(self, j: int) -> bool:
        """Whether both ends of this edge have chosen it, in a tick of its own: asked once a tick."""
        if self.share >= 1.0:
            return True
        mine, its = (draw.random() < self.share for draw in self.draws[j])
        return mine and its


def options(config: SwarmConfig) -> dict[str, Any]:
    """All of them, checked."""
    found = DEFAULTS | {key: config.mission_options[key] for key in DEFAULTS if key in config.mission_options}
    where = f"swarm {config.name}: mission_options"
    if found["edges"] not in ("static", "random"):
        raise ConfigError(f"{where}.edges", found["edges"], '"static" or "random"')
    if not 0.0 < found["share"] <= 1.0:
        raise ConfigError(f"{where}.share", found["share"], "above 0, at most 1")
    return found


def guidance(i: int, config: SwarmConfig) -> CFDistributedFeedback:
    """The law of drone i: a leader's or a follower's."""
    duration = leader.duration_of(config, 20.0)
    if config.drone(i).leader:
        return leader.leader_of(i, config, duration)
    chosen = options(config)
    share = chosen["share"] if chosen["edges"] == "random" else 1.0
    law = Containment(i, config.graph().in_neighbors(i), chosen["kp"], chosen["kv"], share, config.seed)
    law.duration = duration
    return law


def swarm(drones: int | None = None) -> SwarmConfig:
    """Four leaders on a square of 2.4 m, four followers outside of it, each with two leaders and two followers."""
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
            "drones": [{"id": i, "home": [*p, 0.0], "leader": i < 4} for i, p in enumerate(inner + outer)],
        }
    )


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """Each follower at the mean of its neighbours, with the leaders where they are at last: L_ff p_f = - L_fl p_l."""
    leaders = leader.leaders_at_last(config, leader.duration_of(config, 20.0))
    l_ff, l_fl = grounded_laplacian(_neighbors(config), leaders)
    p = -np.linalg.solve(l_ff, l_fl @ np.array([leaders[i] for i in sorted(leaders)]))
    return leaders | dict(zip((i for i in config.ids if i not in leaders), p, strict=True))


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Refuses followers that no leader reaches, and gains that are not stable."""
    chosen, leaders = options(config), leader.leaders_of(config)
    require_led(_neighbors(config), leaders)
    eigenvalues = np.abs(np.linalg.eigvals(grounded_laplacian(_neighbors(config), leaders)[0])).tolist()
    both = 2 * eigenvalues, [n < len(eigenvalues) for n in range(2 * len(eigenvalues))]
    if mode_margin(*both, chosen["kp"], chosen["kv"], Chain()) <= 0.0:
        raise Refused("containment", f"kp = {chosen['kp']:g}, kv = {chosen['kv']:g} are unstable. Lower them.")
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Every follower has come into the hull of the leaders' places."""
    flown = {i: np.array(result["place"]) for i, result in results.items() if "place" in result}
    corners = [flown[i] for i in leader.leaders_of(config) if i in flown]
    outside = {i: distance_to_hull(corners, p) for i, p in flown.items() if not config.drone(i).leader and corners}
    reasons = {i: f"{far:.3f} m outside of the leaders' hull" for i, far in outside.items() if far > TOLERANCE}
    return {"outside_m": max(outside.values(), default=None), "success": not reasons, "reasons": reasons}


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """What was flown, from above."""
    draw_tracks(results, path, leaders=list(leader.leaders_of(config)), edges=config.graph().edges())


def _neighbors(config: SwarmConfig) -> dict[int, tuple[int, ...]]:
    graph = config.graph()
    return {i: graph.in_neighbors(i) for i in graph.ids}
