"""The emergency stop of an operator: stops agents and bodies at once and reports the progress.

A body is the drone itself, simulated or real. The process that owns it (the world, or a radio
dongle) obeys for it.
"""

import asyncio
import logging
import math
from typing import Protocol

from crazychoir.bus.commands import Commander
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.launch.running_swarm import (
    NEXT_PROCESS_TIMEOUT,
    SWARM_SEARCH,
    no_agent_error,
    starting_text,
)
from crazychoir.runtime.clock import Clock
from crazychoir.team.graph import describe_ids

ABSENT_ANSWER = "absent"
OBEY_TIMEOUT = 10.0
"""Seconds that an agent gets to obey after it was found, unless its body has obeyed."""
STOP_REPORT_PERIOD = 0.5
"""Seconds before the first progress line, and between two of them."""
log = logging.getLogger(__name__)


class StopWindow(Protocol):
    """The part of Window that an emergency stop needs."""

    clock: Clock
    config: SwarmConfig
    commander: Commander
    option: str | None
    patience: float

    @property
    def drones(self) -> list[int]:
        """Drones with an agent that was found."""
        ...


class EmergencyStop:
    """Sends an emergency stop, or its clearing, to the agents of some drones and to their bodies.

    The stop ends
    - when all have obeyed, or
    - NEXT_PROCESS_TIMEOUT s after the last agent was found or the last body has obeyed, or
    - after `place.patience` s, if no agent was found and no body has obeyed.
    An agent that was found gets OBEY_TIMEOUT s, unless its body has obeyed.

    place: the observer's connection to the swarm
    meant: ids of the drones
    clear: True to clear an earlier stop
    alone: as in Commander.emergency_stop
    """

    def __init__(
        self, place: StopWindow, meant: tuple[int, ...], clear: bool, alone: bool
    ) -> None:
        self.place = place
        self.meant = meant
        self.clear = clear
        self.alone = alone
        self.owned = [i for i in place.config.topology.elsewhere if i in meant]
        self.found: dict[int, float] = {}  # time in s at which each agent was found
        self.obeyed: dict[int, None] = {}
        self._told = 0
        self._tells = 0.0
        self._waited = False

    async def run(self) -> dict[int, tuple[bool, str]]:
        """Send the stop until it ends; return for each drone whether it has obeyed, and a text.

        Raises Refused if no agent was found and no body has obeyed.
        """
        place = self.place
        targets = [*self.meant, *(PORT_ADDRESSES.body_offset + i for i in self.owned)]
        order = place.commander.emergency_stop(
            targets, self.clear, math.inf, self.alone, self.obeyed
        )
        sending = asyncio.ensure_future(order)
        try:
            await self._wait(sending)
        finally:
            sending.cancel()
        if not self.found and not self.obeyed:
            raise no_agent_error(place.config, place.option)
        return {i: self._said(i) for i in self.meant}

    async def _wait(self, sending: asyncio.Future[list[int]]) -> None:
        place = self.place
        clock = self.place.clock
        news = 0
        began = clock.now()
        # The owner of the bodies may run without any agent: then no port of an agent is open,
        # and the patience of the place may be 0.
        ends = began + max(place.patience, NEXT_PROCESS_TIMEOUT if self.owned else 0.0)
        self._tells = began + STOP_REPORT_PERIOD
        while not sending.done():
            now = clock.now()
            self.found |= {i: now for i in place.drones if i not in self.found}
            count = len(self.found) + len(self._bodies())
            if count > news:
                news = count
                ends = now + NEXT_PROCESS_TIMEOUT
            if now >= ends and not any(self._may_obey(i, now) for i in self.meant):
                return
            self._tell(now, began)
            await clock.sleep(SWARM_SEARCH.check_period)
        sending.result()

    def _may_obey(self, i: int, now: float) -> bool:
        """Return whether the agent of drone i was found and still has time to obey."""
        return (
            not {i, PORT_ADDRESSES.body_offset + i} & self.obeyed.keys()
            and now < self.found.get(i, -math.inf) + OBEY_TIMEOUT
        )

    def _bodies(self) -> list[int]:
        """Return the drones with a body that has obeyed."""
        return [i for i in self.owned if PORT_ADDRESSES.body_offset + i in self.obeyed]

    def _tell(self, now: float, began: float) -> None:
        """Log the agents and bodies that have obeyed so far, or that none has been found yet."""
        name = self.place.config.name
        patience = self.place.patience
        if len(self.obeyed) > self._told and now >= self._tells:
            self._told = len(self.obeyed)
            self._tells = now + STOP_REPORT_PERIOD
            ids = {
                "agents": [i for i in self.meant if i in self.obeyed],
                "bodies": self._bodies(),
            }
            unanswered = "; ".join(
                f"{group} {describe_ids(known)}"
                for group, known in ids.items()
                if known
            )
            verb = "cleared" if self.clear else "stopped"
            log.warning(
                "swarm %s: %s: %s; waiting for the others", name, verb, unanswered
            )
        elif (
            not (self.found or self.obeyed or self._waited)
            and patience > NEXT_PROCESS_TIMEOUT
            and now > began + SWARM_SEARCH.notice_delay
        ):
            self._waited = True
            log.warning("%s", starting_text(self.place.config, patience))

    def _said(self, i: int) -> tuple[bool, str]:
        obeys = i in self.obeyed
        body = i not in self.owned or PORT_ADDRESSES.body_offset + i in self.obeyed
        if obeys:
            said = "acknowledged"
        elif i in self.found:
            said = "no acknowledgement"
        else:
            said = ABSENT_ANSWER
        if i not in self.owned or (obeys and body):
            return obeys, said
        known = (
            "its body has obeyed" if body else "the owner of its body does not answer"
        )
        return False, f"{said}; {known}"
