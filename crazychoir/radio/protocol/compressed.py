"""Quaternions in 32 bits, as the firmware packs them."""

import numpy as np

from crazychoir.types import Vec

_BITS, _HALF = 9, 0.5**0.5
_MOST = (1 << _BITS) - 1


def compressed(q: Vec) -> int:
    """q (4,) [x, y, z, w], a unit quaternion: 2 bits for the largest, then sign and 9 bits of each of the others.

    The largest is made positive; the others are at most 1 / sqrt 2 then.
    """
    k = int(np.argmax(np.abs(q)))
    word = k
    turned = q[k] < 0.0
    for i in range(4):
        if i != k:
            magnitude = min(round(_MOST * abs(float(q[i])) / _HALF), _MOST)
            word = word << _BITS + 1 | ((q[i] < 0.0) != turned) << _BITS | magnitude
    return int(word)


def quaternion(word: int) -> Vec:
    """(4,) [x, y, z, w] of 32 bits."""
    q = np.zeros(4)
    k = word >> 30
    for i in (i for i in (3, 2, 1, 0) if i != k):
        magnitude = _HALF * (word & _MOST) / _MOST
        q[i] = -magnitude if word >> _BITS & 1 else magnitude
        word >>= _BITS + 1
    q[k] = np.sqrt(max(0.0, 1.0 - float(q @ q)))
    return q
