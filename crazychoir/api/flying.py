"""Fly a chosen mission on this machine: in virtual time in this process, or in real time in several."""

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crazychoir.api.flight_request import refuse_operator
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import Mission, has_hook
from crazychoir.launch.flight import (
    NO_DISPLAY,
    FlightDisplay,
    fly_fast,
    fly_real,
    list_dongles,
    list_owners,
    require_extras,
)
from crazychoir.launch.flight_observer import Watch
from crazychoir.launch.fork_server import ForkServer
from crazychoir.launch.network import hold_isolated_swarm, write_swarm_file
from crazychoir.launch.processes import SwarmLauncher
from crazychoir.launch.recording import open_recording_file
from crazychoir.launch.run_registry import RunRecord, record_run
from crazychoir.numerics.compiling import KERNEL_QUEUE
from crazychoir.radio.link.ownership import require_free


@dataclass(frozen=True, slots=True)
class ChosenFlight:
    """Which mission flies, with which drones, and where it is recorded."""

    what: str
    """The mission or swarm file, as given."""
    source: str | None
    """Resolved path of the swarm file; None without one."""
    mission: Mission
    """The mission."""
    started: tuple[int, ...]
    """Drones that this host starts."""
    recording: Path | None
    """New file to record into."""
    is_isolated: bool = True
    """Whether the swarm gets a name and ports of its own in real time.

    A swarm that several hosts start keeps those of its file.
    """


def require_flyable(
    config: SwarmConfig, started: tuple[int, ...], is_virtual: bool
) -> None:
    """Raise ConfigError for an extra or a dongle that the flight needs and that is not free here.

    An operator cannot command a swarm in virtual time.
    """
    if is_virtual and config.flight.operator:
        raise refuse_operator("[flight] operator = true")
    owners = [] if is_virtual else list_owners(config, started)
    require_extras(config, owners, is_virtual)
    if not is_virtual:
        require_free(config, list_dongles(config, started))


def fly_in_virtual_time(
    flight: ChosenFlight, config: SwarmConfig, watch: Watch | None = None
) -> tuple[SwarmConfig, dict[str, Any]]:
    """Fly in this process; return the swarm and the result of `fly_fast`.

    watch: called with the score at every tick, None for no view
    """
    recording = open_recording_file(
        flight.recording, config, flight.mission, virtual=True
    )
    began = time.perf_counter()
    KERNEL_QUEUE.compile()
    compiled_s = time.perf_counter() - began
    with recording as file:
        result = fly_fast(config, flight.mission, watch, file)
    result["startup_s"] += compiled_s
    return config, result


def fly_in_real_time(
    server: ForkServer,
    flight: ChosenFlight,
    config: SwarmConfig,
    processes: int | None,
    display: FlightDisplay = NO_DISPLAY,
    announce: Callable[[Path], None] = lambda path: None,
) -> tuple[SwarmConfig, dict[str, Any]]:
    """Fly in processes of their own; return the swarm that has flown and the result of `fly_real`.

    server: makes the processes
    processes: number of processes; None: as the swarm file says
    display: shows the flight
    announce: called with the swarm file of this flight before it begins
    """
    server.prepare()
    if KERNEL_QUEUE.is_first_run() and has_hook(flight.mission, "compile"):
        flight.mission.compile(config)  # while the server compiles
    held = (
        hold_isolated_swarm(config, processes, keeps_port=True)
        if flight.is_isolated
        else nullcontext(config)
    )
    with (
        held as config,
        open_recording_file(
            flight.recording, config, flight.mission, virtual=False
        ) as file,
        write_swarm_file(config) as path,
        record_run(RunRecord(config.name, flight.what, flight.source, str(path))),
    ):
        announce(path)
        result = fly_real(
            SwarmLauncher(server, path),
            config,
            flight.mission,
            display,
            flight.started,
            file,
        )
    return config, result
