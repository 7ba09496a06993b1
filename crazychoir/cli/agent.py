"""crazychoir-agent: one drone of a swarm, or a few, in this process."""

import ctypes
import json
import logging
import signal
import sys
from typing import Annotated, Any

import typer

from crazychoir.cli.show import STDERR, fail, result_table, set_up_logging
from crazychoir.errors import CrazyChoirError

log = logging.getLogger(__name__)
PR_SET_PDEATHSIG = 1
app = typer.Typer(add_completion=False)


@app.command()
def agent(
    ids: Annotated[list[int], typer.Option("--id", help="Drone to fly; several times for several drones.")],
    swarm: Annotated[str | None, typer.Option(help="Swarm file; else ./swarm.toml, else the demo swarm.")] = None,
    mission: Annotated[str | None, typer.Option(help="Mission, instead of the swarm file's.")] = None,
    loss: Annotated[float | None, typer.Option(help="Share of messages between drones that is lost.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the swarm file's.")] = None,
    force: Annotated[bool, typer.Option(help="Fly a formation that is very slow.")] = False,
    listen: Annotated[str | None, typer.Option(help="Zenoh endpoint to listen on.")] = None,
    connect: Annotated[list[str] | None, typer.Option(help="Zenoh endpoint to connect to; several times.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    child: Annotated[bool, typer.Option(hidden=True)] = False,
) -> None:
    """Fly drones of a swarm; Ctrl-C lands them."""
    if child:
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGHUP)
    set_up_logging()
    from crazychoir.cli.chosen import configured  # kernels and network: 1 s that --help does not need
    from crazychoir.cli.process import run_agent
    from crazychoir.guidance.mission import has, load

    try:
        config, which = configured(swarm, mission, loss, seed)
        flown = load(str(config.mission))
        members = tuple(sorted({config.drone(i).id: None for i in ids}))
        warned = flown.check(config, force) if has(flown, "check") else []
        if not as_json:
            STDERR.print(f"swarm {config.name} ({which}), mission {config.mission}, drone(s) {ids}")
        for text in warned:
            log.warning("%s", text)
        results = run_agent(config, flown, members, listen, connect)
    except CrazyChoirError as error:
        fail(error, as_json)
    show(results, as_json)
    raise typer.Exit(0 if all(r.get("success") for r in results["results"].values()) else 1)


def show(results: dict[str, Any], as_json: bool) -> None:
    """The result of this process."""
    if as_json:
        sys.stdout.write(json.dumps(results, default=str) + "\n")
    else:
        STDERR.print(result_table(results["results"]))


def main() -> None:
    """Entry point."""
    app()


if __name__ == "__main__":
    main()
