"""Each drone hovers and obeys its operator, until it is told to land.

The operator is a script, a terminal, or the page:

    crazychoir run operator --drones 3
    crazychoir take-off --height 0.8
    crazychoir go-to 0.5,0,0.2 --relative --drones 0
    crazychoir land
"""

from typing import Any

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.config.swarm_config import default_swarm
from crazychoir.config.tables import Flag, SwarmTable
from crazychoir.guidance.defaults.obeying import obey_operator
from crazychoir.guidance.mission_options import given, require_none

DEFAULT_DRONES = 4
"""Number of drones of the mission's own swarm."""


class OperatorOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    at_once: Flag = False
    """true: take off at the start, without a command."""


Options = OperatorOptions


class Obedient(CFGuidance):
    """Obeys its operator from the take-off to the landing.

    at_once: whether it takes off without a command.
    """

    def __init__(self, at_once: bool) -> None:
        self.at_once = at_once

    async def mission(self) -> dict[str, Any]:
        """Take off, obey, land. The result holds the place where the drone landed."""
        await obey_operator(self, self.at_once)
        return {"place": self.state.p.tolist()}


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return drones on a square grid, which wait for their operator."""
    config = default_swarm(drones or DEFAULT_DRONES)
    return config.replace(
        name="operator", mission="operator", flight={"operator": True}
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check the options."""
    given(config, Options)
    require_none(config)
    return []


def guidance(i: int, config: SwarmConfig) -> Obedient:
    """Return the guidance of drone i."""
    return Obedient(given(config, Options).at_once)
