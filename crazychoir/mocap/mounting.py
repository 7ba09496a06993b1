"""The mounting of a tracked body on its drone."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crazychoir.numerics.kernels import kernel, vector
from crazychoir.numerics.math3d import (
    normalize_quaternion,
    quaternion_conjugate,
    quaternion_product,
    rotation_exponential,
)
from crazychoir.types import Vec


@kernel(vector, vector, vector)
def _drone_pose(seen: Vec, offset: Vec, turn: Vec) -> Vec:
    """Return the drone's pose (7,) from the body's pose: see Mounting.

    seen: (7,): pose of the body
    offset: (3,) m: o
    turn: (4,): q_m
    """
    out = np.empty(7)
    body = normalize_quaternion((seen[3], seen[4], seen[5], seen[6]))
    q = quaternion_product(
        body, quaternion_conjugate((turn[0], turn[1], turn[2], turn[3]))
    )
    way = quaternion_product(
        quaternion_product(q, (offset[0], offset[1], offset[2], 0.0)),
        quaternion_conjugate(q),
    )
    for c in range(3):
        out[c] = seen[c] - way[c]
    out[3], out[4], out[5], out[6] = q
    return out


def quaternion_of_rpy(rpy: Sequence[float]) -> Vec:
    """Return the unit quaternion (4,) of R = Rz(yaw) Ry(pitch) Rx(roll).

    rpy: rad: roll, pitch, yaw
    """
    roll, pitch, yaw = rpy
    level = quaternion_product(
        rotation_exponential(0.0, pitch, 0.0), rotation_exponential(roll, 0.0, 0.0)
    )
    return np.array(quaternion_product(rotation_exponential(0.0, 0.0, yaw), level))


@dataclass(frozen=True)
class Mounting:
    """The position and rotation of the tracked body on its drone.

        q_b = q q_t q_m,   p_b = p + R(q) o,   so   q = q_b (q_t q_m)^-1,   p = p_b - R(q) o

    p, q are the pose of the drone; p_b, q_b are the pose of the body, as tracked.
    """

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(3,) m, drone's axes: o, from the drone's centre to the tracked centre."""
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """rad: roll, pitch, yaw of R(q_m) = Rz Ry Rx, from the body's axes to the drone's.

    It is (0, 0, yaw) for a body that was defined while the drone looked along -yaw.
    """

    trim: tuple[float, float] = (0.0, 0.0)
    """rad: roll, pitch of R(q_t) = Ry Rx, from the thrust axis of the drone to the level of q_m."""

    @property
    def is_none(self) -> bool:
        """Whether body and drone have the same pose."""
        return not any((*self.offset, *self.rotation, *self.trim))

    @cached_property
    def _arrays(self) -> tuple[Vec, Vec]:
        trim = quaternion_of_rpy((*self.trim, 0.0))
        mounted = quaternion_of_rpy(self.rotation)
        turn = quaternion_product(
            (trim[0], trim[1], trim[2], trim[3]),
            (mounted[0], mounted[1], mounted[2], mounted[3]),
        )
        return np.array(self.offset), np.array(turn)

    def drone(self, seen: Vec) -> Vec:
        """Return the drone's pose (7,) if its body has the pose seen (7,)."""
        return seen if self.is_none else _drone_pose(seen, *self._arrays)

    def body(self, drone: Vec) -> Vec:
        """Return the body's pose (7,) if the drone has the pose drone (7,)."""
        if self.is_none:
            return drone
        o, turn = self._arrays
        q = tuple(drone[3:7])
        way = quaternion_product(
            quaternion_product(q, (*o, 0.0)), quaternion_conjugate(q)
        )
        return np.array(
            [*(drone[0:3] + np.array(way[0:3])), *quaternion_product(q, tuple(turn))]
        )


CENTRED_BODY = Mounting()
"""A body with the pose of its drone."""
