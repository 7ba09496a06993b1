"""Containment: the followers move into the convex hull of the leaders' places.

crazychoir run containment --fast
crazychoir run deploy/containment_random.toml --fast    # edges that come and go
"""

from collections.abc import Sequence
from typing import Self

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.guidance.decision.team import Ids, TeamLaw, step_alone
from crazychoir.guidance.formation.containment_hooks import (
    ContainmentHooks,
    ContainmentOptions,
)
from crazychoir.guidance.formation.containment_rows import (
    ContainmentLaw,
    build_containment_team,
)
from crazychoir.guidance.formation.formation_hooks import Follower
from crazychoir.guidance.formation.random_edges import RandomEdges
from crazychoir.types import Heard, Reference, State


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

    @classmethod
    def for_team(cls, laws: Sequence[Self], neighbors: Sequence[Ids]) -> TeamLaw:
        """Return the step of all followers of a process: the text of the law is there."""
        numbers = [ContainmentLaw(law.edges, law.kp, law.kv, law.rate) for law in laws]
        return build_containment_team(numbers, neighbors)

    def step(self, me: State, heard: Heard) -> Reference | None:
        """Return the acceleration of the law, over the edges that count in this tick."""
        return step_alone(self, me, heard, self.member.clock)


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
