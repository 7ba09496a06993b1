"""The running swarm that a command means, and how long to wait for its drones."""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from crazychoir.config.addresses import LOCAL_ADDRESS, Addresses
from crazychoir.config.swarm_config import SwarmConfig, find_swarm
from crazychoir.errors import Refused
from crazychoir.launch.run_registry import (
    RunRecord,
    list_every_run,
    list_own_runs,
    list_runs_of_file,
)

LOCAL_SWARM_FILE = "swarm.toml"
NEXT_PROCESS_TIMEOUT = 4.0
"""Seconds to find the next process of a swarm, counted from the last discovery."""


@dataclass(frozen=True, slots=True)
class SwarmSearchTiming:
    """Times of the search for the processes of a running swarm."""

    start_timeout: float = 180.0
    """Seconds to find the first process if a run on this machine starts it.

    The run may have to compile its laws first.
    """
    check_period: float = 0.02
    """Seconds between two looks for new processes."""
    notice_delay: float = 2.0
    """Seconds without any process before a line says that the command is waiting."""
    probe_timeout: float = 0.5
    """Seconds within which a process of this machine must accept a connection."""


SWARM_SEARCH = SwarmSearchTiming()


NOT_STARTED_HINT = (
    "its run has not started them yet (a first run compiles its laws for a minute or two), "
    "or is ending; try again."
)


ChooseRun = Callable[[list[RunRecord]], RunRecord]
"""Returns one of several runs that could be meant, or raises Refused."""


def refuse_choice(found: list[RunRecord]) -> RunRecord:
    """Raise Refused with a text that names these runs."""
    raise Refused(
        "crazychoir", f"several of your runs could be meant. {run_choice_text(found)}"
    )


def running_swarm(option: str | None, choose: ChooseRun = refuse_choice) -> SwarmConfig:
    """Return the running swarm that a command means.

    With a swarm file, or ./swarm.toml, this is the run of that file on this machine. Without such
    a run it is the swarm of the file itself, with agents started by hand. Without a file it is the
    only run of this user, else the demo swarm if its agents are there.

    choose: called if several runs are possible
    Raises Refused if there is none, and all errors of `choose`.
    """
    file = option or (LOCAL_SWARM_FILE if Path(LOCAL_SWARM_FILE).is_file() else None)
    found = list_own_runs() if file is None else list_runs_of_file(file)
    if len(found) > 1:
        found = [choose(found)]
    if found or file is not None:
        return SwarmConfig.load(found[0].file if found else str(file))
    if first_process_timeout(demo := find_swarm()[0]) == 0.0:
        raise no_agent_error(demo, None)
    from crazychoir.guidance.mission import (
        has_hook,
        load_mission,
    )  # takes 1 s, for which other commands need not wait

    mission = load_mission(str(demo.mission))
    return mission.swarm(None) if has_hook(mission, "swarm") else demo


def run_choice_text(found: list[RunRecord]) -> str:
    """Return a text that says how to name one of these runs."""
    return "Name one: " + "; ".join(f"--swarm {run.file} ({run.what})" for run in found)


def runs_here(config: SwarmConfig) -> bool:
    """Return whether a run on this machine flies or starts this swarm."""
    return any(run.swarm == config.name for run in list_every_run())


def first_process_timeout(config: SwarmConfig) -> float:
    """Return the seconds within which the first process of this swarm must be found.

    The time is longer if a run on this machine has this swarm, because it may still be starting. It
    is 0 if all endpoints are on this machine and no process listens at any of them.
    """
    if runs_here(config):
        return SWARM_SEARCH.start_timeout
    places = [
        endpoint.partition("/")[2].rpartition(":")
        for endpoint in Addresses(config).endpoints().values()
    ]
    elsewhere = any(host != LOCAL_ADDRESS for host, _, _ in places)
    return (
        NEXT_PROCESS_TIMEOUT
        if elsewhere or any(_listens(int(port)) for _, _, port in places)
        else 0.0
    )


def no_agent_error(config: SwarmConfig, option: str | None) -> Refused:
    """Return the error for a swarm without a process that can be found."""
    others = list_own_runs()
    if any(run.swarm == config.name for run in others):
        return Refused(
            f"swarm {config.name}", f"no agent found {_at(config)}: {NOT_STARTED_HINT}"
        )
    if others:
        return Refused(
            f"swarm {config.name}",
            f"no agent found {_at(config)}; is it running? {run_choice_text(others)}",
        )
    if option is None and not Path(LOCAL_SWARM_FILE).is_file():
        do = "start one with `crazychoir run ...`, or name it with --swarm FILE"
        return Refused("crazychoir", f"no swarm of yours runs here: {do}")
    return Refused(
        f"swarm {config.name}", f"no agent found {_at(config)}; is it running?"
    )


def starting_text(config: SwarmConfig, seconds: float) -> str:
    """Return the text shown while the first drone is awaited, for up to `seconds`."""
    return (
        f"swarm {config.name} is starting: waiting for its drones, up to {seconds:g} s"
    )


def _at(config: SwarmConfig) -> str:
    """Return where the swarm was searched, as a text."""
    first, *more = Addresses(config).endpoints().values()
    return f"at {first}{' ...' if more else ''}"


def _listens(port: int) -> bool:
    """Return whether a process of this machine accepts connections at this port."""
    try:
        with socket.create_connection(
            (LOCAL_ADDRESS, port), SWARM_SEARCH.probe_timeout
        ):
            return True
    except OSError:
        return False
