"""Simulated motion capture: it turns true states into noisy and late poses with gaps."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import MocapTable
from crazychoir.numerics.kernels import kernel, matrix, table
from crazychoir.numerics.math3d import (
    quaternion_product,
    rotation_exponential,
)
from crazychoir.types import CameraFrame, Mat

TILT_TICK = (1 << 64) - 1
"""Tick of the draws that are the tilts of the tracked bodies; no exposure has it."""


@kernel(matrix, matrix, matrix, matrix, table)
def _disturb(x: Mat, normal: Mat, noises: Mat, tilts: Mat, out: Mat) -> None:
    """Write the measured poses: p + n_p, q q_tilt exp(n_angle).

    x: (N, 13): states
    normal: (N, 6): standard normals for the noise n
    noises: (N, 2) m, rad: standard deviations of n_p and n_angle, per axis
    tilts: (N, 4): q_tilt of each drone
    out: (N, 7): poses
    """
    for i in range(x.shape[0]):
        q = quaternion_product(
            (x[i, 6], x[i, 7], x[i, 8], x[i, 9]),
            (tilts[i, 0], tilts[i, 1], tilts[i, 2], tilts[i, 3]),
        )
        a = noises[i, 1]
        r = rotation_exponential(a * normal[i, 3], a * normal[i, 4], a * normal[i, 5])
        out[i, 3], out[i, 4], out[i, 5], out[i, 6] = quaternion_product(q, r)
        for c in range(3):
            out[i, c] = x[i, c] + noises[i, 0] * normal[i, c]


@dataclass(frozen=True, slots=True)
class CameraErrors:
    """Errors with which the cameras measure the poses of the drones."""

    noise_p: float = 0.0001
    """m, standard deviation of n_p per axis."""
    noise_angle: float = 0.00175
    """rad, standard deviation of n_angle per axis."""
    dropout: float = 0.0
    """Probability that a drone is not seen in a tick."""
    latency_steps: int = 0
    """Ticks between exposure and arrival."""
    tilt: tuple[float, float] = (0.0, 0.0)
    """rad, (roll, pitch) of the tracked body against the drone."""
    tilt_spread: float = 0.0
    """rad, standard deviation of further tilts that differ from drone to drone."""

    @classmethod
    def of(cls, mocap: MocapTable) -> Self:
        """Return the errors in the table [mocap] of a swarm file."""
        return cls(
            mocap.noise,
            mocap.noise_angle,
            mocap.dropout,
            round(mocap.latency * mocap.rate),
            mocap.tilt,
            mocap.tilt_spread,
        )


STANDARD_CAMERAS = CameraErrors()


class SimulatedMocap:
    """Cameras that see every drone once a tick, with noise, latency and independent dropouts.

        p_measured = p + n_p,   q_measured = q q_tilt exp(n_angle)

    The draws for a drone depend only on (seed, tick of exposure, id): Philox with this key, row
    `id`. So they do not depend on earlier calls, nor on the distribution of drones over processes.

    ids: the drones, row by row
    seed: seed of all draws
    errors: noise, dropouts, latency and tilt
    dt: s: one tick of the cameras
    """

    def __init__(
        self,
        ids: Sequence[int],
        seed: int,
        errors: CameraErrors = STANDARD_CAMERAS,
        dt: float = 0.01,
    ) -> None:
        self.ids = tuple(ids)
        self.seed = seed
        self.dt = dt
        self.errors = errors
        self._rows = np.array(self.ids)
        self._drawn_rows = int(self._rows.max()) + 1
        self._dropout_threshold = _find_dropout_threshold(errors.dropout)
        self._bits = np.random.Philox(key=np.array([seed % (1 << 64), 0], np.uint64))
        self._stream = np.random.Generator(self._bits)
        self._beginning = self._bits.state
        self._key = self._beginning["state"]["key"]
        self._tilts = self._draw_tilts()
        self.noises = np.tile([errors.noise_p, errors.noise_angle], (len(self.ids), 1))
        """(N, 2) m, rad: deviations of n_p and n_angle of each drone."""
        self._exposures: deque[tuple[int, Mat]] = deque()

    @classmethod
    def of(cls, config: SwarmConfig, ids: Sequence[int]) -> Self:
        """Return the cameras of a swarm file, with the noise of calibrated drones."""
        mocap = config.mocap
        cameras = cls(ids, config.seed, CameraErrors.of(mocap), 1.0 / mocap.rate)
        for row, i in enumerate(cameras.ids):
            found = config.drone(i).calibration.noise
            if found is not None:
                cameras.noises[row] = found[:2]
        return cameras

    def sample(self, x: Mat, k: int) -> CameraFrame | None:
        """Return the frame that arrives at tick k of the cameras; None if none arrives.

        x: (N, 13): true states at tick k
        """
        latest = k - self.errors.latency_steps
        self._exposures.append((k, x.copy()))
        due = None
        while self._exposures and self._exposures[0][0] <= latest:
            due = self._exposures.popleft()
        if due is None:
            return None
        exposed, truth = due
        normal = self._normal(exposed)
        flat = np.empty((len(self.ids), 7))
        _disturb(truth, normal, self.noises, self._tilts, flat)
        return CameraFrame(
            flat, (k - exposed) * self.dt, normal[:, 6] >= self._dropout_threshold
        )

    def _draw_tilts(self) -> Mat:
        """Return q_tilt (N, 4) of each drone: R(q_tilt) = Ry(pitch) Rx(roll)."""
        drawn = self._draw(TILT_TICK, 2)
        roll, pitch = (self.errors.tilt + self.errors.tilt_spread * drawn).T
        return np.array(
            [
                quaternion_product(
                    rotation_exponential(0.0, about_y, 0.0),
                    rotation_exponential(about_x, 0.0, 0.0),
                )
                for about_x, about_y in zip(roll, pitch, strict=True)
            ]
        )

    def _normal(self, tick: int) -> Mat:
        """Return standard normals (N, 7) of one exposure: six for noise, one for dropout."""
        return self._draw(tick, 7)

    def _draw(self, tick: int, count: int) -> Mat:
        """Return standard normals (N, count) of a tick."""
        # A new generator a tick would draw a seed from the system first, which takes longer.
        self._key[1] = tick
        self._bits.state = self._beginning
        drawn: Mat = self._stream.standard_normal((self._drawn_rows, count))
        mine: Mat = drawn.take(self._rows, axis=0)
        return mine


def _find_dropout_threshold(dropout: float) -> float:
    """Return the standard normal below which a camera loses a body with this probability."""
    if dropout == 0.0:
        return -math.inf
    from scipy.special import ndtri  # its import takes 0.1 s

    return float(ndtri(dropout))
