"""Distance-based formation: followers keep given distances to their neighbours, but no directions.

crazychoir run distance_formation --fast
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.control.gains import AGILE_GAINS
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.formation import leader
from crazychoir.guidance.formation.leader import LeaderOptions
from crazychoir.guidance.formation.modes import AccelerationChain, compute_mode_margin
from crazychoir.guidance.formation.rigidity import require_rigid
from crazychoir.guidance.formation.scattering import Scatter, scatter_swarm
from crazychoir.guidance.mission_options import (
    Gain,
    Places,
    Spreads,
    given,
    require_each,
)
from crazychoir.recording.analysis.tracks import draw_tracks
from crazychoir.types import Acceleration, Heard, State, Vec

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
HEIGHT_GAINS = 2.0, 2.5
"""1/s2 and 1/s: gains kz and kvz that hold the height of a flat formation.

Distances do not determine the height of a flat formation.
"""
DISTANCE_TOLERANCE = 0.02
"""m: largest error of a distance at the end of the law."""


class Options(LeaderOptions, frozen=True, kw_only=True):
    """[mission_options]."""

    k: Gain = 0.6
    """1/(m2 s2): gain of the distances."""
    kv: Gain = 1.2
    """1/s: gain of the velocities."""
    shape: Places | None = None
    """m: places that define the distances. None: the homes."""
    scatter: Spreads = (0.3, 0.3, 0.2)
    """m: largest random shift of the followers' starts, by axis."""


class DistanceFormation(CFDistributedFeedback):
    """u_i = sum_j [ k (|p_j - p_i|^2 - d_ij^2) (p_j - p_i) - kv (v_i - v_j) ]

    A flat formation uses p and v without z, and holds its height by

        u_z = - kz (z - height) - kvz v_z

    The first term is the negative gradient of k/4 sum_ij (|p_i - p_j|^2 - d_ij^2)^2 over all edges.
    The second term brakes. Mirror images have the same distances. The formation reaches the shape
    that is near its start.

    d: {j: m}, the wanted distances.
    k: 1/(m2 s2).
    kv: 1/s.
    height: m, world: height of a flat formation. None: a formation in space.
    Source: Krick, Broucke & Francis 2009, Int. J. Control 82(3), for single integrators.
    """

    gains = AGILE_GAINS

    def __init__(
        self, d: Mapping[int, float], k: float, kv: float, height: float | None
    ) -> None:
        self.d = dict(d)
        self.k = k
        self.kv = kv
        self.level = height

    def height(self) -> float | None:
        """Return the height in the drone's options, so that it may start elsewhere."""
        return leader.height_of(self.member.config, self.id)

    def step(self, me: State, heard: Heard) -> Acceleration | None:
        """Return the acceleration of the law, or None to hover if a neighbour is not heard."""
        if len(heard) < len(self.d):
            return None
        u = np.zeros(3)
        axes = 3 if self.level is None else 2
        for j, d in self.d.items():
            gap = (heard[j].p - me.p)[:axes]
            u[:axes] += (
                self.k * (gap @ gap - d * d) * gap
                + self.kv * (heard[j].v - me.v)[:axes]
            )
        if self.level is not None:
            u[2] = HEIGHT_GAINS[0] * (self.level - me.p[2]) - HEIGHT_GAINS[1] * me.v[2]
        return Acceleration(u)


def guidance(i: int, config: SwarmConfig) -> CFDistributedFeedback:
    """Return the law of drone i: the law of a leader or of a follower."""
    options = given(config, Options)
    places = shape(config)
    if config.drone(i).leader:
        return leader.leader_of(i, config, options)
    d = {
        j: float(np.linalg.norm(places[i] - places[j]))
        for j in config.graph().neighbors(i)
    }
    level = (
        config.flight.ground + config.flight.takeoff_height if flat(config) else None
    )
    law = DistanceFormation(d, options.k, options.kv, level)
    law.duration = leader.duration_of(config, options)
    return law


def shape(config: SwarmConfig) -> dict[int, Vec]:
    """Return {id: (3,) m}, the shape of the mission options, or the homes."""
    places = given(config, Options).shape
    if places is None:
        return {drone.id: np.array(drone.home) for drone in config.drones}
    require_each(config, places, "shape")
    return {i: np.array(p) for i, p in places.items()}


def flat(config: SwarmConfig) -> bool:
    """Return whether the whole shape is at one height. Then distances would not hold the height."""
    return len({float(p[2]) for p in shape(config).values()}) == 1


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return a hexagon with two neighbouring drones as leaders.

    Each drone hears the next two drones on both sides. --drones changes the number of corners.
    """
    n = drones or 6
    if n < 5:
        raise ConfigError("--drones", drones, "5 or more")
    radius = max(1.0, 0.16 * n)
    places = [
        [radius * np.cos(2 * np.pi * k / n), radius * np.sin(2 * np.pi * k / n), 1.0]
        for k in range(n)
    ]
    rounded = {str(k): [round(float(x), 4) for x in p] for k, p in enumerate(places)}
    return SwarmConfig.of(
        {
            "name": "distances",
            "mission": "distance_formation",
            "edges": [[k, (k + step) % n] for k in range(n) for step in (1, 2)],
            "drones": [
                {"id": k, "home": [*rounded[str(k)][:2], 0.0], "leader": k < 2}
                for k in range(n)
            ],
            "mission_options": {"shape": rounded, "scatter": [0.3, 0.3, 0.2]},
        }
    )


def scatter(config: SwarmConfig) -> SwarmConfig:
    """Return the swarm with the starts of its followers moved at random, clear of each other.

    Each start moves by up to `scatter` (3,) m an axis.
    """
    return scatter_swarm(config, Scatter(*given(config, Options).scatter))


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Refuse a graph or gains with which the formation does not hold.

    The graph must be undirected: the law follows a gradient only if both ends of an edge pull.
    Raises ConfigError for a directed graph. Raises Refused if the graph is not infinitesimally
    rigid with these leaders, or if the gains are not stable.
    """
    options = given(config, Options)
    leaders = leader.leaders_of(config)
    if not config.graph().is_undirected:
        raise ConfigError(
            f"swarm {config.name}: graph", "a directed graph", "an undirected one"
        )
    axes = 2 if flat(config) else 3
    r = require_rigid(
        {i: p[:axes] for i, p in shape(config).items()}, config.graph().edges(), leaders
    )
    stiffest = 2.0 * options.k * float(np.linalg.norm(r, 2) ** 2)
    heard = [len(config.graph().neighbors(i)) for i in config.ids if i not in leaders]
    for damping in (options.kv * min(heard) * 0.5, options.kv * max(heard)):
        if (
            compute_mode_margin(
                [1.0], [True], stiffest, damping, AccelerationChain(AGILE_GAINS)
            )
            <= 0.0
        ):
            text = f"k = {options.k:g}, kv = {options.kv:g}: its stiffest mode, {stiffest:.1f} 1/s2, is unstable"
            raise Refused(
                "distance formation",
                f"{text} behind the attitude loop. Lower k, or raise kv.",
            )
    leader.require_flyable(config, options)
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Compare the distances at the end of the law with the wanted distances.

    The places are the drones' own estimates.
    """
    at = {i: r["place"] for i, r in results.items() if "place" in r}
    places = shape(config)
    axes = 2 if flat(config) else 3
    off = 0.0
    reasons = {}
    for i, j in config.graph().edges():
        if i in at and j in at:
            found, wanted = (
                np.linalg.norm(np.subtract(p[i], p[j])[:axes]) for p in (at, places)
            )
            off = max(off, abs(float(found - wanted)))
            if abs(found - wanted) > DISTANCE_TOLERANCE:
                reasons[i] = (
                    f"{found:.3f} m from drone {j} at the end of the law, {wanted:.3f} m wanted"
                )
    return {"distance_error_m": off, "success": not reasons, "reasons": reasons}


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the flown paths from above."""
    draw_tracks(
        results,
        path,
        leaders=list(leader.leaders_of(config)),
        edges=config.graph().edges(),
    )
