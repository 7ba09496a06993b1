"""A short flight in virtual time, after which a process has loaded and called what a flight needs.

The fork server flies it once. The processes that it forks need not load the laws again, nor find out
the types of their arguments, and they share the memory for it.
"""

from typing import Any, cast

from crazychoir.agent.agent import Agent
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission import Mission
from crazychoir.runtime.clock import Clock, run_virtual

DRONE_COUNT = 2
"""Number of drones: each has a neighbour."""
CRUISING_HEIGHT = 0.5
"""m: height of the flight."""
FLIGHT_LENGTH = 0.2
"""m: length of the flight."""


class ShortFlight(CFGuidance):
    """Takes off, flies a short way and lands."""

    async def mission(self) -> dict[str, Any]:
        """Fly once."""
        x, y, _ = self.member.config.drone(self.id).home
        await self.take_off(CRUISING_HEIGHT)
        await self.go_to((x + FLIGHT_LENGTH, y, CRUISING_HEIGHT))
        await self.land()
        return {}


class ShortFlightMission:
    """The mission in which each drone makes a short flight."""

    def guidance(self, i: int, config: SwarmConfig) -> CFGuidance:
        """Return the guidance of drone i."""
        return ShortFlight()


def fly_once() -> None:
    """Make the flight, with simulated drones of this process."""
    config = default_swarm(DRONE_COUNT)
    mission = cast(Mission, ShortFlightMission())

    async def main(clock: Clock) -> None:
        await Agent(clock, config, mission, config.ids).run()

    run_virtual(main)
