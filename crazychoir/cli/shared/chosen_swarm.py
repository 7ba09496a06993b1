"""The swarm and the mission that a command line names."""

from typing import Any

import msgspec

from crazychoir.api.flight_request import (
    FlightRequest,
    refuse_operator,
    replace_swarm_values,
)
from crazychoir.cli.shared.drone_choice import parse_choice
from crazychoir.cli.shared.option_names import naming_options
from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig, find_swarm
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import has_hook, load_mission


def configured_swarm(
    swarm: str | None, mission: str | None, loss: float | None, seed: int | None
) -> tuple[SwarmConfig, str]:
    """Return the swarm with the values of the command line, and a text that says its source.

    swarm: path of the swarm file, None for the mission's own swarm
    mission, loss, seed: values that replace those of the swarm file, None to keep them
    Raises ConfigError if neither the file nor the command line names a mission.
    """
    config, which = chosen_swarm(swarm, mission)
    if mission is None and config.mission is None:
        raise ConfigError(
            which, "no mission", 'mission = "name" in the swarm file, or --mission'
        )
    return replace_swarm_values(config, loss, seed, mission), which


def chosen_swarm(
    swarm: str | None, mission: str | None = None
) -> tuple[SwarmConfig, str]:
    """Return the swarm of the file and a text that says where it comes from.

    Without a file this is the swarm of the mission. Without a mission it is the swarm of the
    demo's mission.
    """
    config, which = find_swarm(swarm)
    if which.startswith("the built-in demo"):
        found = load_mission(str(mission or config.mission))
        config = found.swarm(None) if has_hook(found, "swarm") else config
    return config, which


def check_options(
    what: str, swarm: str | None, only: str | None, given: dict[str, Any]
) -> None:
    """Raise ConfigError for options of `crazychoir run` that contradict each other.

    what: mission or swarm file to run
    swarm: value of --swarm
    only: value of --only
    given: value of each option that concerns a whole swarm on this machine, by option
    """
    request = FlightRequest(what, given["--drones"], swarm)
    with naming_options():
        request.require_one_source()
    if given["--fast"] and given["--processes"]:
        raise ConfigError(
            "--processes", "--fast beside it", "no --fast: virtual time is one process"
        )
    if only is not None:
        _check_only(only, what, request.has_swarm_file, given)


def _check_only(only: str, what: str, own_file: bool, given: dict[str, Any]) -> None:
    """Raise ConfigError if --only is given without a swarm file or with options for a whole swarm.

    Several computers start the drones of one swarm. They find each other by the name and the ports
    in the swarm file that they share.
    """
    if not own_file:
        allowed = "a swarm file that all hosts of the swarm share"
        do = f"For example `crazychoir run swarm.toml --only {only}`, or `crazychoir run {what} --swarm ...`."
        raise ConfigError("--only", f"{only} without a swarm file", allowed, do)
    for option, value in given.items():
        if value:
            raise ConfigError(
                "--only",
                f"{option} beside it",
                f"no {option}: it is for a whole swarm on this machine",
            )


def with_operator(config: SwarmConfig, wait: bool, fast: bool) -> SwarmConfig:
    """Return the swarm with `operator = true` if `--wait` or the swarm file asks for it.

    Raises ConfigError for `--wait` with --fast: no operator can command a swarm in virtual time.
    """
    if wait and fast:
        with naming_options():
            raise refuse_operator("--wait")
    waits = wait or config.flight.operator
    return (
        config.replace(flight={**msgspec.to_builtins(config.flight), "operator": True})
        if waits
        else config
    )


def drones_to_start(only: str | None, config: SwarmConfig) -> tuple[int, ...]:
    """Return the drones that `--only` names; all drones without it.

    Raises ConfigError unless they are whole processes of the swarm file: each process has a single
    endpoint.
    """
    if only is None:
        return config.ids
    here = sorted(parse_choice(only, "--only").find(config))
    for group in Addresses(config).groups():
        if not (set(group) <= set(here) or set(group).isdisjoint(here)):
            do = "Name all of them or none, or correct `processes` in the swarm file."
            raise ConfigError(
                "--only",
                only,
                f"drones {', '.join(map(str, group))} share a process",
                do,
            )
    return tuple(here)
