"""crazychoir-agent: fly one or several drones of a swarm in this process."""

import logging
from pathlib import Path
from typing import Annotated

import typer

from crazychoir.cli.fly.process_command import begin_process
from crazychoir.cli.shared.drone_choice import parse_choice
from crazychoir.errors import CrazyChoirError, refuse_exit
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    build_result_table,
    exit_with_error,
    redirect_prints,
    write_json,
)
from crazychoir.launch.process import ending
from crazychoir.numerics.compiling import KERNEL_QUEUE

log = logging.getLogger(__name__)
app = typer.Typer(add_completion=False)


@app.command()
def agent(
    ids: Annotated[
        list[str],
        typer.Option(
            "--id",
            help="Drone to fly, by its id or name; several times for several drones.",
        ),
    ],
    swarm: Annotated[
        str | None,
        typer.Option(help="Swarm file; else ./swarm.toml, else the demo swarm."),
    ] = None,
    mission: Annotated[
        str | None, typer.Option(help="Mission, instead of the swarm file's.")
    ] = None,
    loss: Annotated[
        float | None, options.share("Share of messages between drones that is lost.")
    ] = None,
    seed: Annotated[
        int | None, options.seed("Seed, instead of the swarm file's.")
    ] = None,
    force: Annotated[
        bool, typer.Option(help="Fly a formation that is very slow.")
    ] = False,
    listen: Annotated[
        str | None, typer.Option(help="Zenoh endpoint to listen on.")
    ] = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(help="Zenoh endpoint to connect to; several times."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object.")
    ] = False,
    child: Annotated[
        Path | None,
        typer.Option(hidden=True, help="Results go there; it lands without parent."),
    ] = None,
) -> None:
    """Fly drones of a swarm; Ctrl-C lands them."""
    begin_process(child is not None)
    with KERNEL_QUEUE.checks_first():
        from crazychoir.cli.shared.chosen_swarm import (
            configured_swarm,
        )  # takes 1 s, which --help does not need
        from crazychoir.guidance.mission import check_before_flight, load_mission
        from crazychoir.launch.process.preloading import PRELOADED_SWARMS
        from crazychoir.launch.process.process import run_agent
        from crazychoir.launch.processes import write_results

    try:
        with redirect_prints(), refuse_exit("the mission"):
            with KERNEL_QUEUE.checks_first():
                config = PRELOADED_SWARMS.find(swarm) if child is not None else None
                which = str(swarm)
                if config is None:
                    config, which = configured_swarm(swarm, mission, loss, seed)
                chosen = parse_choice(",".join(ids), "--id").find(config)
                members = tuple(sorted(chosen))
                flown = load_mission(str(config.mission))
                # `run` has checked the swarm of its child processes.
                warned = (
                    check_before_flight(flown, config, force) if child is None else []
                )
            KERNEL_QUEUE.compile()
            if not as_json and child is None:
                ERROR_CONSOLE.print(
                    f"swarm {config.name} ({which}), mission {config.mission}, drone(s) {list(members)}"
                )
            for text in warned:
                log.warning("%s", text)
            flight = run_agent(config, flown, members, listen, connect)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    results = flight["results"]
    if child is not None:
        try:
            write_results(child, results)
        except CrazyChoirError as error:
            exit_with_error(error, as_json)
    elif as_json:
        write_json(flight)
    else:
        ANSWER_CONSOLE.print(build_result_table(results))
    raise typer.Exit(
        0 if all(result.get("success") for result in results.values()) else 1
    )


def main() -> None:
    """Run the command line."""
    ending.run_to_exit(app)


if __name__ == "__main__":
    main()
