"""Largest numbers of an instance.

Beyond them, the rounding of a sum exceeds the tolerance of the limits.
"""

FARTHEST = 1e5  # m, of a coordinate; m/s, of a speed
MOST = 1e6  # units of load
SLOWEST = 1e-3  # m/s
LATEST = 1e7  # s
