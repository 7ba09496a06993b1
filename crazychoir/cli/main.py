"""crazychoir: fly missions, solve instances, inspect and command a running swarm."""

import time
from contextlib import nullcontext
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.cli.compute import simulate, solve
from crazychoir.cli.fly import missions, virtual
from crazychoir.cli.operate import dashboard, orders, param, task
from crazychoir.cli.operate import go_to as steer
from crazychoir.cli.operate import inspect as look
from crazychoir.cli.recordings import convert, plot, record, render, replay, rerun, ros
from crazychoir.cli.setup import (
    doctor,
    identify,
    keys,
    push,
    radio,
    rigid_bodies,
    router,
)
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
from crazychoir.launch.process import ending
from crazychoir.numerics.compiling import KERNEL_QUEUE

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.guidance.mission import Mission

app = typer.Typer(add_completion=False, no_args_is_help=True)
FLY_PANEL = "Fly"
OPERATE_PANEL = "Operate a running swarm"
RECORDING_PANEL = "Work with recordings"
COMPUTE_PANEL = "Compute without flight"
SETUP_PANEL = "Set up hosts and drones"


def _print_version(wanted: bool) -> None:
    if wanted:
        ANSWER_CONSOLE.print(f"crazychoir {version('crazychoir')}", highlight=False)
        raise typer.Exit


@app.callback()
def crazychoir(
    tell: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=_print_version, help="Tell it and end."
        ),
    ] = False,
) -> None:
    """Swarms of drones that optimise and fly together."""


def bench(context: typer.Context) -> None:
    """Measure speed and accuracy, beside other programs in the same run."""
    # The import takes 1 s, for which other commands need not wait.
    from crazychoir.cli.compute.bench import (
        app as benches,
    )

    benches(context.args, prog_name=context.command_path)


def run(
    what: Annotated[
        str,
        typer.Argument(
            help="Mission in agents/, mission file (.py) or swarm file (.toml)."
        ),
    ],
    drones: Annotated[
        int | None, options.size("So many drones, if the mission can.")
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            help="Start only these drones of a swarm file here, as 3,4; others start the rest."
        ),
    ] = None,
    processes: Annotated[
        int | None, options.size("So many processes (else one a drone).")
    ] = None,
    fast: Annotated[
        bool,
        typer.Option(help="Virtual time: one process, as fast as it goes, repeatable."),
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
        typer.Option(help="Fly what the mission warns of: slow formations, crowds."),
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
    with KERNEL_QUEUE.checks_first():
        from crazychoir.cli.shared.chosen_swarm import (  # takes 1 s, which --help does not need
            check_options,
            drones_to_start,
            resolve_swarm_file,
            swarm_and_mission_to_run,
            with_operator,
        )
        from crazychoir.guidance.mission import check_before_flight
        from crazychoir.launch.extras import require_extras
        from crazychoir.launch.flight import (
            fly_fast,
            fly_real,
            list_dongles,
            list_owners,
        )
        from crazychoir.launch.network import hold_isolated_swarm, write_swarm_file
        from crazychoir.launch.recording import open_recording_file
        from crazychoir.launch.run_registry import RunRecord, record_run
        from crazychoir.radio.link.ownership import require_free

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
            with KERNEL_QUEUE.checks_first():
                config, mission = swarm_and_mission_to_run(
                    what, drones, swarm, loss, seed
                )
                config = with_operator(config, wait, fast)
                require_drawable(picture)
                started = drones_to_start(only, config)
                source = resolve_swarm_file(what, swarm)
                require_extras(
                    config, [] if fast else list_owners(config, started), fast
                )
                if not fast:
                    require_free(config, list_dongles(config, started))
                named = {} if source is None else {"swarm": config.name}
                warned = check_before_flight(mission, config, force)
            began = time.perf_counter()
            KERNEL_QUEUE.compile()
            compiled_s = time.perf_counter() - began
            with LiveTable(build_status_table, enabled=not as_json) as progress:
                for text in warned:
                    progress.say(text)
                as_it_is = fast or only is not None
                own = (
                    nullcontext(config)
                    if as_it_is
                    else hold_isolated_swarm(config, processes, keeps_port=True)
                )
                with (
                    own as config,
                    open_recording_file(record, config, mission, virtual=fast) as file,
                ):
                    if fast:
                        result = fly_fast(config, mission, progress, file)
                    else:
                        with (
                            write_swarm_file(config) as path,
                            record_run(RunRecord(config.name, what, source, str(path))),
                        ):
                            progress.say(
                                f"Look into it (or echo, hz, land, stop): crazychoir status --swarm {path}"
                            )
                            flags = ["--force"] if force else []
                            result = fly_real(
                                path,
                                config,
                                mission,
                                flags,
                                progress,
                                progress.say,
                                started,
                                file,
                            )
            result["startup_s"] += compiled_s
            result["picture"] = None
            with outputs.writing("--picture"):
                result["picture"] = _draw_mission(mission, config, result, picture)
                if picture is not None and result["picture"] is None:
                    do = "The mission's own picture() draws it: see what it said above."
                    raise ConfigError(
                        "--picture",
                        f"{picture}, which was not drawn",
                        "a picture by the mission",
                        do,
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


# The commands in the order of the help, group by group ---------------------------------

app.command(rich_help_panel=FLY_PANEL)(run)
app.command(rich_help_panel=FLY_PANEL)(missions.missions)
app.add_typer(virtual.app, name="virtual", rich_help_panel=FLY_PANEL)

app.command(rich_help_panel=OPERATE_PANEL)(dashboard.dashboard)
app.command(rich_help_panel=OPERATE_PANEL)(look.topics)
app.command(rich_help_panel=OPERATE_PANEL)(look.echo)
app.command(rich_help_panel=OPERATE_PANEL)(look.hz)
app.command(rich_help_panel=OPERATE_PANEL)(look.status)
app.command(rich_help_panel=OPERATE_PANEL)(look.impair)
app.command(rich_help_panel=OPERATE_PANEL)(orders.stop)
for verb in orders.ORDER_HELP:
    order = orders.make_order_command(verb, orders.ORDER_TIMEOUTS[verb])
    app.command(name=verb, rich_help_panel=OPERATE_PANEL)(order)
app.command(name="go-to", rich_help_panel=OPERATE_PANEL)(steer.go_to)
app.command(rich_help_panel=OPERATE_PANEL)(steer.fly)
app.add_typer(param.app, name="param", rich_help_panel=OPERATE_PANEL)
app.add_typer(task.app, name="task", rich_help_panel=OPERATE_PANEL)

app.command(rich_help_panel=RECORDING_PANEL)(plot.plot)
app.command(rich_help_panel=RECORDING_PANEL)(render.render)
app.command(rich_help_panel=RECORDING_PANEL)(rerun.rerun)
app.command(rich_help_panel=RECORDING_PANEL)(convert.convert)
app.command(rich_help_panel=RECORDING_PANEL)(ros.ros)
app.command(rich_help_panel=RECORDING_PANEL)(record.record)
app.command(rich_help_panel=RECORDING_PANEL)(replay.replay)

app.command(rich_help_panel=COMPUTE_PANEL)(solve.solve)
app.command(rich_help_panel=COMPUTE_PANEL)(simulate.simulate)
app.command(
    rich_help_panel=COMPUTE_PANEL,
    add_help_option=False,
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
)(bench)

app.command(rich_help_panel=SETUP_PANEL)(identify.identify)
app.command(rich_help_panel=SETUP_PANEL)(doctor.doctor)
app.command(rich_help_panel=SETUP_PANEL)(router.router)
app.command(rich_help_panel=SETUP_PANEL)(push.push)
app.add_typer(keys.app, name="keys", rich_help_panel=SETUP_PANEL)
app.add_typer(radio.app, name="radio", rich_help_panel=SETUP_PANEL)
app.add_typer(rigid_bodies.app, name="mocap", rich_help_panel=SETUP_PANEL)


def main() -> None:
    """Run the command line."""
    ending.run_to_exit(app)


if __name__ == "__main__":
    main()
