"""An observer's place beside two drones on one bus: 3 does what it is told, 8 refuses."""

import asyncio
from functools import partial
from typing import Any

import numpy as np

from crazychoir.bus.commands import Commander, CommandServer
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.runtime.clock import Clock
from crazychoir.types import FullState, LinkStatus, State, Status

TURNED = [0.0, 0.0, float(np.sqrt(0.5)), float(np.sqrt(0.5))]
CONFIG = SwarmConfig.of(
    {
        "name": "two",
        "drones": [{"id": 3, "home": [0, 0, 0]}, {"id": 8, "home": [1, 0, 0]}],
    }
)
NETWORK = {"rules": [], "cuts": []}


class ObserverPlace:
    """The place, and what the drones are told."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.config = CONFIG
        self.bus = Bus(clock)
        self.link = self
        self.address = PORT_ADDRESSES.first_observer + 1
        self.commander = Commander(self.bus.port(self.address))
        self.replays = False
        self.delay = 0.0  # s, until a command is done
        self.told: list[Any] = []
        self.stopped: list[int] = []
        for i in self.config.ids:
            stop = partial(self._stop, i)
            CommandServer(self.bus.port(i), partial(self._execute, i), stop)

    def _stop(self, i: int, on: bool) -> None:
        self.stopped.append(i)

    def is_there(self, i: int) -> bool:
        return i in self.bus.ports

    async def _execute(self, i: int, verb: str, arguments: dict[str, Any]) -> Any:
        if verb == "overview":
            route = [[2, 0, 1]] if i == 3 else []
            return {"route": route, "links": {}, "network": NETWORK}
        if i == 8 or verb == "task_list":
            raise Refused("drone 8", "it is on the ground")
        self.told.append((verb, arguments))
        await self.clock.sleep(self.delay)
        return "landed"

    def publish(self, x: float) -> None:
        """Let both drones say that they are at (x, id, 1) m."""
        for i in self.config.ids:
            port = self.bus.ports[i]
            flat = np.array([x, i, 1.0, 0.5, 0, 0, *TURNED, 0, 0, 0])
            port.publish(DRONE_TOPICS.state, State(flat), 0.0)
            port.publish(DRONE_TOPICS.reference, FullState.at((x, i, 1.5)), 0.0)
            port.publish(DRONE_TOPICS.status, Status("flying", cost=float(i)), 0.0)
            port.publish(DRONE_TOPICS.link, LinkStatus("up", battery=3.9), 0.0)
        port.publish(DRONE_TOPICS.log, "drone 8: commanded: hold", 0.0)

    async def move(self) -> None:
        """Publish on and on."""
        x = 0.0
        while True:
            self.publish(x)
            x += 0.01
            await asyncio.sleep(0.02)
