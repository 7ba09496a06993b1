"""The owner of a dongle, in a process of its own: its drones' agents are elsewhere."""

import logging
import math
from typing import Any

from crazychoir.bus.port import BODIES, Bus
from crazychoir.bus.topics import LINK
from crazychoir.config.checks import limit_area
from crazychoir.config.radio_checks import capacity_of
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.robots import sender_of
from crazychoir.errors import Refused, error_text
from crazychoir.radio.budget import rates
from crazychoir.radio.drone.radio_drone import LOOKS, LOST, RadioDrone
from crazychoir.radio.link.dongles import DONGLES
from crazychoir.radio.link.toc_cache import TableOfContents, folder
from crazychoir.radio.link.writer import Turns
from crazychoir.radio.visibility import Sights
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.safety.rules.guard import Fence
from crazychoir.simulation.remote import RemoteBody

log = logging.getLogger(__name__)
LEFT_ALONE = 1.0
"""s without a command after which nobody flies a drone any more."""
PACED = 0.9
"""Of what a dongle carries: so fast packets leave for it."""
LANDS_WITHIN = 15.0
"""s that drones get to land that fly when the owner is told to end."""


class RadioProcess(Actor):
    """The owner of one dongle of a swarm: links to its drones, whose pilots are in other processes.

    Who is left by its agent is told to land by its firmware. It ends when it is told to and nobody flies any more.
    """

    name = "radios"

    def __init__(
        self,
        clock: Clock,
        config: SwarmConfig,
        dongle: int,
        process: str,
        host: str,
        incarnation: int,
    ) -> None:
        self.clock = clock
        self.config = config
        self.dongle = dongle
        self.bus = Bus(clock, process=process, host=host)
        self.ids = config.dongles[dongle]
        rate = rates(config)[dongle]
        contents = TableOfContents(folder())
        for i in self.ids:
            self.bus.port(BODIES + i, incarnation)
        turn = self._turns().turn
        sights = Sights(self.bus, config, BODIES + self.ids[0])
        self.drones = {
            i: RadioDrone(
                self.bus, config, i, sender_of(config, i), rate, contents, turn, sights
            )
            for i in self.ids
        }
        self.bodies = {
            i: RemoteBody(
                self.bus.ports[BODIES + i],
                drone,
                drone,
                drone.kind,
                flight=config.flight,
                ask=drone.ask,
                arm=drone.arm,
            )
            for i, drone in self.drones.items()
        }
        self.rate = rate
        self.failure = ""
        self._missing = ""
        self._ending = 0.0
        self._limit = Fence.box(*limit_area(config))
        self._supervisor = Supervisor(clock, f"dongle {dongle}", self._failed)

    def _turns(self) -> Turns:
        """Of what a dongle carries, and a little less: what waits in it grows old."""
        return Turns(self.clock, PACED * capacity_of(self.config, self.dongle))

    async def serve(self, *services: Actor) -> None:
        """Until its end."""
        await self._supervisor.run([*services, *self.drones.values(), self])

    async def run(self) -> None:
        """Say how the links are, and look after drones that nobody commands."""
        tick = 0
        every = round(LOOKS / LINK.rate)
        began = self.clock.now()
        async for _ in self.clock.ticks(LOOKS):
            self._look_at_dongle(self.clock.now() - began)
            for i, body in self.bodies.items():
                body.look()
                self._keep_inside(i, body)
                if self.drones[i].orphan:
                    body.abandon()
            tick += 1
            if tick % every == 0:
                for drone in self.drones.values():
                    drone.report()
            if self._ending and self._alone():
                self._leave()

    def _look_at_dongle(self, age: float) -> None:
        """One that was pulled out ends this process: nothing in it finds a dongle again as surely as a new one.

        One that is not there is waited for as long as its drones are.
        """
        before = self._missing
        self._missing = DONGLES.failure(self.config.drone(self.ids[0]).uri)
        if not self._missing:
            return
        used = any(math.isfinite(drone.silence) for drone in self.drones.values())
        if before and (used or age > self.config.radio.connect_deadline):
            self.abort(self._missing)
        elif not (before or used):
            log.error("dongle %d: %s", self.dongle, self._missing)

    def _keep_inside(self, i: int, body: RemoteBody) -> None:
        """Whose agent says nothing is looked after here: beyond the limit area its motors are cut, if it can hear that.

        One that was heard long ago may be carried about.
        """
        drone = self.drones[i]
        now = self.clock.now()
        flies = drone.flying and drone.silence < LOST
        seen = drone.place if flies and body.silence > LEFT_ALONE else None
        if (
            seen is not None
            and now - seen[0] < LEFT_ALONE
            and (beyond := self._limit.outside(*seen[1].p)) > 0.0
        ):
            body.stop(f"{beyond:.2f} m outside the limit area, and nobody commands it")

    def _alone(self) -> bool:
        """Whether nobody commands, and nobody flies, or has had the time to land."""
        commanded = any(body.silence < LEFT_ALONE for body in self.bodies.values())
        flying = any(drone.flying for drone in self.drones.values())
        return self.clock.now() > self._ending or not (commanded or flying)

    def _leave(self) -> None:
        """All has landed, or has had the time to."""
        if flying := [str(i) for i, drone in self.drones.items() if drone.flying]:
            self.abort(
                f"ends {LANDS_WITHIN:g} s after it was told to; not known to have landed: {', '.join(flying)}"
            )
        self._supervisor.stop()

    def end(self, reason: str) -> None:
        """As soon as nobody flies."""
        self._ending = self._ending or self.clock.now() + LANDS_WITHIN

    def abort(self, reason: str) -> None:
        """Now."""
        self.failure = self.failure or reason
        log.error("dongle %d: %s", self.dongle, reason)
        self._supervisor.stop()

    def refuse(self, refused: Refused) -> None:
        """Another process owns these drones already."""
        self.abort(str(refused))

    def _failed(self, actor: Actor, error: Exception, again: bool) -> None:
        text = f"{actor.name} failed: {error_text(error)}"
        if isinstance(actor, RadioDrone):
            log.error("drone %d: %s", actor.drone, text)
        else:
            self.abort(text)

    def report(self) -> dict[str, Any]:
        """How its links were."""
        return {
            "success": not self.failure,
            "reason": self.failure,
            "dongle": self.dongle,
            "setpoints_hz": self.rate,
            "drones": {
                i: {
                    "state": drone.state_of_link,
                    "release": drone.release,
                    "reconnected": drone.reconnected,
                    "refused": drone.refused_plans,
                    "malformed": drone.malformed,
                }
                for i, drone in self.drones.items()
            },
        }
