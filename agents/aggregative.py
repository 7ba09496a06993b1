"""Surveillance: each defender stays between its intruder and the common target.

The team as a whole stays around the target.

crazychoir run aggregative --fast
crazychoir run deploy/aggregative_moving.toml --fast      three intruders that fly
crazychoir run deploy/aggregative_replayed.toml --fast    the same intruders, from recordings

Each defender knows only its own intruder. The defenders estimate the mean of the team by
aggregative tracking. The drones with role = "intruder" are the intruders, in the order of the
defenders. Without such drones the intruders stand still.
"""

from typing import Any

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.guidance.aggregative import Defender
from crazychoir.guidance.defaults import aggregative as defaults
from crazychoir.guidance.timed import TimedFlight
from crazychoir.team.graph import metropolis


class Observed(CFGuidance):
    """A drone that another program flies, or has flown: it is seen, and does nothing here."""

    def __init__(self, duration: float) -> None:
        self.duration = duration

    async def mission(self) -> dict[str, Any]:
        """Wait until the others are done."""
        await self.rendezvous()
        await self.sleep(self.duration)
        return {}


Options = defaults.DefenceOptions
hooks = defaults.DefenceHooks(Options)
swarm = hooks.swarm
goal = hooks.goal
check = hooks.check
report = hooks.report
picture = hooks.picture


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i: a defender, or an intruder that flies or is observed."""
    drone = config.drone(i)
    if drone.role != defaults.INTRUDER_ROLE:
        return defender(i, config)
    if drone.uri.startswith("replay://"):
        return Observed(hooks.duration(config))
    return TimedFlight(hooks.path(i, config))


def defender(i: int, config: SwarmConfig) -> Defender:
    """Return defender i with its own intruder and the weights of the team's graph."""
    options = hooks.given(config)
    team = defaults.build_defender_graph(config)
    law = Defender(
        team.neighbors(i),
        hooks.defence(config),
        hooks.intruder(i, config),
        metropolis(team)[i],
        options.step_size,
        options.round_rate,
    )
    law.duration = hooks.duration(config)
    return law
