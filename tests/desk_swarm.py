"""A swarm that a page's desk commands: no flight, only answers."""

from message_parts import deafen

from crazychoir.bus.commands import Commander, CommandServer
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.event_log import EventLog
from crazychoir.errors import Refused


class Swarm:
    """Three drones: 0 does what it is told after 1 s, 1 refuses, 2 hears nothing."""

    def __init__(self, clock):
        self.clock = clock
        drones = [{"id": i, "home": [1.0 * i, 0.0, 0.0]} for i in range(3)]
        self.config = SwarmConfig.of({"name": "a", "drones": drones})
        bus = self.bus = Bus(clock)
        self.obeyed, self.stopped = [], []
        for i in (0, 1):
            CommandServer(
                bus.port(i),
                self.executor(i),
                lambda on, i=i: self.stopped.append((i, on)),
            )
        self.commander = Commander(bus.port(PORT_ADDRESSES.first_observer))
        self.watch = EventLog(clock)
        self.desk = CommandDesk(self, self.watch)
        self.replays = False

    def is_there(self, i):
        return i in self.bus.ports

    def deaf(self, i):
        """Drone i hears nothing until the function that is returned is called."""
        return deafen(self.bus.ports[i])

    def executor(self, i):
        async def execute(verb, arguments):
            if i == 1:
                raise Refused("drone 1", "it is on the ground")
            await self.clock.sleep(1.0)
            self.obeyed.append((verb, arguments))
            return "hovering"

        return execute
