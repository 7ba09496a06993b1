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
from crazychoir.types import Acceleration, Heard, Mat, State, Vec


class PythonBearingLaw(Follower):
    """Follower: the normalised law, as one product of a matrix with the states of all neighbours.

        u_i = sum_j W_j (kp p_j + kv v_j + a_j) - kp p_i - kv v_i
        W_j = K_i^-1 P_ij,   K_i = sum_j P_ij,   P_ij = I - g_ij g_ij^T

    The terms of the drone itself have no weights, because sum_j W_j = I.

    i: id of the drone
    shape: {id: (3,) m}, from which the bearings g_ij follow
    neighbors: ids that drone i hears
    """

    gains = AGILE_GAINS
    paired = True

    def __init__(self, i: int, shape: Shape, neighbors: tuple[int, ...]) -> None:
        projectors = [projector(np.subtract(shape[j], shape[i])) for j in neighbors]
        total = np.sum(projectors, axis=0)
        self.neighbors = neighbors
        self.own_gain = build_state_gain(-np.eye(3))
        """(3, 13): from the drone's state to its acceleration."""
        self.gain = np.hstack(
            [
                np.hstack([build_state_gain(weight), weight])
                for weight in np.linalg.solve(total, np.array(projectors))
            ]
        )
        """(3, 16 k): from the states and accelerations of k neighbours to the acceleration."""

    def step(self, me: State, heard: Heard) -> Acceleration | None:
        """Return the acceleration of the law, or None to hover if a neighbour is not heard."""
        if len(heard) < len(self.neighbors):
            return None
        parts: list[Vec] = []
        for j in self.neighbors:
            other = heard[j]
            parts += other.flat, other.a
        heard_part = self.gain.dot(np.concatenate(parts))
        return Acceleration(heard_part + self.own_gain.dot(me.flat))


def build_state_gain(weight: Mat) -> Mat:
    """Return the gain (3, 13) from a state to the acceleration weight (kp p + kv v).

    weight: (3, 3)
    """
    gain = np.zeros((3, 13))
    gain[:, 0:3] = NORMALISED_LAW.kp * weight
    gain[:, 3:6] = NORMALISED_LAW.kv * weight
    return gain


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
