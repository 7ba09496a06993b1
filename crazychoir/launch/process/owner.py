"""Runs a process that owns something which agents need: a world, the cameras or a dongle."""

import random
import socket
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol, Self

from crazychoir.bus.network.hello import PACKAGE_VERSION
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.network.zenoh_session import SessionEndpoints
from crazychoir.bus.port import Bus
from crazychoir.config.access import access_of
from crazychoir.config.addresses import Addresses
from crazychoir.config.digest import compute_body_digests
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.launch.process.signals import EndableProcess, end_on_signals
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.watchdog import Watchdog


class OwnerProcess(EndableProcess, Protocol):
    """A process that owns something, with its bus and its services."""

    clock: Clock
    bus: Bus

    async def serve(self, link: ZenohLink, *services: Actor) -> None:
        """Run until the end, with the link to the network and further services."""
        ...

    def refuse(self, refused: Refused) -> None:
        """End, because another process owns the same."""
        ...


@dataclass(frozen=True, slots=True)
class ProcessIdentity:
    """How a process of a swarm is known on the network."""

    number: int
    """Number of the process in the swarm, see Addresses."""
    name: str
    """Name of this life of the process."""
    host: str
    """Name of its host."""
    incarnation: int
    """62 random bits: the number of this life of the process."""

    @classmethod
    def draw(cls, kind: str, number: int, host: str | None) -> Self:
        """Return an identity with a new incarnation.

        kind: first part of the name, such as "world"
        number: number of the process in the swarm
        host: name of its host in the swarm file; None for the name of this machine
        """
        incarnation = random.SystemRandom().getrandbits(62)
        name = f"{kind}-{incarnation & 0xFFFFFFFF:08x}"
        here = host or socket.gethostname().split(".")[0]
        return cls(number, name, here, incarnation)


def introduce_process(config: SwarmConfig, incarnation: int) -> Introduction:
    """Return the introduction of a process that holds drones or their bodies.

    incarnation: random number of the process
    """
    return Introduction(
        swarm=config.name,
        incarnation=incarnation,
        version=PACKAGE_VERSION,
        agreed=compute_body_digests(config),
    )


async def run_owner(
    config: SwarmConfig,
    owner: OwnerProcess,
    identity: ProcessIdentity,
    listen: str | None,
    connect: Sequence[str] = (),
    services: Sequence[Actor] = (),
    is_watched: bool = True,
) -> dict[str, Any]:
    """Connect the owner to the network over Zenoh, and run it until a signal ends it.

    Returns figures for its report: counters of the network, and the largest delay of its event loop.

    config: the swarm
    owner: the process to run, with its bus
    identity: how it is known on the network
    listen: Zenoh endpoint, None for that of the swarm file
    connect: endpoints to which it connects
    services: actors that run beside it
    is_watched: whether a watchdog measures how late its event loop is
    """
    addresses = Addresses(config)
    link = ZenohLink(
        owner.bus,
        introduce_process(config, identity.incarnation),
        SessionEndpoints(
            listen=[listen or addresses.endpoints()[identity.number]],
            connect=list(connect),
            routers=addresses.routers,
            lease=config.lease,
            remote_processes=addresses.count_remote(identity.host),
        ),
        access=access_of(config, identity.host, *filter(None, [listen])),
        on_refused=owner.refuse,
    )
    link.open()
    watchdog = Watchdog(owner.clock) if is_watched else None
    if watchdog is not None:
        watchdog.start()
    end_on_signals(owner.clock, owner)
    try:
        await owner.serve(link, *services)
    finally:
        if watchdog is not None:
            watchdog.stop()
    figures: dict[str, Any] = {"network": asdict(link.counters)}
    return figures if watchdog is None else figures | {"late_s": watchdog.worst}
