"""crazychoir-world: the process that owns a simulated world.

The agents of its drones run in other processes.
"""

from typing import Annotated

import typer

from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch.console import (
    ERROR_CONSOLE,
    exit_with_error,
    set_up_logging,
    write_json,
)
from crazychoir.launch.process import ending

app = typer.Typer(add_completion=False)


@app.command()
def world(
    swarm: Annotated[
        str | None, typer.Option(help="Swarm file; else ./swarm.toml.")
    ] = None,
    listen: Annotated[
        str | None, typer.Option(help="Zenoh endpoint to listen on.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object.")
    ] = False,
    child: Annotated[
        bool,
        typer.Option(
            hidden=True, help="End when the parent has ended and no drone flies."
        ),
    ] = False,
) -> None:
    """Own the simulated world of a swarm. Ctrl-C ends it as soon as no drone flies."""
    if child:
        ending.end_after_parent()
    set_up_logging()
    from crazychoir.cli.shared.chosen_swarm import (
        chosen_swarm,
    )  # takes 1 s, which --help does not need
    from crazychoir.launch.process.process import run_world

    try:
        config, which = chosen_swarm(swarm)
        if not config.owned:
            allowed = "a swarm with a world that has an owner"
            do = 'Write owned = true into [world], or uri = "sim://motors" into its [[drones]].'
            raise ConfigError(which, "drones that fly in their agents", allowed, do)
        if not as_json and not child:
            ERROR_CONSOLE.print(
                f"swarm {config.name} ({which}), the world of drone(s) {list(config.owned)}"
            )
        report = run_world(config, listen)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    if as_json:
        write_json(report)
    raise typer.Exit(0 if report["success"] else 1)


def main() -> None:
    """Run the command line."""
    ending.run_to_exit(app)


if __name__ == "__main__":
    main()
