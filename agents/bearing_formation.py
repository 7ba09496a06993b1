"""Bearing formation: followers find their places from the bearings to their neighbours alone.

crazychoir run bearing_formation --fast                 # four in a square
crazychoir run bearing_formation --fast --drones 30     # a grid
crazychoir run bearing_formation --fast --drones 11     # a letter S
crazychoir run deploy/formation_circle.toml --fast      # leaders on a circle
crazychoir run deploy/formation_drawn.toml --fast       # leaders on a hand-drawn path
"""

import numpy as np

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.control.gains import AGILE_GAINS
from crazychoir.guidance.formation import bearing
from crazychoir.guidance.formation.bearing_hooks import BearingHooks, BearingOptions
from crazychoir.guidance.formation.formation_hooks import Follower
from crazychoir.guidance.formation.shapes import Shape
from crazychoir.types import Acceleration, Heard, State


class BearingFormation(Follower):
    """Follower: the paper's law, or the normalised law, which uses the neighbours' accelerations.

        paper:       u_i = - D sum_j P_ij [ kp (p_i - p_j) + kv (v_i - v_j) ]
        normalised:  u_i = K_i^-1 sum_j P_ij [ - kp (p_i - p_j) - kv (v_i - v_j) + a_j ]
        P_ij = I - g_ij g_ij^T,   K_i = sum_j P_ij,   D = diag(1, 1, in_height)

    a_j was commanded in the tick before, so the law takes p_j and v_j from that tick too (`paired`).
    If leaders move, it takes the newest ones: see BearingLaw.

    i: id of the drone.
    shape: {id: (3,) m}, from which the bearings g_ij follow.
    neighbors: ids that drone i hears.
    law: which law, with its gains.
    moving: the leaders move.
    Source: Zhao & Zelazo 2017, IEEE TCNS 4(3); the normalised law is their law for leaders that
    accelerate.
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
        self.neighbors = neighbors
        self.W = bearing.build_law_matrix(i, shape, self.neighbors, law)
        self.a_counts = law.kind == "normalised"
        self.paired = self.a_counts and not moving

    def step(self, me: State, heard: Heard) -> Acceleration | None:
        """Return the acceleration of the law, or None to hover if a neighbour is not heard."""
        if len(heard) < len(self.neighbors):
            return None
        states = [me.flat, *(heard[j].flat for j in self.neighbors)]
        if self.a_counts:
            states += [heard[j].a for j in self.neighbors]
        return Acceleration(self.W.dot(np.concatenate(states)))


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
