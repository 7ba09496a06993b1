"""The process of virtual Crazyflies: its server, its signals, its live table."""

import asyncio
import signal
from typing import Any

from crazychoir.errors import ConfigError
from crazychoir.launch.console import LiveTable
from crazychoir.radio.virtual.air import VirtualDongle
from crazychoir.radio.virtual.server import VirtualServer
from crazychoir.radio.virtual.setup import VirtualSwarm
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.runtime.worker_thread import add_signal_handler

SERVING_TABLE_RATE = 4.0
"""Updates of the live table, Hz."""
Shared = list[tuple[tuple[int, ...], float | None]]
"""For each dongle: its drones and its capacity in packets/s, None if not given."""


async def serve_virtual_drones(
    clock: Clock,
    hall: VirtualSwarm,
    shared: Shared,
    seed: int,
    release: str,
    progress: LiveTable[dict[int, Any]],
) -> dict[str, Any]:
    """Serve virtual Crazyflies until a signal; return a report.

    hall: the drones and their places
    shared: drones and capacity of each dongle
    seed: seed of all random draws
    release: version of the firmware
    progress: live table
    Raises ConfigError if a port is taken.
    """
    radios = [VirtualDongle(clock, group, capacity) for group, capacity in shared]
    server = VirtualServer(
        clock, hall.world(seed, release), hall.seats, hall.poses, radios, seed
    )
    try:
        server.listen()
    except ConfigError as error:
        raise ConfigError(
            error.where, error.found, error.allowed, hall.taken
        ) from error
    failures: list[str] = []
    supervisor = Supervisor(
        clock, "virtual", lambda actor, error, again: failures.append(str(error))
    )
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        add_signal_handler(number, supervisor.stop)
    progress.say(_describe_addresses(hall))
    shows = asyncio.create_task(_show_progress(clock, server, progress))
    try:
        await supervisor.run([server])
    finally:
        shows.cancel()
    return server.report() | (
        {"success": False, "error": failures[0]} if failures else {}
    )


def _describe_addresses(hall: VirtualSwarm) -> str:
    uris = [f"udp://{seat.at[0]}:{seat.at[1]}" for seat in hall.seats]
    shown = uris[0] if len(uris) == 1 else f"{uris[0]} to {uris[-1]}"
    return f"virtual Crazyflies: {shown}; poses at udp://{hall.poses[0]}:{hall.poses[1]}; Ctrl-C ends"


async def _show_progress(
    clock: Clock, server: VirtualServer, progress: LiveTable[dict[int, Any]]
) -> None:
    async for _ in clock.ticks(SERVING_TABLE_RATE):
        progress({i: server.questions.describe_drone(i) for i in server.ports})
