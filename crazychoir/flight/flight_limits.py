"""Limits of a flight: how long a drone flies unseen, and when it counts as landed."""

from typing import NamedTuple

SEEN_AGE = 0.1
"""Age in s of a state beyond which it is a prediction; controllers learn nothing from it."""
BLIND_HORIZON = 2.0
"""Seconds that the filter predicts its own motion without a pose.

The safety table lets the drone fly as long without poses.
"""


class TouchdownLimits(NamedTuple):
    """When a landing drone counts as landed."""

    floor_height: float = 0.04
    """Height in m above the ground at which a landing drone stops its motors."""
    overdue_time: float = 2.0
    """Seconds after the planned touch-down when a drone slower than rest_speed counts as landed."""
    unseen_overdue_time: float = 0.5
    """Seconds after the planned touch-down when an unseen drone at rest counts as landed."""
    kept_up_height: float = 0.15
    """Height in m above the ground below which a landing drone that others keep up stops its motors
    after kept_up_time. It falls no deeper.
    """
    kept_up_time: float = 10.0
    """Seconds that a landing drone stays so low before it counts as landed."""
    kept_up_speed: float = 0.3
    """Largest speed in m/s at which the motors of such a drone stop."""
    rest_speed: float = 0.05
    """m/s below which a drone is at rest."""
    replay_overdue_time: float = 5.0
    """s after the planned touch-down when the landing of a replayed drone is over, wherever its
    body is.
    """
    replanning_distance: float = 0.05
    """Distance in m from a drone to its landing plan at which the plan begins anew.

    While commands may be lost, each command that arrives asks for no more than this.
    """
    airborne_height: float = 0.2
    """Height in m above the ground at which a seen drone has not landed, whatever its plan says.
    """


TOUCHDOWN_LIMITS = TouchdownLimits()
