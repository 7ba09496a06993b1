"""The simulated worlds of a process: engines, cameras and owners.

WorldProcess is the process that owns the worlds of all drones.
"""

import logging
import math
from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.robots import find_sender
from crazychoir.errors import Refused, error_text
from crazychoir.mocap.simulated import SimulatedMocap
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.simulation.engines import count_delay_steps, make_worlds
from crazychoir.simulation.owner import Digest, WorldOwner
from crazychoir.simulation.remote import BodyRequests, RemoteBody

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class WorldOwnerRules:
    """When a body of the world no longer counts as flown, and how many latencies are kept."""

    silence_limit: float = 1.0
    """s without a command after which a body no longer counts as flown."""
    check_rate: float = 20.0
    """Hz: rate at which the world checks which bodies are flown."""
    kept_latencies: int = 20_000
    """Number of latencies that are kept, the newest."""


WORLD_OWNER_RULES = WorldOwnerRules()


def world_actors(
    bus: Bus,
    config: SwarmConfig,
    ids: tuple[int, ...],
    *,
    trace: Digest | None = None,
    base: int = 0,
) -> list[WorldOwner]:
    """Return the actors that step the worlds of these drones and observe them with cameras.

    bus: the bus of the process.
    config: the swarm file.
    ids: ids of the drones.
    trace: digest of virtual time.
    base: the ports of the drones are at base + id.
    """
    return [
        WorldOwner(
            bus,
            world,
            SimulatedMocap.of(config, world.ids),
            config.mocap.rate,
            trace,
            base,
            count_delay_steps(config, world),
        )
        for world in make_worlds(config, ids)
    ]


@dataclass
class CommandLatency:
    """Measures the time from the exposure of the cameras to the command that follows from it.

    It includes the way through two processes and the network.
    """

    owner: WorldOwner
    """Owner of the world."""
    kept: deque[int]
    """ns: the newest latencies."""

    def note(self) -> None:
        """Record the latency of a command that has arrived."""
        self.kept.append(self.owner.bus.clock.now_ns() - self.owner.looked_ns)


class WorldProcess(Actor):
    """The owner of all worlds of a swarm. The pilots of its drones are in other processes.

    A drone without commands is left to its engine. The process ends when it is told to and no drone
    flies any more, so that landing drones still have a floor. It ends at once when its network or a
    world fails.
    """

    name = "bodies"

    def __init__(
        self,
        clock: Clock,
        config: SwarmConfig,
        process: str,
        host: str,
        incarnation: int,
    ) -> None:
        self.clock = clock
        self.bus = Bus(clock, process=process, host=host)
        self._config = config
        for i in config.topology.owned:
            self.bus.port(PORT_ADDRESSES.body_offset + i, incarnation)
        self.owners = world_actors(
            self.bus, config, config.topology.owned, base=PORT_ADDRESSES.body_offset
        )
        self.latencies_ns: deque[int] = deque(maxlen=WORLD_OWNER_RULES.kept_latencies)
        self.bodies = [body for owner in self.owners for body in self._bodies(owner)]
        bodies = {body.drone: body for body in self.bodies}
        for owner in self.owners:
            owner.flying = lambda i: bodies[i].flying
            owner.cut = lambda i: bodies[i].was_cut
        self.failure = ""
        self._ending: str | None = None
        self._patient_until = 0.0
        self._supervisor = Supervisor(clock, "world", self._failed)

    def _bodies(self, owner: WorldOwner) -> list[RemoteBody]:
        note = CommandLatency(owner, self.latencies_ns).note
        flight = self._config.flight
        kinds = {i: find_sender(self._config, i) for i in owner.world.ids}
        return [
            RemoteBody(
                self.bus.ports[PORT_ADDRESSES.body_offset + i],
                owner.world,
                owner.link(i, kind),
                kind,
                note,
                flight,
                BodyRequests(ask=partial(owner.telemetry.ask, i)),
            )
            for i, kind in kinds.items()
        ]

    async def serve(self, *services: Actor) -> None:
        """Run until the end."""
        await self._supervisor.run([*services, *self.owners, self])

    async def run(self) -> None:
        """Check regularly which bodies get commands; after `end`, stop when no drone flies."""
        async for _ in self.clock.ticks(WORLD_OWNER_RULES.check_rate):
            for body in self.bodies:
                body.look()
            if self._ending is not None:
                self._end_if_alone()

    @property
    def flown(self) -> list[int]:
        """Ids of the drones that receive commands."""
        return [
            body.drone
            for body in self.bodies
            if body.silence < WORLD_OWNER_RULES.silence_limit
        ]

    def end(self, reason: str) -> None:
        """Let the process end as soon as no drone flies."""
        self._ending, self._patient_until = (
            reason,
            self.clock.now() + 2.0 * WORLD_OWNER_RULES.silence_limit,
        )

    def _end_if_alone(self) -> None:
        """End if no drone flies. Log once if agents take longer to end than usual."""
        flown = self.flown
        if not flown:
            self._supervisor.stop()
        elif self.clock.now() > self._patient_until:
            names = ", ".join(map(str, flown))
            self._patient_until = math.inf
            log.warning(
                "world: %s: it goes on until the agents of drone(s) %s have ended",
                self._ending,
                names,
            )

    def abort(self, reason: str) -> None:
        """End now. Drones in flight lose their poses."""
        self.failure = self.failure or reason
        log.error("world: %s", reason)
        self._supervisor.stop()

    def refuse(self, refused: Refused) -> None:
        """End, because another process owns these worlds already."""
        self.abort(str(refused))

    def _failed(self, actor: Actor, error: Exception, again: bool) -> None:
        self.abort(f"{actor.name} failed: {error_text(error)}")

    def report(self) -> dict[str, Any]:
        """Return the result of the process.

        It holds the number of steps, the missed steps, and the ms from an exposure of the cameras to
        the command that follows from it.
        """
        kept = np.array(self.latencies_ns) / NS_PER_SECOND * 1e3
        p50, p99 = (
            round(float(np.percentile(kept, q)), 3) if len(kept) else None
            for q in (50.0, 99.0)
        )
        return {
            "success": not self.failure,
            "reason": self.failure,
            "steps": sum(
                round(owner.world.time / owner.world.dt) for owner in self.owners
            ),
            "missed": sum(owner.ticks.missed for owner in self.owners),
            "crashed": sorted(i for owner in self.owners for i in owner.world.crashed),
            "commands": len(kept),
            "pose_to_command_p50_ms": p50,
            "pose_to_command_p99_ms": p99,
        }
