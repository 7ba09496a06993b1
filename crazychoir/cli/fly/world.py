"""crazychoir-world: the process that owns a simulated world.

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
    begin_process(child)
    from crazychoir.cli.shared.chosen_swarm import (
        chosen_swarm,
    )  # takes 1 s, which --help does not need
    from crazychoir.launch.process.process import run_world

    def run() -> dict[str, Any]:
        config, which = chosen_swarm(swarm)
        owned = config.topology.owned
        if not owned:
            allowed = "a swarm with a world that has an owner"
            do = 'Write owned = true into [world], or uri = "sim://motors" into its [[drones]].'
            raise ConfigError(which, "drones that fly in their agents", allowed, do)
        what = f"swarm {config.name} ({which}), the world of drone(s) {list(owned)}"
        announce_process(what, as_json, child)
        return run_world(config, listen)

    run_to_report(run, as_json)


def main() -> None:
    """Run the command line."""
    ending.run_to_exit(app)


if __name__ == "__main__":
    main()
