"""The safety table in safety/README.md, from safety/rules/guard.py."""

from crazychoir.safety.rules.guard import (
    ON_BOARD_SAFETY_TABLE,
    RADIO_SAFETY_TABLE,
    REPORTED_MEASURES,
    SAFETY_TABLE,
    Action,
    SafetyRule,
)
from reference.markdown import table as markdown_table

MEASURED = {
    "pose": "age of the last pose, s",
    "reference": "age of the last reference, of a drone that follows references, s",
    "stop": "distance outside the fence, now or where the drone would come to rest, m",
    "fence": "distance outside the fence, m",
    "limit area": "distance outside the limit area, in the keep-out zone, m",
    "link": "silence of its radio, s",
    "battery": "time below the low battery voltage of its platform, s",
    "empty": "voltage below the critical battery voltage of its platform, V",
    "gone": "distance outside the limit area of a body that is not believed to be its own, m",
}
"""What a measure is, with its unit."""
FOUND = {
    "broken": ("its state is not finite",),
    "tumbled": ("its firmware reports tumbled, crashed or locked",),
    "body": ("its body does not rise when it takes off",),
    "astray": (
        "its body does not move as the drone does",
        "its body does not move as the drone does, and the drone may not land either",
    ),
}
"""Measures that are levels, and what each level means."""
ACTIONS = {Action.BRAKE: "brakes", Action.LAND: "lands", Action.CUT: "cuts the motors"}
"""What the drone does."""
SIMULATED = tuple(
    rule for rule in SAFETY_TABLE if rule.measure not in REPORTED_MEASURES
)
"""Rules of a simulated drone, which has no radio that reports."""
DRONES = {
    (True, True, True): "all",
    (True, False, False): "simulated",
    (False, True, True): "with a radio",
    (False, True, False): 'with a radio, sender not `"xyz"`',
}
"""Drones that a rule is for: whether SIMULATED, REACHED and PLANS_ON_BOARD have it."""


def table() -> str:
    """Return a row for each rule: measure, limit, action, end, and for which drones."""
    rules = sorted(
        dict.fromkeys(SIMULATED + RADIO_SAFETY_TABLE + ON_BOARD_SAFETY_TABLE),
        key=lambda rule: ([*MEASURED, *FOUND].index(rule.measure), rule.limit),
    )
    head = ("measure", "limit", "the drone", "until", "drones")
    return markdown_table(head, map(_row, rules))


def _row(rule: SafetyRule) -> list[str]:
    if rule.measure in FOUND:
        what, limit = FOUND[rule.measure][int(rule.limit)], ""
    else:
        what, limit = MEASURED[rule.measure], f"{rule.limit:.2f}"
    settled = f"{rule.settle:g} s at {rule.clear:g} or less"
    return [
        what,
        limit,
        ACTIONS[rule.action],
        "for good" if rule.latched else settled,
        DRONES[
            (
                rule in SIMULATED,
                rule in RADIO_SAFETY_TABLE,
                rule in ON_BOARD_SAFETY_TABLE,
            )
        ],
    ]
