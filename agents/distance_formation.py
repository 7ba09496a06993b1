"""Distance-based formation: followers keep given distances to their neighbours, but no directions.

crazychoir run distance_formation --fast
"""

from collections.abc import Mapping

import numpy as np

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.control.gains import AGILE_GAINS
from crazychoir.guidance.formation.distance_hooks import DistanceHooks, DistanceOptions
from crazychoir.guidance.formation.formation_hooks import Follower
from crazychoir.types import Acceleration, Heard, State

HEIGHT_GAINS = 2.0, 2.5
"""1/s2 and 1/s: gains kz and kvz that hold the height of a flat formation, which distances do not."""


class DistanceFormation(Follower):
    """u_i = sum_j [ k (|p_j - p_i|^2 - d_ij^2) (p_j - p_i) - kv (v_i - v_j) ]

    A flat formation uses p and v without z, and holds its height by

        u_z = - kz (z - height) - kvz v_z

    The first term is the negative gradient of k/4 sum_ij (|p_i - p_j|^2 - d_ij^2)^2 over all edges.
    The second term brakes. Mirror images have the same distances. The formation reaches the shape
    that is near its start.

    d: {j: m}, the wanted distances.
    k: 1/(m2 s2).
    kv: 1/s.
    level: m, world: height of a flat formation. None: a formation in space.
    Source: Krick, Broucke & Francis 2009, Int. J. Control 82(3), for single integrators.
    """

    gains = AGILE_GAINS

    def __init__(
        self, d: Mapping[int, float], k: float, kv: float, level: float | None
    ) -> None:
        self.d = dict(d)
        self.k = k
        self.kv = kv
        self.level = level

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


Options = DistanceOptions
hooks = DistanceHooks(Options)
DroneOptions = hooks.drone_options
swarm = hooks.swarm
scatter = hooks.scatter
check = hooks.check
report = hooks.report
picture = hooks.picture


def guidance(i: int, config: SwarmConfig) -> CFDistributedFeedback:
    """Return the law of drone i: the law of a leader or of a follower."""
    if config.drone(i).leader:
        return hooks.leader(i, config)
    options = hooks.given(config)
    law = DistanceFormation(
        hooks.distances(i, config), options.k, options.kv, hooks.level(config)
    )
    law.duration = hooks.duration(config)
    return law
