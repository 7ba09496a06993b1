"""References that a pilot is asked to follow: which of them it can fly, and where they will be."""

import math
from typing import get_args

import numpy as np

from crazychoir.types import FullState, Goto, Reference, Velocity


def flyable(reference: object) -> bool:
    """Whether it is of the right shape, and all its numbers are numbers: their sum is one; not for an Acceleration."""
    match reference:
        case Velocity():
            return np.shape(reference.v) == (3,) and math.isfinite(float(np.sum(reference.v)) + reference.yaw)
        case FullState():
            flat = reference.flat
            fits = flat.shape == (14,) and flat.dtype == np.float64 and flat.flags.c_contiguous
            return fits and math.isfinite(sum(flat.tolist()))
        case Goto():
            return np.shape(reference.p) == (3,) and math.isfinite(
                float(np.sum(reference.p)) + reference.yaw + reference.duration
            )
        case _:
            return False


def ahead(reference: FullState, later: float) -> FullState:
    """Where a reference will be `later` s from now if it goes on as it does."""
    p, v, a = reference.p, reference.v, reference.a
    return FullState.at(p + later * v + 0.5 * later**2 * a, v + later * a, a, yaw=reference.yaw)


def unflyable(reference: object) -> str:
    """What one is that is not flyable."""
    if isinstance(reference, Reference):
        return "no finite reference of its shape"
    return f"none of {', '.join(kind.__name__ for kind in get_args(Reference))}"
