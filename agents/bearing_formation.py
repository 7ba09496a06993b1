"""Bearing formation: followers find their places from the bearings to their neighbours alone.

crazychoir run bearing_formation --fast                 # four in a square
crazychoir run bearing_formation --fast --drones 30     # a grid
crazychoir run bearing_formation --fast --drones 11     # a letter S
crazychoir run deploy/formation_circle.toml --fast      # leaders on a circle
crazychoir run deploy/formation_drawn.toml --fast       # leaders on a hand-drawn path
"""

from collections.abc import Sequence
from typing import Self

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.control.gains import AGILE_GAINS
from crazychoir.guidance.decision.team import Ids, TeamLaw, step_alone
from crazychoir.guidance.formation import bearing
from crazychoir.guidance.formation.bearing_hooks import BearingHooks, BearingOptions
from crazychoir.guidance.formation.bearing_rows import build_bearing_team
from crazychoir.guidance.formation.formation_hooks import Follower
from crazychoir.guidance.formation.shapes import Shape
from crazychoir.types import Heard, Reference, State


class BearingFormation(Follower):
    """Follower: the paper's law, or the normalised law, which uses the neighbours' accelerations.

        paper:       u_i = - D sum_j P_ij [ kp (p_i - p_j) + kv (v_i - v_j) ]
        normalised:  u_i = K_i^-1 sum_j P_ij [ - kp (p_i - p_j) - kv (v_i - v_j) + a_j ]
        P_ij = I - g_ij g_ij^T,   K_i = sum_j P_ij,   D = diag(1, 1, in_height)

    a_j is that of the tick before, and so are p_j and v_j, unless leaders move: see BearingLaw.

    i: id of the drone.
    shape: {id: (3,) m}, from which the bearings g_ij follow.
    neighbors: ids that drone i hears.
    law: which law, with its gains.
    moving: the leaders move.
    Source: Zhao & Zelazo 2017, IEEE TCNS 4(3); the normalised law is theirs for leaders with a_j.
    """

    gains = AGILE_GAINS

    def __init__(
        self,
        i: int,
        shape: Shape,
        neighbors: tuple[int, ...],
        law: bearing.BearingLaw = bearing.NORMALISED_LAW,
        moving: bool = False,
    ) -> None:
        self.law = law
        self.weights = bearing.build_edge_weights(i, shape, neighbors, law)
        self.paired = law.kind == "normalised" and not moving

    @classmethod
    def for_team(cls, laws: Sequence[Self], neighbors: Sequence[Ids]) -> TeamLaw:
        """Return the step of all followers of a process: the text of the law is there."""
        return build_bearing_team(laws, neighbors)

    def step(self, me: State, heard: Heard) -> Reference | None:
        """Return the acceleration of the law, or None to hover if a neighbour is not heard."""
        return step_alone(self, me, heard)


Options = BearingOptions
hooks = BearingHooks(Options)
DroneOptions = hooks.drone_options
swarm = hooks.swarm
scatter = hooks.scatter
goal = hooks.goal
check = hooks.check
report = hooks.report
picture = hooks.picture


def guidance(i: int, config: SwarmConfig) -> CFDistributedFeedback:
    """Return the law of drone i: the law of a leader or of a follower."""
    if config.drone(i).leader:
        return hooks.leader(i, config)
    law = BearingFormation(
        i,
        hooks.shape(config),
        hooks.neighbors(config)[i],
        hooks.law(config),
        hooks.leaders_move(config),
    )
    law.gains = hooks.gains(config)
    law.duration = hooks.duration(config)
    law.rest = hooks.rest(config)
    return law
