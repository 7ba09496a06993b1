"""Distance-based formation: followers keep given distances to their neighbours, but no directions.

crazychoir run distance_formation --fast
"""

from collections.abc import Mapping, Sequence
from typing import Self

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.control.gains import AGILE_GAINS
from crazychoir.guidance.decision.team import Ids, TeamLaw, step_alone
from crazychoir.guidance.formation.distance_hooks import DistanceHooks, DistanceOptions
from crazychoir.guidance.formation.distance_rows import DistanceLaw, build_distance_team
from crazychoir.guidance.formation.formation_hooks import Follower
from crazychoir.types import Heard, Reference, State

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
        self.law = DistanceLaw(dict(d), k, kv, HEIGHT_GAINS, level)

    @classmethod
    def for_team(cls, laws: Sequence[Self], neighbors: Sequence[Ids]) -> TeamLaw:
        """Return the step of all followers of a process: the text of the law is there."""
        return build_distance_team([law.law for law in laws], neighbors)

    def step(self, me: State, heard: Heard) -> Reference | None:
        """Return the acceleration of the law, or None to hover if a neighbour is not heard."""
        return step_alone(self, me, heard)


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
