"""The bearing law as a user writes it: `step` in Python, with numpy, for one drone at a time."""

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.gains import AGILE_GAINS
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.formation.bearing import NORMALISED_LAW
from crazychoir.guidance.formation.bearing_hooks import BearingHooks, BearingOptions
from crazychoir.guidance.formation.formation_hooks import Follower
from crazychoir.guidance.formation.shapes import Shape
from crazychoir.numerics.math3d import projector
from crazychoir.types import Acceleration, Heard, State


class PythonBearingLaw(Follower):
    """Follower: the normalised law, one neighbour after the other.

        u_i = sum_j W_j [ kp (p_j - p_i) + kv (v_j - v_i) + a_j ]
        W_j = K_i^-1 P_ij,   K_i = sum_j P_ij,   P_ij = I - g_ij g_ij^T

    i: id of the drone
    shape: {id: (3,) m}, from which the bearings g_ij follow
    neighbors: ids that drone i hears
    """

    gains = AGILE_GAINS
    paired = True

    def __init__(self, i: int, shape: Shape, neighbors: tuple[int, ...]) -> None:
        projectors = {j: projector(np.subtract(shape[j], shape[i])) for j in neighbors}
        total = np.sum(list(projectors.values()), axis=0)
        self.weights = {j: np.linalg.solve(total, p) for j, p in projectors.items()}
        self.kp = NORMALISED_LAW.kp
        self.kv = NORMALISED_LAW.kv

    def step(self, me: State, heard: Heard) -> Acceleration | None:
        """Return the acceleration of the law, or None to hover if a neighbour is not heard."""
        if len(heard) < len(self.weights):
            return None
        u = np.zeros(3)
        for j, weight in self.weights.items():
            other = heard[j]
            pull = self.kp * (other.p - me.p) + self.kv * (other.v - me.v) + other.a
            u += weight @ pull
        return Acceleration(u)


class PythonBearingMission:
    """The mission `bearing_formation` with PythonBearingLaw for its followers."""

    def __init__(self) -> None:
        self.hooks = BearingHooks(BearingOptions)

    def guidance(self, i: int, config: SwarmConfig) -> CFDistributedFeedback:
        """Return the law of drone i: the law of a leader or of a follower."""
        if config.drone(i).leader:
            return self.hooks.leader(i, config)
        shape = self.hooks.shape(config)
        law = PythonBearingLaw(i, shape, config.graph().in_neighbors(i))
        law.duration = self.hooks.duration(config)
        return law
