"""How long a drone flies by prediction, and from when on it counts as unseen."""

SEEN_AGE = 0.1
"""Age in s of a state beyond which it is a prediction; controllers learn nothing from it."""
BLIND_HORIZON = 2.0
"""Seconds that the filter predicts its own motion without a pose.

The safety table lets the drone fly as long without poses.
"""
