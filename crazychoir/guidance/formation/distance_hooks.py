"""What a formation by distances needs beside its law: options, its own swarm, checks, report."""

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.gains import AGILE_GAINS
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.formation import leader
from crazychoir.guidance.formation.formation_hooks import FormationHooks
from crazychoir.guidance.formation.leader import LeaderOptions
from crazychoir.guidance.formation.modes import AccelerationChain, compute_mode_margin
from crazychoir.guidance.formation.rigidity import require_rigid
from crazychoir.guidance.formation.scattering import Scatter, scatter_swarm
from crazychoir.guidance.mission_options import Gain, Places, Spreads, require_each
from crazychoir.guidance.mission_report import Results
from crazychoir.types import Vec

DISTANCE_TOLERANCE = 0.02
"""m: largest error of a distance at the end of the law."""


class DistanceOptions(LeaderOptions, frozen=True, kw_only=True):
    """[mission_options]."""

    k: Gain = 0.6
    """1/(m2 s2): gain of the distances."""
    kv: Gain = 1.2
    """1/s: gain of the velocities."""
    shape: Places | None = None
    """m: places that define the distances. None: the homes."""
    scatter: Spreads = (0.3, 0.3, 0.2)
    """m: largest random shift of the followers' starts, by axis."""


class DistanceHooks(FormationHooks[DistanceOptions]):
    """The hooks of a formation in which followers keep given distances to their neighbours."""

    def shape(self, config: SwarmConfig) -> dict[int, Vec]:
        """Return {id: (3,) m}, the shape of the mission options, or the homes."""
        places = self.given(config).shape
        if places is None:
            return {drone.id: np.array(drone.home) for drone in config.drones}
        require_each(config, places, "shape")
        return {i: np.array(p) for i, p in places.items()}

    def is_flat(self, config: SwarmConfig) -> bool:
        """Return whether the whole shape is at one height, which distances would not hold."""
        return len({float(p[2]) for p in self.shape(config).values()}) == 1

    def level(self, config: SwarmConfig) -> float | None:
        """Return the height in m, world, that a flat formation holds; None if it is not flat."""
        if not self.is_flat(config):
            return None
        return config.flight.ground + config.flight.takeoff_height

    def distances(self, i: int, config: SwarmConfig) -> dict[int, float]:
        """Return the wanted distance in m of drone i from each neighbour."""
        places = self.shape(config)
        return {
            j: float(np.linalg.norm(places[i] - places[j]))
            for j in config.graph().neighbors(i)
        }

    def swarm(self, drones: int | None = None) -> SwarmConfig:
        """Return a hexagon with two neighbouring drones as leaders.

        Each drone hears the next two drones on both sides.

        drones: number of corners, 5 or more.
        """
        n = drones or 6
        if n < 5:
            raise ConfigError("--drones", drones, "5 or more")
        radius = max(1.0, 0.16 * n)
        angles = [2 * np.pi * k / n for k in range(n)]
        places = {
            str(k): [
                round(float(radius * np.cos(angle)), 4),
                round(float(radius * np.sin(angle)), 4),
                1.0,
            ]
            for k, angle in enumerate(angles)
        }
        return SwarmConfig.of(
            {
                "name": "distances",
                "mission": "distance_formation",
                "edges": [[k, (k + step) % n] for k in range(n) for step in (1, 2)],
                "drones": [
                    {"id": k, "home": [*places[str(k)][:2], 0.0], "leader": k < 2}
                    for k in range(n)
                ],
                "mission_options": {"shape": places, "scatter": [0.3, 0.3, 0.2]},
            }
        )

    def scatter(self, config: SwarmConfig) -> SwarmConfig:
        """Return the swarm with the starts of its followers moved at random, clear of each other.

        Each start moves by up to `scatter` (3,) m an axis.
        """
        return scatter_swarm(config, Scatter(*self.given(config).scatter))

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Refuse a graph or gains with which the formation does not hold.

        The graph must be undirected: the law follows a gradient only if both ends of an edge pull.
        Raises ConfigError for a directed graph. Raises Refused if the graph is not infinitesimally
        rigid with these leaders, or if the gains are not stable.
        """
        options = self.given(config)
        leaders = leader.leaders_of(config)
        if not config.graph().is_undirected:
            raise ConfigError(
                f"swarm {config.name}: graph", "a directed graph", "an undirected one"
            )
        axes = 2 if self.is_flat(config) else 3
        places = {i: p[:axes] for i, p in self.shape(config).items()}
        r = require_rigid(places, config.graph().edges(), leaders)
        stiffest = 2.0 * options.k * float(np.linalg.norm(r, 2) ** 2)
        heard = [
            len(config.graph().neighbors(i)) for i in config.ids if i not in leaders
        ]
        dampings = (options.kv * min(heard) * 0.5, options.kv * max(heard))
        if not all(_is_stable(stiffest, damping) for damping in dampings):
            text = f"k = {options.k:g}, kv = {options.kv:g}: its stiffest mode, {stiffest:.1f} 1/s2, is unstable"
            raise Refused(
                "distance formation",
                f"{text} behind the attitude loop. Lower k, or raise kv.",
            )
        return super().check(config, force)

    def report(self, config: SwarmConfig, results: Results) -> dict[str, object]:
        """Compare the distances at the end of the law with the wanted distances.

        The places are the drones' own estimates.
        """
        at = {i: r["place"] for i, r in results.items() if "place" in r}
        places = self.shape(config)
        axes = 2 if self.is_flat(config) else 3
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


def _is_stable(stiffness: float, damping: float) -> bool:
    """Return whether a horizontal mode s^2 + damping s + stiffness is stable behind the attitude loop."""
    chain = AccelerationChain(AGILE_GAINS)
    return compute_mode_margin([1.0], [True], stiffness, damping, chain) > 0.0
