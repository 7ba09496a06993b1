"""crazychoir-mocap: the process that receives motion capture for the drones of a swarm.

The agents of these drones run in other processes.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.cli.fly.process_command import (
    announce_process,
    begin_process,
    run_to_report,
)
from crazychoir.errors import ConfigError
from crazychoir.launch.console import LiveTable
from crazychoir.launch.process import ending

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig

app = typer.Typer(add_completion=False)
SourceOption = Annotated[
    str | None,
    typer.Option(
        "--source",
        help="Instead of the swarm file's, as vicon or vicon@10.0.0.5; a .csv is replayed.",
    ),
]


@app.command()
def mocap(
    swarm: Annotated[
        str | None, typer.Option(help="Swarm file; else ./swarm.toml.")
    ] = None,
    source: SourceOption = None,
    record: Annotated[
        Path | None, typer.Option(help="New CSV file to record the poses into.")
    ] = None,
    listen: Annotated[
        str | None, typer.Option(help="Zenoh endpoint to listen on.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object at the end.")
    ] = False,
    child: Annotated[
        bool,
        typer.Option(
            hidden=True, help="End when the parent has ended and no drone flies."
        ),
    ] = False,
) -> None:
    """Send each drone of a swarm its pose. Ctrl-C ends it as soon as no drone has an agent."""
    begin_process(child)
    from crazychoir.config.swarm_config import find_swarm
    from crazychoir.launch.process.mocap_process import (
        build_mocap_table,
        run_mocap,
    )  # takes 1 s, which --help does not need

    def run() -> dict[str, Any]:
        config, which = find_swarm(swarm)
        config = with_source(config, source)
        seen = list(config.topology.seen)
        what = f"swarm {config.name} ({which}): the cameras of drone(s) {seen}"
        announce_process(what, as_json, child)
        is_shown = not as_json and not child and sys.stderr.isatty()
        with LiveTable(build_mocap_table, enabled=is_shown) as progress:
            return run_mocap(config, listen, record, progress if is_shown else None)

    run_to_report(run, as_json)


def with_source(config: "SwarmConfig", source: str | None) -> "SwarmConfig":
    """Return the swarm with another source of motion capture.

    source: SYSTEM, SYSTEM@HOST, SYSTEM@HOST:PORT (port for "virtual"), or a .csv file to replay
    Raises ConfigError for a port that is not from 1 to 65535.
    """
    if source is None:
        return config
    from msgspec import to_builtins  # --help does not need it

    changes: dict[str, Any] = to_builtins(config.mocap)
    if source.lower().endswith(".csv"):
        changes |= {"source": "replay", "file": str(Path(source).resolve())}
    else:
        changes["source"], _, place = source.partition("@")
        name, port = host_and_port(place)
        changes |= {"hostname": name} if name else {}
        if port and not (
            port.isascii()
            and port.isdecimal()
            and len(port) < 6
            and 1 <= int(port) <= 65535
        ):
            allowed = "SYSTEM, SYSTEM@HOST or virtual@HOST:PORT, with a port of 1 to 65535, or a .csv file"
            raise ConfigError("--source", source, allowed)
        changes |= {"port": int(port)} if port else {}
    return config.replace(mocap=changes)


def host_and_port(text: str) -> tuple[str, str]:
    """Return the two parts of HOST:PORT or [IPv6]:PORT.

    The port is empty if there is none, also for an IPv6 address without brackets.
    """
    if text.startswith("["):
        host, _, rest = text[1:].partition("]")
        return host, rest.removeprefix(":")
    if text.count(":") > 1:
        return text, ""
    host, _, port = text.partition(":")
    return host, port


def main() -> None:
    """Run the command line."""
    ending.run_to_exit(app)


if __name__ == "__main__":
    main()
