"""crazychoir-radio: the process that owns a dongle.

The agents of its drones run in other processes.
"""

from typing import Annotated

import typer

from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ERROR_CONSOLE,
    exit_with_error,
    set_up_logging,
    write_json,
)
from crazychoir.launch.process import ending

app = typer.Typer(add_completion=False)


@app.command()
def radios(
    dongle: Annotated[
        int,
        options.whole(
            "Number of the dongle, as in the uris or keys of its drones.",
            least=0,
            most=15,
        ),
    ] = 0,
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
    """Own a dongle and the links to all its drones. Ctrl-C ends it as soon as no drone flies."""
    if child:
        ending.end_after_parent()
    set_up_logging()
    from crazychoir.cli.shared.chosen_swarm import (
        chosen_swarm,
    )  # takes 1 s, which --help does not need
    from crazychoir.launch.process.process import run_radios

    try:
        config, which = chosen_swarm(swarm)
        if dongle not in config.dongles:
            names = (
                ", ".join(map(str, config.dongles))
                or "none: no drone has a uri udp:// or radio://"
            )
            raise ConfigError(
                f"{which}: dongle",
                dongle,
                names,
                "Name one of them, or correct the uris.",
            )
        if not as_json and not child:
            ERROR_CONSOLE.print(
                f"swarm {config.name} ({which}), dongle {dongle}, drone(s) {list(config.dongles[dongle])}"
            )
        report = run_radios(config, dongle, listen)
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
