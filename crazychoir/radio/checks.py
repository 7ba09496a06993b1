"""What is looked at before a drone that a radio reaches may take off; arguments in, words out."""

import math

from crazychoir.math3d import Vec, wrap, yaw_of
from crazychoir.types import Pose

CAN_ARM, ARMED, AUTO_ARM, CAN_FLY, FLYING, TUMBLED, LOCKED, CRASHED = (1 << k for k in range(8))
DECK_FAULT = 1 << 11
"""Bits of the firmware's supervisor."""
APART, TURNED = 0.05, math.radians(5.0)
"""m, rad: between the drone's own estimate and what the cameras see."""
LOW_BATTERY = 3.7
"""V, of a drone that has not flown yet: less than a quarter is left (level table of the firmware)."""


def harm(supervisor: int) -> str:
    """What has broken a drone, by its supervisor's bits; empty if nothing has."""
    words = {CRASHED: "crashed", TUMBLED: "tumbled", LOCKED: "locked by its firmware until it is started again"}
    return next((text for bit, text in words.items() if supervisor & bit), "")


def supervisor_problems(supervisor: int) -> list[str]:
    """Why its firmware does not let it fly."""
    if text := harm(supervisor):
        return [text]
    if supervisor & DECK_FAULT:
        return ["a deck is faulty"]
    if not supervisor & (CAN_FLY | ARMED | CAN_ARM | AUTO_ARM):
        return [f"its firmware does not let it fly (supervisor {supervisor:#06x})"]
    return []


def battery_problems(volts: float) -> list[str]:
    """Too little to begin with."""
    if math.isnan(volts):
        return ["says nothing of its battery"]
    return [f"battery at {volts:.2f} V, {LOW_BATTERY:g} V are needed to begin"] if volts < LOW_BATTERY else []


def agreement(own: tuple[Vec, Vec], seen: Pose) -> list[str]:
    """Whether the drone takes itself to be where the cameras see it.

    own: p (3,) m, q (4,), world, of its estimator.
    """
    p, q = own
    apart = float(math.dist(p.tolist(), seen.p.tolist()))
    found = []
    if not apart <= APART:
        found.append(f"its estimate is {apart:.2f} m from where the cameras see it, {APART:g} m are allowed")
    turned = abs(wrap(yaw_of(q) - yaw_of(seen.q)))
    tilted = _between_verticals(q, seen.q)
    if not turned <= TURNED:
        allowed = f"{math.degrees(TURNED):g} degrees are allowed: is its body turned, or another drone's?"
        found.append(f"its heading is {math.degrees(turned):.0f} degrees from its body's, {allowed}")
    if not tilted <= TURNED:
        found.append(f"it is tilted {math.degrees(tilted):.0f} degrees against its body, 5 are allowed: calibrate it")
    return found


def _between_verticals(q: Vec, other: Vec) -> float:
    """rad, between the z axes of two attitudes."""
    a, b = _vertical(q), _vertical(other)
    return math.acos(min(1.0, max(-1.0, sum(x * y for x, y in zip(a, b, strict=True)))))


def _vertical(q: Vec) -> tuple[float, float, float]:
    x, y, z, w = q.tolist()
    return 2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)


UNSURE = 0.01
"""m2, variance of its own place on each axis, with which a drone takes off that nobody else sees: 0.1 m."""


def spread_problems(variances: list[float]) -> list[str]:
    """Whether a drone that nobody else sees knows where it is."""
    worst = max(variances, key=lambda v: math.inf if math.isnan(v) else v)
    if math.isnan(worst):
        return ["does not say how well it knows where it is"]
    if worst > UNSURE:
        return [f"knows its place to {math.sqrt(worst):.2f} m, {math.sqrt(UNSURE):g} m are needed"]
    return []
