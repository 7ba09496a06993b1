"""Each drone flies straight to its goal: only the collision filter keeps the drones apart.

Its own swarm loses one message in ten, in bursts of four on average. `--loss 0` switches that off.

crazychoir run crossing --fast --drones 6 --picture out/crossing.png
"""

import math
from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.guidance.decision.team import Ids, Team, TeamLaw, step_alone
from crazychoir.guidance.defaults import crossings as defaults
from crazychoir.types import Heard, Reference, State, Vec


class Straight(CFDistributedFeedback):
    """Fly a straight line from a to b, without regard to other drones.

        p_d(t) = a + min(t, T) v,   T = |b - a| / speed,   v = (b - a) / T

    start, goal: (3,) m, world: a and b.
    speed: m/s.
    duration: s: duration of the law.
    """

    def __init__(self, start: Vec, goal: Vec, speed: float, duration: float) -> None:
        self.start = start
        self.goal = goal
        self.duration = duration
        self.flight_time = math.dist(goal, start) / speed
        self.velocity = (goal - start) / self.flight_time
        self.arrived: float | None = None

    def height(self) -> float:
        """Return the height of the start above the ground, in m."""
        return float(self.start[2] - self.member.config.flight.ground)

    @classmethod
    def for_team(cls, laws: Sequence[Self], neighbors: Sequence[Ids]) -> TeamLaw:
        """Return the step of all drones of a process at once."""
        starts, goals = np.array([[law.start, law.goal] for law in laws]).swapaxes(0, 1)
        velocities = np.array([law.velocity for law in laws])
        flight_times = np.array([law.flight_time for law in laws])
        periods = np.array([1.0 / law.rate for law in laws])
        was_there = np.array([law.arrived is not None for law in laws])

        def step(team: Team) -> None:
            t = team.step_numbers * periods
            flown = np.minimum(t, flight_times)[:, None]
            is_on_its_way = (t < flight_times)[:, None]
            team.follow(starts + flown * velocities, is_on_its_way * velocities)
            away = np.linalg.norm(team.states[:, 0:3] - goals, axis=1)
            is_there = away <= defaults.GOAL_DISTANCE
            for r in team.steps[(is_there != was_there)[team.steps]].tolist():
                laws[r].arrived = float(t[r]) if is_there[r] else None
                was_there[r] = is_there[r]

        return step

    def step(self, me: State, heard: Heard) -> Reference | None:
        """Return the point of the straight line that is due now."""
        return step_alone(self, me, heard)

    async def mission(self) -> dict[str, Any]:
        """Take off, cross, land. The result also holds arrived_s.

        It is the time of the law in s from which on the drone stayed at its goal, or None.
        """
        return await super().mission() | {"arrived_s": self.arrived}


Options = defaults.CrossingOptions
hooks = defaults.CrossingHooks(Options)
swarm = hooks.swarm
scatter = hooks.scatter
goal = hooks.goal
check = hooks.check
report = hooks.report
picture = hooks.picture


def guidance(i: int, config: SwarmConfig) -> Straight:
    """Return the law of drone i."""
    options = hooks.given(config)
    starts, goals = hooks.places(config)
    return Straight(starts[i], goals[i], options.speed, options.duration)
