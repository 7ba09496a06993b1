"""An emergency stop by an operator: agents and bodies at once; who has obeyed is told, whoever is still waited for."""

import asyncio
import logging
import math
from typing import Protocol

from crazychoir.bus.commands import Commander
from crazychoir.bus.port import BODIES
from crazychoir.cli.shared.running_swarm import DISCOVERY, LOOK, SOON, nobody, starting
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.runtime.clock import Clock
from crazychoir.team.graph import span

ABSENT = "absent"
OBEYS = 10.0
"""s that an agent gets to obey from when it was found, unless its body has."""
TELL = 0.5
"""s after which it is told who has obeyed, while others are waited for; and between two times."""
log = logging.getLogger(__name__)


class Place(Protocol):
    """What a stop needs of the place from which it is given: see Window."""

    clock: Clock
    config: SwarmConfig
    commander: Commander
    option: str | None
    patience: float

    @property
    def drones(self) -> list[int]:
        """Drones whose agents were found."""
        ...


class EmergencyStop:
    """A stop, or its clearing, that is sent to the agents of these drones, and to their bodies at an owner.

    It ends when all have obeyed; DISCOVERY s after the last agent was found and the last body has obeyed; or, while
    there is nobody, after the patience of its place. An agent that was found gets OBEYS s, unless its body has obeyed.
    alone: see Commander.emergency_stop.
    """

    def __init__(
        self, place: Place, meant: tuple[int, ...], clear: bool, alone: bool
    ) -> None:
        self.place = place
        self.meant = meant
        self.clear = clear
        self.alone = alone
        self.owned = [i for i in place.config.elsewhere if i in meant]
        self.found: dict[int, float] = {}  # s, when the agent of each drone was
        self.obeyed: dict[int, None] = {}
        self._told = 0
        self._tells = 0.0
        self._waited = False

    async def run(self) -> dict[int, tuple[bool, str]]:
        """By drone: whether it has obeyed, and what is known; raises Refused if there is nobody at all."""
        place = self.place
        targets = [*self.meant, *(BODIES + i for i in self.owned)]
        order = place.commander.emergency_stop(
            targets, self.clear, math.inf, self.alone, self.obeyed
        )
        sending = asyncio.ensure_future(order)
        try:
            await self._wait(sending)
        finally:
            sending.cancel()
        if not self.found and not self.obeyed:
            raise nobody(place.config, place.option)
        return {i: self._said(i) for i in self.meant}

    async def _wait(self, sending: asyncio.Future[list[int]]) -> None:
        place = self.place
        clock = self.place.clock
        news = 0
        began = clock.now()
        # A world may be there without any agent, and nobody listens at their ports then.
        ends = began + max(place.patience, DISCOVERY if self.owned else 0.0)
        self._tells = began + TELL
        while not sending.done():
            now = clock.now()
            self.found |= {i: now for i in place.drones if i not in self.found}
            count = len(self.found) + len(self._bodies())
            if count > news:
                news = count
                ends = now + DISCOVERY
            if now >= ends and not any(self._may_obey(i, now) for i in self.meant):
                return
            self._tell(now, began)
            await clock.sleep(LOOK)
        sending.result()

    def _may_obey(self, i: int, now: float) -> bool:
        """Whether its agent is there, and is waited for."""
        return (
            not {i, BODIES + i} & self.obeyed.keys()
            and now < self.found.get(i, -math.inf) + OBEYS
        )

    def _bodies(self) -> list[int]:
        """The drones whose bodies have obeyed."""
        return [i for i in self.owned if BODIES + i in self.obeyed]

    def _tell(self, now: float, began: float) -> None:
        """Say who has obeyed so far, or that nobody is there yet."""
        name = self.place.config.name
        patience = self.place.patience
        if len(self.obeyed) > self._told and now >= self._tells:
            self._told = len(self.obeyed)
            self._tells = now + TELL
            ids = {
                "agents": [i for i in self.meant if i in self.obeyed],
                "bodies": self._bodies(),
            }
            who = "; ".join(
                f"{whose} {span(known)}" for whose, known in ids.items() if known
            )
            verb = "cleared" if self.clear else "stopped"
            log.warning("swarm %s: %s: %s; waiting for the others", name, verb, who)
        elif (
            not (self.found or self.obeyed or self._waited)
            and patience > DISCOVERY
            and now > began + SOON
        ):
            self._waited = True
            log.warning("%s", starting(self.place.config, patience))

    def _said(self, i: int) -> tuple[bool, str]:
        obeys = i in self.obeyed
        body = i not in self.owned or BODIES + i in self.obeyed
        said = (
            "acknowledged"
            if obeys
            else "no acknowledgement"
            if i in self.found
            else ABSENT
        )
        if i not in self.owned or (obeys and body):
            return obeys, said
        known = "its body has obeyed" if body else "its body's owner does not answer"
        return False, f"{said}; {known}"
