"""crazychoir-radio: the process that owns a dongle.

The agents of its drones run in other processes.
"""

from typing import Annotated, Any

import typer

from crazychoir.cli.fly.process_command import (
    announce_process,
    begin_process,
    run_to_report,
)
from crazychoir.errors import ConfigError
from crazychoir.launch import number_options as options
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
    begin_process(child)
    from crazychoir.cli.shared.chosen_swarm import (
        chosen_swarm,
    )  # takes 1 s, which --help does not need
    from crazychoir.launch.process.process import run_radios

    def run() -> dict[str, Any]:
        config, which = chosen_swarm(swarm)
        dongles = config.topology.dongles
        if dongle not in dongles:
            names = (
                ", ".join(map(str, dongles))
                or "none: no drone has a uri udp:// or radio://"
            )
            raise ConfigError(
                f"{which}: dongle",
                dongle,
                names,
                "Name one of them, or correct the uris.",
            )
        ids = list(dongles[dongle])
        what = f"swarm {config.name} ({which}), dongle {dongle}, drone(s) {ids}"
        announce_process(what, as_json, child)
        return run_radios(config, dongle, listen)

    run_to_report(run, as_json)


def main() -> None:
    """Run the command line."""
    ending.run_to_exit(app)


if __name__ == "__main__":
    main()
