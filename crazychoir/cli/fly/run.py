"""Fly a mission on this machine: `crazychoir run`."""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.errors import ConfigError, CrazyChoirError, refuse_exit
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    CommandOutputs,
    LiveTable,
    build_status_table,
    build_summary_table,
    exit_interrupted,
    exit_with_error,
    redirect_prints,
    require_drawable,
    set_up_logging,
    write_json,
)
from crazychoir.numerics.compiling import KERNEL_QUEUE

if TYPE_CHECKING:
    from crazychoir.api.flying import ChosenFlight
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.guidance.mission import Mission
    from crazychoir.launch.fork_server import ForkServer

    Progress = LiveTable[Any]


def run(
    what: Annotated[
        str,
        typer.Argument(
            help="Mission, example, mission file (.py) or swarm file (.toml)."
        ),
    ],
    drones: Annotated[
        int | None, options.size("Number of drones, if the mission allows it.")
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            help="Start only these drones of a swarm file here, as 3,4; other hosts start the rest."
        ),
    ] = None,
    processes: Annotated[
        int | None, options.size("Number of processes; else one a drone.")
    ] = None,
    fast: Annotated[
        bool,
        typer.Option(
            help="Virtual time: one process, as fast as it computes, repeatable."
        ),
    ] = False,
    loss: Annotated[
        float | None, options.share("Share of messages between drones that is lost.")
    ] = None,
    seed: Annotated[
        int | None, options.seed("Seed, instead of the swarm file's.")
    ] = None,
    swarm: Annotated[str | None, typer.Option(help="Swarm file for a mission.")] = None,
    force: Annotated[
        bool,
        typer.Option(
            help="Fly despite a warning of the mission: a slow formation, drones close together."
        ),
    ] = False,
    wait: Annotated[
        bool,
        typer.Option(
            "--wait", help="Wait for an operator: `crazychoir take-off`, then `start`."
        ),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Where to draw the picture (PNG).")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="New file to record the flight into (.mcap).")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Fly a mission on this machine; Ctrl-C lands the drones."""
    set_up_logging()
    from crazychoir.launch.fork_server import ForkServer

    # The server imports what the processes need while this process checks the swarm.
    with nullcontext() if fast else ForkServer() as server:
        with KERNEL_QUEUE.checks_first():
            # These imports take 1 s, which --help does not need.
            from crazychoir.api.flight_request import FlightRequest
            from crazychoir.api.flying import ChosenFlight, require_flyable
            from crazychoir.cli.shared.chosen_swarm import (
                check_options,
                drones_to_start,
                with_operator,
            )
            from crazychoir.cli.shared.option_names import naming_options
            from crazychoir.guidance.mission import check_before_flight, resolve_example

        what = resolve_example(what)
        outputs = CommandOutputs()
        given = {
            "--fast": fast,
            "--processes": processes,
            "--picture": picture,
            "--drones": drones,
        }
        try:
            check_options(what, swarm, only, given)
            with redirect_prints(), refuse_exit("the mission"):
                with KERNEL_QUEUE.checks_first(), naming_options():
                    request = FlightRequest(what, drones, swarm, loss, seed)
                    config, mission = request.choose()
                    config = with_operator(config, wait, fast)
                    require_drawable(picture)
                    started = drones_to_start(only, config)
                    require_flyable(config, started, fast)
                    named = {} if request.swarm_file is None else {"swarm": config.name}
                    warned = check_before_flight(mission, config, force)
                flight = ChosenFlight(
                    what, request.swarm_file, mission, started, record, only is None
                )
                with LiveTable(build_status_table, enabled=not as_json) as progress:
                    for text in (*_list_left_out(config), *warned):
                        progress.say(text)
                    config, result = _fly(flight, config, server, processes, progress)
                result["picture"] = None
                with outputs.writing("--picture"):
                    result["picture"] = _draw_requested(
                        mission, config, result, picture
                    )
                del result["tracks"]
                result = named | result | outputs.told
        except CrazyChoirError as error:
            exit_with_error(error, as_json)
        except KeyboardInterrupt:
            exit_interrupted(as_json)
        _show(result, as_json)
        outputs.say()
        raise typer.Exit(0 if result["success"] and not outputs.failed else 1)


def _fly(
    flight: "ChosenFlight",
    config: "SwarmConfig",
    server: "ForkServer | None",
    processes: int | None,
    progress: "Progress",
) -> tuple["SwarmConfig", dict[str, Any]]:
    """Fly, and show the flight; return the swarm that has flown and the result.

    server: makes the processes; None for virtual time
    processes: number of processes; None: as the swarm file says
    """
    from crazychoir.api.flying import fly_in_real_time, fly_in_virtual_time
    from crazychoir.launch.flight import FlightDisplay

    if server is None:
        return fly_in_virtual_time(flight, config, progress)

    def announce(path: Path) -> None:
        progress.say(
            f"Look into it (or echo, hz, land, stop): crazychoir status --swarm {path}"
        )

    display = FlightDisplay(progress, progress.say)
    return fly_in_real_time(server, flight, config, processes, display, announce)


def _list_left_out(config: "SwarmConfig") -> list[str]:
    """Return a text that names the drones that are left out of the run; empty if there are none."""
    if not config.left_out:
        return []
    names = ", ".join(map(str, config.left_out))
    return [f"Left out (enabled = false, or left_out): drones {names}"]


def _draw_requested(
    mission: "Mission", config: "SwarmConfig", result: dict[str, Any], path: Path | None
) -> str | None:
    """Draw the picture, if one is requested; raise ConfigError if the mission did not write it."""
    drawn = _draw_mission(mission, config, result, path)
    if path is not None and drawn is None:
        do = "The mission's own picture() draws it: see what it said above."
        raise ConfigError(
            "--picture", f"{path}, which was not drawn", "a picture by the mission", do
        )
    return drawn


def _draw_mission(
    mission: "Mission", config: "SwarmConfig", result: dict[str, Any], path: Path | None
) -> str | None:
    """Draw the picture of the mission; a mission without a picture gets the flown paths.

    Returns the path of the picture, or None if no picture is requested or the mission's own
    picture() did not write the file.
    """
    if path is None:
        return None
    from crazychoir.guidance.mission import has_hook
    from crazychoir.guidance.mission_pictures import draw_tracks

    path.parent.mkdir(parents=True, exist_ok=True)
    tracks = result["tracks"]
    flown = {i: {**r, "track": tracks[i]} for i, r in result["results"].items()}
    if has_hook(mission, "picture"):
        before = _version(path)
        mission.picture(config, flown, str(path))
        if _version(path) == before:
            return None
    else:
        draw_tracks(
            flown, path, leaders=[drone.id for drone in config.drones if drone.leader]
        )
    return str(path)


def _version(path: Path) -> tuple[int, ...] | None:
    """Return values that change when the file is written: inode, size and ns of its last change.

    Returns None if there is no file.
    """
    if not path.exists():
        return None
    about = path.stat()
    return about.st_ino, about.st_size, about.st_mtime_ns


def _show(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        write_json(result)
    else:
        ANSWER_CONSOLE.print(build_summary_table(result))
