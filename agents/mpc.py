"""A line of drones moves by model predictive control: no drone gets ahead of its neighbours.

crazychoir run mpc --fast
crazychoir run mpc --fast --loss 0.3

The control is distributed. Each drone has a goal. The distances that two neighbours still have to
go differ by at most `reach`, so the formation waits for its slowest drone. In each step the drones
plan one after another, by increasing id.
"""

import numpy as np

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.config.drone_room import room_of
from crazychoir.guidance.defaults import mpc as defaults
from crazychoir.guidance.mpc import MPCGuidance

Options = defaults.MPCOptions
DroneOptions = defaults.MPCDroneOptions
hooks = defaults.MPCHooks(Options, DroneOptions)
swarm = hooks.swarm
goal = hooks.goal
check = hooks.check
report = hooks.report
picture = hooks.picture


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the law of drone i: from its home to its goal, inside the fence."""
    drone = config.drone(i)
    place = hooks.goal_of(config, drone)
    low, high = np.array(room_of(config, i))[:, 0:2] - place
    law = MPCGuidance(
        place,
        hooks.motion(config, drone),
        low,
        high,
        hooks.planned_reach(config),
        config.graph().neighbors(i),
    )
    law.duration = hooks.given(config).duration
    return law
