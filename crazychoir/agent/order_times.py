"""Times of flight commands that operators and drones share; this module imports nothing."""

ORDER_TIMEOUTS = {
    "arm": 5.0,
    "take-off": 30.0,
    "start": 5.0,
    "hold": 5.0,
    "go": 5.0,
    "land": 60.0,
    "home": 120.0,
    "go-to": 120.0,
    "velocity": 10.0,
    "fly": 60.0,
}
"""Seconds to wait until a command is done, beside the duration that was asked for.

A flight along a trajectory gets this time to reach the start, beside the duration of the trajectory.
"""
LOAD_TIMEOUT = 40.0
"""Seconds to wait until trajectories are in the memories of the drones of a dongle."""
LONGEST_VELOCITY = 10.0
"""s: longest `duration` of a velocity. A drone flies no longer for a script that has ended."""
