"""Two drones exchange their places, head-on, in 20 s.

crazychoir run head_on --fast

Their plans know nothing of each other, and meet at one height: the collision filter leads them past.
"""

from typing import Any

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.agents import goto

Results = dict[int, dict[str, Any]]
ENDS = ((-1.0, 0.1), (1.0, -0.1))
START, ARRIVAL, HEIGHT = 3.0, 23.0, 1.0


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Drone i, to where the other one was."""
    return goto.guidance(i, config)


def swarm(drones: int | None = None) -> SwarmConfig:
    """One at each end, and for each a goal at the other end."""
    goals = {
        str(i): [[START, *ENDS[i], HEIGHT], [ARRIVAL, *ENDS[1 - i], HEIGHT]]
        for i in range(len(ENDS))
    }
    return SwarmConfig.of(
        {
            "name": "exchange",
            "mission": "head_on",
            "mission_options": {"goals": goals},
            "drones": [{"id": i, "home": [*end, 0.0]} for i, end in enumerate(ENDS)],
            "flight": {"takeoff_height": 0.5},
            "fence": {"min": [-2.0, -2.0, 0.0], "max": [2.0, 2.0, 2.5]},
        }
    )


check = goto.check
goal = goto.goal
report = goto.report
picture = goto.picture
