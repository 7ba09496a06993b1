"""Slow random torques and forces on flying drones, as Ornstein-Uhlenbeck processes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from crazychoir.numerics.kernels import kernel, matrix, real, table, vector, whole
from crazychoir.platforms import Platform
from crazychoir.simulation.common.draws import (
    RANDOM_STREAMS,
    Keys,
    derive_stream_key,
    draw_normals,
)
from crazychoir.types import Mat, Vec

YAW_SHARE = 1.0 / 3.0
"""Torques about z as a share of those about x and y: hovering drones yaw about as much as they tilt."""

stream_keys: Any = numba.types.Array(numba.uint64, 1, "C", readonly=True)


@dataclass(frozen=True, slots=True)
class Disturbances:
    """How strong and how slow the disturbances are.

    Source: with 3 rad/s2 and 0.05 to 0.1 m/s2 over 0.5 s, simulated laps scatter by 9 to 14 mm and
    hovering drones turn by 0.4 degrees, as real ones do (77 flights of NanoBench, arXiv 2603.09908).
    """

    torque: float
    """rad/s2: standard deviation of the angular acceleration about x and y; a third of it about z."""
    force: float
    """m/s2: standard deviation of the acceleration, for each axis, world."""
    time: float = 0.5
    """s: time constant."""


@kernel(table, stream_keys, whole, matrix, real, matrix, matrix, vector, table, table)
def _advance(
    state: Mat,
    keys: Keys,
    tick: int,
    deviations: Mat,
    decay: float,
    force: Mat,
    torque: Mat,
    resting: Vec,
    force_sum: Mat,
    torque_sum: Mat,
) -> None:
    """Draw the next disturbances, and add those of flying drones to the external wrenches.

        d <- d a + s sqrt(1 - a^2) n,   a = exp(-dt / T)

    state: (n, 6): forces d in N, world, and torques in N m, body
    deviations: (n, 6): s, in the units of `state`
    decay: a; 0 at the first step, which draws from the stationary distribution
    force, torque: (n, 3): external forces and torques
    resting: (n,): 1 for a drone on the floor
    force_sum, torque_sum: (n, 3): result
    """
    share = math.sqrt(1.0 - decay * decay)
    for i in range(state.shape[0]):
        flying = 1.0 - resting[i]
        for c in range(3):
            a, b = draw_normals(keys[i], np.uint64(3 * tick + c))
            state[i, c] = decay * state[i, c] + share * deviations[i, c] * a
            state[i, 3 + c] = decay * state[i, 3 + c] + share * deviations[i, 3 + c] * b
            force_sum[i, c] = force[i, c] + flying * state[i, c]
            torque_sum[i, c] = torque[i, c] + flying * state[i, 3 + c]


class ExternalWrenches:
    """The external wrenches of the drones of a world, as they are given.

    force: (n, 3) N, world: external forces
    torque: (n, 3) N m, body: external torques
    """

    def __init__(self, force: Mat, torque: Mat) -> None:
        self.force = force
        self.torque = torque

    def advance(self, tick: int, resting: Vec) -> None:
        """Do nothing: `force` and `torque` are the arrays that were given."""


class DisturbedWrenches(ExternalWrenches):
    """External wrenches with disturbances, each a function of (seed, tick, id) alone.

    external: the wrenches without disturbances
    ids: the drones, row by row
    platforms: of the drones
    disturbances: how strong and how slow
    seed: of every draw
    dt: s: one step
    """

    def __init__(
        self,
        external: ExternalWrenches,
        ids: Sequence[int],
        platforms: Sequence[Platform],
        disturbances: Disturbances,
        seed: int,
        dt: float,
    ) -> None:
        super().__init__(np.zeros_like(external.force), np.zeros_like(external.torque))
        turn = disturbances.torque
        self._external = external
        self._deviations = np.array(
            [
                [row.mass * disturbances.force] * 3
                + [turn * row.inertia[0], turn * row.inertia[1]]
                + [YAW_SHARE * turn * row.inertia[2]]
                for row in platforms
            ]
        )
        self._decay = math.exp(-dt / disturbances.time)
        self._keys = np.array(
            [
                derive_stream_key(seed, RANDOM_STREAMS.disturbances, drone)
                for drone in ids
            ],
            np.uint64,
        )
        self._state = np.zeros((len(ids), 6))

    def advance(self, tick: int, resting: Vec) -> None:
        """Write the wrenches of a step.

        resting: (n,): 1 for a drone on the floor, which is not disturbed
        """
        _advance(
            self._state,
            self._keys,
            tick,
            self._deviations,
            self._decay if tick > 0 else 0.0,
            self._external.force,
            self._external.torque,
            resting,
            self.force,
            self.torque,
        )
