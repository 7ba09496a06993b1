"""Each drone flies straight to its goal: only the collision filter keeps the drones apart.

Its own swarm loses one message in ten, in bursts of four on average. `--loss 0` switches that off.

crazychoir run crossing --fast --drones 6 --picture out/crossing.png
"""

import math
from typing import Any

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.guidance.defaults import crossings as defaults
from crazychoir.types import FullState, Heard, State, Vec


class Straight(CFDistributedFeedback):
    """Fly a straight line from a to b, without regard to other drones.

        p_d(t) = a + min(speed t, |b - a|) w,   w = (b - a) / |b - a|

    start: (3,) m, world: a.
    goal: (3,) m, world: b.
    speed: m/s.
    duration: s: duration of the law.
    """

    def __init__(self, start: Vec, goal: Vec, speed: float, duration: float) -> None:
        self.start = start
        self.goal = goal
        self.speed = speed
        self.duration = duration
        self.far = math.dist(goal, start)
        self.way = (goal - start) / self.far
        self.steps = 0
        self.arrived: float | None = None

    def height(self) -> float:
        """Return the height of the start above the ground, in m."""
        return float(self.start[2] - self.member.config.flight.ground)

    def step(self, me: State, heard: Heard) -> FullState:
        """Return the point of the straight line that is due now."""
        t = self.steps / self.rate
        self.steps += 1
        if math.dist(me.p, self.goal) > defaults.GOAL_DISTANCE:
            self.arrived = None
        elif self.arrived is None:
            self.arrived = t
        gone = self.speed * t
        on_its_way = gone < self.far
        return FullState.at(
            self.start + min(gone, self.far) * self.way,
            on_its_way * self.speed * self.way,
        )

    async def mission(self) -> dict[str, Any]:
        """Take off, cross, land.

        The result also holds arrived_s: s of the law after which the drone stayed at its goal,
        None: never.
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
