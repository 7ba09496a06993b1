"""The swarm that a command beside it means, and how long its drones may take to be found."""

import socket
from pathlib import Path

from crazychoir.config.swarm_config import LOCAL, SwarmConfig, find_swarm
from crazychoir.errors import Refused
from crazychoir.launch.run_registry import Run, every_run, of_file, runs

LOCAL_FILE = "swarm.toml"
DISCOVERY = 4.0
"""s to find the processes of a swarm, from the last one that was found."""
STARTS = 180.0
"""s that a run of this machine gets until the first of them is there: it may have to compile its laws first."""
LOOK = 0.02
"""s between two looks at who is there."""
SOON = 2.0
"""s after which it is said that somebody is waited for."""
PROBE = 0.5
"""s within which a process of this machine takes a connection."""
NOT_YET = (
    "its run has not started them yet (a first run compiles its laws for a minute or two), "
    "or is ending; try again."
)


def running_swarm(option: str | None) -> SwarmConfig:
    """The swarm to look into: the run of that swarm file; else the swarm of the file itself, started by its agents.

    Without a file, that of ./swarm.toml; without that, the only run of this user, else the demo swarm, if its agents
    are there. Raises Refused if several runs could be meant, or none.
    """
    file = option or (LOCAL_FILE if Path(LOCAL_FILE).is_file() else None)
    found = runs() if file is None else of_file(file)
    if len(found) > 1:
        raise Refused(
            file or "crazychoir",
            f"several of your runs could be meant. {choose(found)}",
        )
    if found or file is not None:
        return SwarmConfig.load(found[0].file if found else str(file))
    if patience(demo := find_swarm()[0]) == 0.0:
        raise nobody(demo, None)
    from crazychoir.cli.shared.chosen_swarm import (
        chosen_swarm,
    )  # missions: 1 s that others need not wait

    return chosen_swarm(None)[0]


def choose(found: list[Run]) -> str:
    """How to name one of them."""
    return "Name one: " + "; ".join(f"--swarm {run.file} ({run.what})" for run in found)


def runs_here(config: SwarmConfig) -> bool:
    """Whether a run of this machine flies, or starts, this swarm."""
    return any(run.swarm == config.name for run in every_run())


def patience(config: SwarmConfig) -> float:
    """s until the first process of this swarm must be found: longer where a run is starting it, 0 if nobody is there.

    Who has no process on this machine that would listen, but on others, may be there all the same.
    """
    if runs_here(config):
        return STARTS
    places = [
        endpoint.partition("/")[2].rpartition(":")
        for endpoint in config.endpoints().values()
    ]
    elsewhere = any(host != LOCAL for host, _, _ in places)
    return (
        DISCOVERY
        if elsewhere or any(_listens(int(port)) for _, _, port in places)
        else 0.0
    )


def nobody(config: SwarmConfig, option: str | None) -> Refused:
    """The error of who finds no process of this swarm."""
    others = runs()
    if any(run.swarm == config.name for run in others):
        return Refused(
            f"swarm {config.name}", f"no agent found {_at(config)}: {NOT_YET}"
        )
    if others:
        return Refused(
            f"swarm {config.name}",
            f"no agent found {_at(config)}; is it running? {choose(others)}",
        )
    if option is None and not Path(LOCAL_FILE).is_file():
        do = "start one with `crazychoir run ...`, or name it with --swarm FILE"
        return Refused("crazychoir", f"no swarm of yours runs here: {do}")
    return Refused(
        f"swarm {config.name}", f"no agent found {_at(config)}; is it running?"
    )


def starting(config: SwarmConfig, seconds: float) -> str:
    """What is said while nobody is there yet, who gets so many s."""
    return (
        f"swarm {config.name} is starting: waiting for its drones, up to {seconds:g} s"
    )


def _at(config: SwarmConfig) -> str:
    """Where it was looked for."""
    first, *more = config.endpoints().values()
    return f"at {first}{' ...' if more else ''}"


def _listens(port: int) -> bool:
    """Whether anybody takes a connection there, on this machine."""
    try:
        with socket.create_connection((LOCAL, port), PROBE):
            return True
    except OSError:
        return False
