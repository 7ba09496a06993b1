"""Two drones exchange their places, head-on, in 20 s.

crazychoir run head_on --fast

Their plans are independent and meet at one height. The collision filter guides them past each
other.
"""

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.agents import goto

FLIGHT_ENDS = ((-1.0, 0.1), (1.0, -0.1))
"""(2,) m each: the two places."""
START_TIME = 3.0
"""s of the law at which each drone is at its own place."""
ARRIVAL_TIME = 23.0
"""s of the law at which each drone is at the other place."""
FLIGHT_HEIGHT = 1.0
"""m: height of the flight."""


Options = goto.Options
goal = goto.goal
check = goto.check
report = goto.report
picture = goto.picture


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return two drones, one at each end, each with a goal at the other end."""
    goals = {
        str(i): [
            [START_TIME, *FLIGHT_ENDS[i], FLIGHT_HEIGHT],
            [ARRIVAL_TIME, *FLIGHT_ENDS[1 - i], FLIGHT_HEIGHT],
        ]
        for i in range(len(FLIGHT_ENDS))
    }
    return SwarmConfig.of(
        {
            "name": "exchange",
            "mission": "head_on",
            "mission_options": {"goals": goals},
            "drones": [
                {"id": i, "home": [*end, 0.0]} for i, end in enumerate(FLIGHT_ENDS)
            ],
            "flight": {"takeoff_height": 0.5},
            "fence": {"min": [-2.0, -2.0, 0.0], "max": [2.0, 2.0, 2.5]},
        }
    )


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i: it flies to the start of the other drone."""
    return goto.guidance(i, config)
