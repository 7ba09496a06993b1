"""The owner of a dongle, in a process of its own: its drones' agents are elsewhere."""

import contextlib
import fcntl
import logging
import os
from collections.abc import Iterator
from typing import IO, Any

from crazychoir.bus.local import BODIES, Bus
from crazychoir.bus.topics import LINK
from crazychoir.control.robots import sender_of
from crazychoir.errors import Refused
from crazychoir.radio.budget import rates
from crazychoir.radio.contents import TableOfContents, folder
from crazychoir.radio.drone import LOOKS, RadioDrone
from crazychoir.radio.sights import Sights
from crazychoir.radio.writer import Pace
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.places import runtime_folder
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.simulation.remote import RemoteBody
from crazychoir.swarm.config import SwarmConfig
from crazychoir.swarm.radios import PINGS, capacity_of

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
        self, clock: Clock, config: SwarmConfig, dongle: int, process: str, host: str, incarnation: int
    ) -> None:  # fmt: skip
        self.clock, self.config, self.dongle = clock, config, dongle
        self.bus = Bus(clock, process=process, host=host)
        self.ids = config.dongles[dongle]
        rate, contents = rates(config)[dongle], TableOfContents(folder())
        for i in self.ids:
            self.bus.port(BODIES + i, incarnation)
        turn, sights = self._pace().turn, Sights(self.bus, config, BODIES + self.ids[0])
        self.drones = {
            i: RadioDrone(self.bus, config, i, sender_of(config, i), rate, contents, turn, sights) for i in self.ids
        }
        self.bodies = {
            i: RemoteBody(self.bus.ports[BODIES + i], drone, drone, drone.kind, flight=config.flight, ask=drone.ask)
            for i, drone in self.drones.items()
        }  # fmt: skip
        self.rate, self.failure, self._ending = rate, "", 0.0
        self._supervisor = Supervisor(clock, f"dongle {dongle}", self._failed)

    def _pace(self) -> Pace:
        """Of what a dongle carries beside cflib's own echoes, and a little less: what waits in it grows old."""
        return Pace(self.clock, PACED * capacity_of(self.config, self.dongle) - PINGS * len(self.ids))

    async def serve(self, *services: Actor) -> None:
        """Until its end."""
        await self._supervisor.run([*services, *self.drones.values(), self])

    async def run(self) -> None:
        """Say how the links are, and look after drones that nobody commands."""
        tick, every = 0, round(LOOKS / LINK.rate)
        async for _ in self.clock.ticks(LOOKS):
            for i, body in self.bodies.items():
                body.look()
                if self.drones[i].orphan:
                    body.abandon()
            tick += 1
            if tick % every == 0:
                for drone in self.drones.values():
                    drone.report()
            if self._ending and self._alone():
                self._supervisor.stop()

    def _alone(self) -> bool:
        """Whether nobody commands, and nobody flies, or has had the time to land."""
        commanded = any(body.silence < LEFT_ALONE for body in self.bodies.values())
        flying = any(drone.flying for drone in self.drones.values())
        return self.clock.now() > self._ending or not (commanded or flying)

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
        text = f"{actor.name} failed: {type(error).__name__}: {error}"
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
                i: {"state": drone.state_of_link, "release": drone.release, "reconnected": drone.reconnected,
                    "refused": drone.refused_plans, "malformed": drone.malformed}
                for i, drone in self.drones.items()
            },
        }  # fmt: skip


@contextlib.contextmanager
def owned(config: SwarmConfig, dongle: int) -> Iterator[None]:
    """This process owns a dongle, or, of virtual drones, their addresses; Refused while another one does."""
    uris = {i: config.drone(i).uri for i in config.dongles[dongle]}
    names = {f"dongle-{dongle}" if uri.startswith("radio") else uri for uri in uris.values()}
    with contextlib.ExitStack() as kept:
        for name in sorted(names):
            kept.enter_context(_locked(name.replace("/", "_").replace(":", "_"), f"dongle {dongle}"))
        yield


@contextlib.contextmanager
def _locked(name: str, who: str) -> Iterator[None]:
    folder = runtime_folder()
    if folder is None:
        yield
        return
    file: IO[str] = (folder / f".{name}.lock").open("a+")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        raise Refused(who, f"process {file.read().strip() or '?'} has it: end that one first") from None
    else:
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield
    finally:
        file.close()
