"""Each drone flies to a list of targets, one after the other.

It goes on to the next target when it is within 5 cm of the present one.

crazychoir run targets --fast
crazychoir run targets --fast --drones 3
"""

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.guidance.defaults.targets import TargetHooks, TargetOptions
from crazychoir.guidance.timed import TargetList

Options = TargetOptions
hooks = TargetHooks(Options)
swarm = hooks.swarm
goal = hooks.goal
check = hooks.check
report = hooks.report
picture = hooks.picture


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i: its targets around its home."""
    targets = list(hooks.targets(i, config))
    return TargetList(targets, config.drone(i).home, config.flight)
