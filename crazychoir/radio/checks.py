"""Checks before the take-off of a drone on a radio.

The functions take values and return the problems as text.
"""

import math
from dataclasses import dataclass

from crazychoir.firmware.supervision import SUPERVISOR_BITS


def describe_harm(supervisor: int) -> str:
    """Return what has damaged or locked a drone; empty if nothing has.

    supervisor: bits of its supervisor
    """
    words = {
        SUPERVISOR_BITS.crashed: "crashed",
        SUPERVISOR_BITS.tumbled: "tumbled",
        SUPERVISOR_BITS.locked: "locked by its firmware until it is switched off and on",
    }
    return next((text for bit, text in words.items() if supervisor & bit), "")


def supervisor_problems(supervisor: int) -> list[str]:
    """Return why the firmware does not let the drone fly.

    A supervisor that runs sets at least one bit. It does not run if the self-test has failed, for
    example after a failed assertion.
    """
    if text := describe_harm(supervisor):
        return [text]
    if supervisor == 0:
        return [
            "its firmware does not run: switch it off and on (its self-test failed)"
        ]
    if supervisor & SUPERVISOR_BITS.deck_fault:
        return ["a deck is faulty"]
    ready = (
        SUPERVISOR_BITS.can_fly
        if supervisor & SUPERVISOR_BITS.auto_arm
        else SUPERVISOR_BITS.can_fly | SUPERVISOR_BITS.armed | SUPERVISOR_BITS.can_arm
    )
    if not supervisor & ready:
        return [f"its firmware does not allow flight (supervisor {supervisor:#06x})"]
    return []


def battery_problems(volts: float, begin: float) -> list[str]:
    """Return the problem of a battery below the voltage `begin`, or of an unknown voltage.

    volts: V; NaN if unknown
    begin: V: least voltage at which the platform may take off
    """
    if math.isnan(volts):
        return ["says nothing of its battery"]
    return (
        [f"battery at {volts:.2f} V, {begin:g} V are needed to start"]
        if volts < begin
        else []
    )


@dataclass(frozen=True, slots=True)
class ReadinessLimits:
    """What a link and a drone's own position must satisfy for a flight."""

    longest_round_trip: float = 0.3
    """s: longest round trip of a link for a drone that is to fly."""
    least_answered: float = 0.5
    """Least share of echoes that a link for a drone that is to fly must answer."""
    largest_variance: float = 0.01
    """m2: largest variance of the position, on each axis, for a take-off without cameras. It is a
    standard deviation of 0.1 m.
    """


READINESS_LIMITS = ReadinessLimits()


def link_problems(latency: float, answered: float) -> list[str]:
    """Return why the link is too slow or too lossy to fly, even if it is never silent.

    latency: s: round trip; NaN if unknown
    answered: share of echoes that were answered; NaN if unknown
    """
    found = (
        [
            f"its link takes {latency:.2f} s for a round trip, at most {READINESS_LIMITS.longest_round_trip:g} s may be"
        ]
        if latency > READINESS_LIMITS.longest_round_trip
        else []
    )
    if answered < READINESS_LIMITS.least_answered:
        found.append(
            f"its link answers {100.0 * answered:.0f} of 100 echoes, "
            f"{100.0 * READINESS_LIMITS.least_answered:g} are needed"
        )
    return found


def spread_problems(variances: list[float]) -> list[str]:
    """Return why a drone that only locates itself does not know its position well enough.

    variances: m2, one an axis; NaN if unknown
    """
    worst = max(variances, key=lambda v: math.inf if math.isnan(v) else v)
    if math.isnan(worst):
        return ["does not report the accuracy of its position"]
    if worst > READINESS_LIMITS.largest_variance:
        return [
            f"knows its place to {math.sqrt(worst):.2f} m, "
            f"{math.sqrt(READINESS_LIMITS.largest_variance):g} m are needed"
        ]
    return []
