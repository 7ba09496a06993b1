"""A flight in virtual time that is measured while all drones fly the law of their mission."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from crazychoir.agent.agent import Agent
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.guidance.mission import Mission
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.runtime.user_code_guard import HangWatch
from crazychoir.safety.rules.modes import Mode

T = TypeVar("T")
SETTLING_TIME = 0.5  # s of the law before the measurement begins
CHECK_INTERVAL = 0.1  # s between two looks at the modes of the drones

Say = Callable[[str], None]
"""Takes a text that says what is being done."""
Measure = Callable[[Agent], Awaitable[T]]
"""Measures a flight; its awaits let virtual time pass."""


def fly_steadily(
    config: SwarmConfig,
    mission: Mission,
    measure: Measure[T],
    say: Say = lambda text: None,
) -> T:
    """Fly a swarm in virtual time until its law has settled, measure, and end the flight in the air.

    config: the swarm
    mission: its mission
    measure: called with the agent of all drones, SETTLING_TIME s after all drones but the leaders
        began to fly the law
    say: called with a text that says how far the flight is
    Returns the result of `measure`.
    Raises Refused if the flight ends before, or if a drone does not fly the law any more afterwards.
    """

    async def main(clock: Clock) -> T:
        say("building the drones")
        agent = Agent(clock, config, mission, config.ids)
        with HangWatch() as agent.watchdog:
            flight = asyncio.create_task(agent.run(), name="flight")
            measuring = asyncio.create_task(
                measure_law(agent, measure, say), name="measuring"
            )
            await asyncio.wait({flight, measuring}, return_when=asyncio.FIRST_COMPLETED)
            if flight.done():
                measuring.cancel()
                raise Refused(
                    f"flight of {config.name}", f"it ended before: {explain_end(agent)}"
                )
            with without_warnings():
                agent.cut_all("the measurement is over")  # a landing takes longer
                await flight
        return measuring.result()

    return run_virtual(main)


@contextmanager
def without_warnings() -> Iterator[None]:
    """Log no warnings of the package inside this context."""
    logger = logging.getLogger("crazychoir")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


async def measure_law(agent: Agent, measure: Measure[T], say: Say) -> T:
    """Wait until all drones but the leaders have flown the law for SETTLING_TIME s, and measure.

    Raises Refused if a drone does not fly the law any more afterwards.
    """
    clock = agent.clock
    said_at = 0.0
    while list_idle(agent):
        if clock.now() >= said_at:
            say(f"taking off, {clock.now():.0f} s after the start")
            said_at = clock.now() + 1.0
        await clock.sleep(CHECK_INTERVAL)
    await clock.sleep(SETTLING_TIME)
    result = await measure(agent)
    crashed = [i for owner in agent.owners for i in owner.world.crashed]
    idle = list_idle(agent)
    if crashed or idle:
        raise Refused(
            f"flight of {agent.config.name}",
            f"not a good flight: drones {crashed} crashed, drones {idle} do not fly the law",
        )
    return result


def list_idle(agent: Agent) -> list[int]:
    """Return the drones that do not fly the law, without leaders, which may stand still."""
    leaders = {drone.id for drone in agent.config.drones if drone.leader}
    return [
        i
        for i, drone in agent.drones.items()
        if i not in leaders and drone.pilot.mode is not Mode.FOLLOW
    ]


def explain_end(agent: Agent) -> str:
    """Return why the first drone that failed has failed, or that all have landed."""
    for i, drone in agent.drones.items():
        if drone.result and not drone.result.get("success"):
            return f"drone {i}: {drone.result.get('reason', '')}"
    return "all drones have landed"
