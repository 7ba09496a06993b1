"""References that a pilot is to follow: whether it can fly them, and where they will be."""

import math
from collections.abc import Callable
from typing import TypeVar, get_args

import numpy as np

from crazychoir.numerics.array_like import describe_value, to_floats
from crazychoir.types import Acceleration, FullState, Goto, Reference, Vec, Velocity

Directed = TypeVar("Directed", Acceleration, Velocity)


def convert_reference(reference: object) -> Reference | None:
    """Return the reference with plain numbers and the float64 arrays that kernels take.

    A reference with these already is returned itself.
    Returns None for an object that is no reference, or has numbers that are not finite.
    """
    match reference:
        case Acceleration():
            return _convert_directed(reference, reference.a, Acceleration)
        case Velocity():
            return _convert_directed(reference, reference.v, Velocity)
        case FullState():
            flat = to_floats(reference.flat, (14,))
            if flat is None or not math.isfinite(sum(flat.tolist())):
                return None
            return reference if flat is reference.flat else FullState(flat)
        case Goto():
            p = to_floats(reference.p, (3,))
            yaw = _to_number(reference.yaw)
            duration = _to_number(reference.duration)
            if p is None or not math.isfinite(sum(p.tolist()) + yaw + duration):
                return None
            return Goto(p, yaw, duration)
        case _:
            return None


def _convert_directed(
    reference: Directed, direction: object, kind: Callable[[Vec, float], Directed]
) -> Directed | None:
    """Return an Acceleration or a Velocity as `convert_reference` does.

    reference: an Acceleration or a Velocity
    direction: its (3,) vector
    kind: its class
    """
    vector = to_floats(direction, (3,))
    if vector is None:
        return None
    yaw = _to_number(reference.yaw)
    x, y, z = vector.tolist()
    if not math.isfinite(x + y + z + yaw):
        return None
    return (
        reference if vector is direction and yaw is reference.yaw else kind(vector, yaw)
    )


def _to_number(value: object) -> float:
    """Return the value as a float, NaN if it is no number."""
    if type(value) is float:
        return value
    found = to_floats(value, ())
    return math.nan if found is None else float(found)


def extrapolate_reference(reference: FullState, later: float) -> FullState:
    """Return where a reference will be `later` s from now if its acceleration stays constant."""
    p = reference.p
    v = reference.v
    a = reference.a
    return FullState.at(
        p + later * v + 0.5 * later**2 * a, v + later * a, a, yaw=reference.yaw
    )


def explain_refusal(reference: object) -> str:
    """Return why `convert_reference` returns None: what was found, and what is allowed."""
    match reference:
        case Acceleration():
            parts = {"a": (reference.a, (3,)), "yaw": (reference.yaw, ())}
        case Velocity():
            parts = {"v": (reference.v, (3,)), "yaw": (reference.yaw, ())}
        case FullState():
            parts = {"flat": (reference.flat, (14,))}
        case Goto():
            parts = {
                "p": (reference.p, (3,)),
                "yaw": (reference.yaw, ()),
                "duration": (reference.duration, ()),
            }
        case _:
            kinds = ", ".join(f"{kind.__name__}(...)" for kind in get_args(Reference))
            return f"found {describe_value(reference)}; allowed: {kinds} or None"
    for name, (value, shape) in parts.items():
        found = to_floats(value, shape)
        if found is None or not np.isfinite(found).all():
            wanted = (
                f"{shape[0]} finite numbers of shape {shape}"
                if shape
                else "a finite number"
            )
            return f"{type(reference).__name__}.{name}: found {describe_value(value)}; allowed: {wanted}"
    return ""
