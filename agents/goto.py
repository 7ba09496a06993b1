"""Timed goals: each drone must be at its goals at given times.

By default four drones cross a square along its diagonals, at the same height and the same time. The
collision filter guides them around each other.

crazychoir run goto --fast --picture out/goto.png
"""

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.guidance.defaults.goals import GoalHooks, GoalOptions, Row
from crazychoir.guidance.timed import TimedFlight

SQUARE_CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
"""(2,) m each: corners of the square."""
CORNER_TIMES = (5.0, 25.0, 45.0)
"""s of the law at which a drone is at its own corner, at the opposite one, and at the next."""
CROSSING_HEIGHT = 1.0
"""m: height of the crossing."""
START_SCALE = 0.8
"""Scale from the corners to the places where the drones start."""


def crossing(k: int) -> tuple[Row, ...]:
    """Return the goals of the k-th drone: its own corner, the opposite one, and the next."""
    corners = [SQUARE_CORNERS[(k + turn) % len(SQUARE_CORNERS)] for turn in (0, 2, 3)]
    return tuple(
        (t, *corner, CROSSING_HEIGHT)
        for t, corner in zip(CORNER_TIMES, corners, strict=True)
    )


Options = GoalOptions
hooks = GoalHooks(Options, [crossing(k) for k in range(len(SQUARE_CORNERS))])
goal = hooks.goal
check = hooks.check
report = hooks.report
picture = hooks.picture


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return four drones, each slightly inside its corner."""
    return SwarmConfig.of(
        {
            "name": "crossing",
            "mission": "goto",
            "drones": [
                {"id": i, "home": [START_SCALE * x, START_SCALE * y, 0.0]}
                for i, (x, y) in enumerate(SQUARE_CORNERS)
            ],
            "flight": {"takeoff_height": 0.5},
            "fence": {"min": [-2.0, -2.0, 0.0], "max": [2.0, 2.0, 2.5]},
        }
    )


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i: a flight to its goals."""
    return TimedFlight(hooks.flight(i, config), hooks.times(i, config))
