"""What is looked at before a drone that a radio reaches may take off; arguments in, words out."""

import math

from crazychoir.safety.rules.radio_watch import CRASHED as CRASHED
from crazychoir.safety.rules.radio_watch import LOCKED as LOCKED
from crazychoir.safety.rules.radio_watch import TUMBLED as TUMBLED

CAN_ARM, ARMED, AUTO_ARM, CAN_FLY, FLYING = (1 << k for k in range(5))
DECK_FAULT = 1 << 11
"""Bits of the firmware's supervisor, beside those of one that flies no more."""


def harm(supervisor: int) -> str:
    """What has broken a drone, by its supervisor's bits; empty if nothing has."""
    words = {
        CRASHED: "crashed",
        TUMBLED: "tumbled",
        LOCKED: "locked by its firmware until it is switched off and on",
    }
    return next((text for bit, text in words.items() if supervisor & bit), "")


def supervisor_problems(supervisor: int) -> list[str]:
    """Why its firmware does not let it fly."""
    if text := harm(supervisor):
        return [text]
    if supervisor & DECK_FAULT:
        return ["a deck is faulty"]
    ready = CAN_FLY if supervisor & AUTO_ARM else CAN_FLY | ARMED | CAN_ARM
    if not supervisor & ready:
        return [f"its firmware does not let it fly (supervisor {supervisor:#06x})"]
    return []


def battery_problems(volts: float, begin: float) -> list[str]:
    """Less than its platform needs to begin, in V."""
    if math.isnan(volts):
        return ["says nothing of its battery"]
    return (
        [f"battery at {volts:.2f} V, {begin:g} V are needed to begin"]
        if volts < begin
        else []
    )


LATE, ANSWERED = 0.3, 0.5
"""s, there and back, and share of echoes: a link that is worse flies nobody, though it is never silent."""


def link_problems(latency: float, answered: float) -> list[str]:
    """Whether its link is too slow; NaN for what is not known yet."""
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
"""m2, variance of its own place on each axis, with which a drone takes off that nobody else sees: 0.1 m."""


def spread_problems(variances: list[float]) -> list[str]:
    """Whether a drone that nobody else sees knows where it is."""
    worst = max(variances, key=lambda v: math.inf if math.isnan(v) else v)
    if math.isnan(worst):
        return ["does not say how well it knows where it is"]
    if worst > UNSURE:
        return [
            f"knows its place to {math.sqrt(worst):.2f} m, {math.sqrt(UNSURE):g} m are needed"
        ]
    return []
