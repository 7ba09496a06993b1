"""Checks before the take-off of a drone on a radio.

The functions take values and return the problems as text.
"""

import math

from crazychoir.safety.rules.radio_watch import CRASHED as CRASHED
from crazychoir.safety.rules.radio_watch import LOCKED as LOCKED
from crazychoir.safety.rules.radio_watch import TUMBLED as TUMBLED

# Bits of the firmware's supervisor; radio_watch.py has those of a drone that can no longer fly.
CAN_ARM, ARMED, AUTO_ARM, CAN_FLY, FLYING = (1 << k for k in range(5))
"""Bits 0 to 4: the drone may be armed, is armed, arms itself, may fly, flies."""
DECK_FAULT = 1 << 11
"""Bit: a deck is faulty."""


def harm(supervisor: int) -> str:
    """Return what has damaged or locked a drone; empty if nothing has.

    supervisor: bits of its supervisor
    """
    words = {
        CRASHED: "crashed",
        TUMBLED: "tumbled",
        LOCKED: "locked by its firmware until it is switched off and on",
    }
    return next((text for bit, text in words.items() if supervisor & bit), "")


def supervisor_problems(supervisor: int) -> list[str]:
    """Return why the firmware does not let the drone fly."""
    if text := harm(supervisor):
        return [text]
    if supervisor & DECK_FAULT:
        return ["a deck is faulty"]
    ready = CAN_FLY if supervisor & AUTO_ARM else CAN_FLY | ARMED | CAN_ARM
    if not supervisor & ready:
        return [f"its firmware does not let it fly (supervisor {supervisor:#06x})"]
    return []


def battery_problems(volts: float, begin: float) -> list[str]:
    """Return the problem of a battery below the voltage `begin`, or of an unknown voltage.

    volts: V; NaN if unknown
    begin: V: least voltage at which the platform may take off
    """
    if math.isnan(volts):
        return ["says nothing of its battery"]
    return (
        [f"battery at {volts:.2f} V, {begin:g} V are needed to begin"]
        if volts < begin
        else []
    )


LATE = 0.3
"""Seconds: longest round trip of a link for a drone that is to fly."""
ANSWERED = 0.5
"""Least share of echoes that a link for a drone that is to fly must answer."""


def link_problems(latency: float, answered: float) -> list[str]:
    """Return why the link is too slow or too lossy to fly, even if it is never silent.

    latency: s: round trip; NaN if unknown
    answered: share of echoes that were answered; NaN if unknown
    """
    found = (
        [f"its link takes {latency:.2f} s there and back, at most {LATE:g} s may be"]
        if latency > LATE
        else []
    )
    if answered < ANSWERED:
        found.append(
            f"its link answers {100.0 * answered:.0f} of 100 echoes, {100.0 * ANSWERED:g} are needed"
        )
    return found


UNSURE = 0.01
"""m2: largest variance of the position, on each axis, for a take-off without cameras.

It is a standard deviation of 0.1 m.
"""


def spread_problems(variances: list[float]) -> list[str]:
    """Return why a drone that only locates itself does not know its position well enough.

    variances: m2, one an axis; NaN if unknown
    """
    worst = max(variances, key=lambda v: math.inf if math.isnan(v) else v)
    if math.isnan(worst):
        return ["does not say how well it knows where it is"]
    if worst > UNSURE:
        return [
            f"knows its place to {math.sqrt(worst):.2f} m, {math.sqrt(UNSURE):g} m are needed"
        ]
    return []
