"""An operator of a flight in virtual time."""

import asyncio

from crazychoir.agent.agent import Agent
from crazychoir.bus.commands import Commander
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.runtime.clock import run_virtual


class Operator:
    """An operator of the drones of a process, at an address of an observer."""

    def __init__(self, agent):
        self.agent, self.clock = agent, agent.clock
        self.commander = Commander(agent.bus.port(PORT_ADDRESSES.first_observer, 0xF1))
        self.highest = {}

    async def order(self, verb, *drones, deadline=60.0, **arguments):
        """Return what each drone answers: kind and words; of one drone, its alone."""
        ids = drones or self.agent.ids
        answers = await asyncio.gather(
            *(self.commander.request(i, verb, deadline, **arguments) for i in ids)
        )
        said = {
            i: (answer.kind, answer.detail)
            for i, answer in zip(ids, answers, strict=True)
        }
        return said[drones[0]] if len(drones) == 1 else said

    def begin(self, verb, i, **arguments):
        """Return the task that gives one drone a command, and returns its answer."""
        return asyncio.create_task(self.order(verb, i, **arguments))

    def pilot(self, i):
        return self.agent.drones[i].pilot

    def task(self, i):
        return self.agent.drones[i].status().task

    def modes(self):
        return [drone.pilot.mode for drone in self.agent.drones.values()]


def play_scene(mission, scene, config):
    """Return the results of a flight in virtual time, with a scene of its operator beside it."""

    async def main(clock):
        agent = Agent(
            clock,
            config,
            mission,
            config.ids,
        )
        operator = Operator(agent)
        flying = asyncio.create_task(agent.run())
        await clock.sleep(1.0)
        await scene(operator)
        async with asyncio.timeout(200.0):
            return await flying

    return run_virtual(main)
