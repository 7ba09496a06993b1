"""What one page asks for, done: commands at the desk."""

from typing import Any

from crazychoir.dashboard.asks import Ids, Message, Order, Stop
from crazychoir.dashboard.desk import Desk
from crazychoir.errors import ConfigError
from crazychoir.swarm.config import SwarmConfig
from crazychoir.swarm.graph import span


class Operator:
    """One page's operator."""

    def __init__(self, config: SwarmConfig, desk: Desk) -> None:
        self.config, self.desk = config, desk

    async def asked(self, message: Message) -> dict[str, Any] | None:
        """Do it; raises ConfigError, with why not."""
        match message:
            case Order(verb, drones):
                self.desk.order(verb, self._checked(drones))
            case Stop(drones, clear):
                self.desk.stop(self._checked(drones), clear)
        return None

    def _checked(self, drones: Ids | None) -> Ids | None:
        """These drones, each of which the swarm has."""
        for i in drones or ():
            if i not in self.config.ids:
                raise ConfigError("drones", i, span(self.config.ids))
        return drones if drones is None else tuple(dict.fromkeys(drones))
