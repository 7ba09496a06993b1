"""Unit quaternions in 32 bits, in the firmware's format."""

from dataclasses import dataclass

import numpy as np

from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class _QuaternionFormat:
    """The firmware's format of a component of a compressed quaternion."""

    bits: int = 9
    """Bits of the magnitude of a component."""
    largest: float = 0.5**0.5
    """Largest magnitude of the components that are sent: 1 / sqrt 2."""
    largest_integer: int = (1 << bits) - 1
    """Largest magnitude as an integer."""


_QUATERNION_FORMAT = _QuaternionFormat()


def pack_quaternion(q: Vec) -> int:
    """Return the 32 bits of a unit quaternion: 2 bits name the largest component.

    Each other has a sign and 9 bits. The sign of q is chosen such that the largest component is
    positive; the others are then at most 1 / sqrt 2.

    q: (4,) [x, y, z, w]
    """
    k = int(np.argmax(np.abs(q)))
    word = k
    turned = q[k] < 0.0
    for i in range(4):
        if i != k:
            magnitude = min(
                round(
                    _QUATERNION_FORMAT.largest_integer
                    * abs(float(q[i]))
                    / _QUATERNION_FORMAT.largest
                ),
                _QUATERNION_FORMAT.largest_integer,
            )
            word = (
                word << _QUATERNION_FORMAT.bits + 1
                | ((q[i] < 0.0) != turned) << _QUATERNION_FORMAT.bits
                | magnitude
            )
    return int(word)


def unpack_quaternion(word: int) -> Vec:
    """Return the unit quaternion (4,) [x, y, z, w] of 32 bits."""
    q = np.zeros(4)
    k = word >> 30
    for i in (i for i in (3, 2, 1, 0) if i != k):
        magnitude = (
            _QUATERNION_FORMAT.largest
            * (word & _QUATERNION_FORMAT.largest_integer)
            / _QUATERNION_FORMAT.largest_integer
        )
        q[i] = -magnitude if word >> _QUATERNION_FORMAT.bits & 1 else magnitude
        word >>= _QUATERNION_FORMAT.bits + 1
    q[k] = np.sqrt(max(0.0, 1.0 - float(q @ q)))
    return q
