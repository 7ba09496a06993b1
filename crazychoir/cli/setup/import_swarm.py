"""crazychoir import: a swarm of Crazyswarm2 as a swarm file."""

import re
from pathlib import Path
from typing import Annotated

import typer

from crazychoir.cli.operate.inspect import JsonOption
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    exit_with_error,
    set_up_logging,
    write_json,
)


def import_swarm(
    file: Annotated[Path, typer.Argument(help="crazyflies.yaml of Crazyswarm2.")],
    mocap: Annotated[Path | None, typer.Option(help="Its motion_capture.yaml.")] = None,
    server: Annotated[Path | None, typer.Option(help="Its server.yaml.")] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Swarm file to write.")
    ] = Path("swarm.toml"),
    virtual: Annotated[
        bool,
        typer.Option(
            "--virtual", help="Write uris of virtual drones, to try the swarm."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a swarm file from the configuration of Crazyswarm2.

    What has no equivalent is listed, with file and key, and stands at the end
    of the swarm file. Exits with 0 only if the swarm file is complete.
    """
    set_up_logging()
    from crazychoir.cli.setup import crazyswarm_swarm as crazyswarm
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.files.output_files import output_file, require_writable_file

    problem = ""
    try:
        require_writable_file(out, "--out", (".toml",))
        files = crazyswarm.SourceFiles(file, mocap, server)
        name = re.sub(r"[^a-z0-9_-]", "_", out.stem.lower())[:40]
        swarm = crazyswarm.import_swarm(files, name, virtual)
        text = swarm.format(files)
        with output_file(out, "--out") as place:
            place.write_text(text, encoding="utf-8")
        try:
            config = SwarmConfig.loads(text, str(out))
            flown = list(config.ids)
        except ConfigError as error:
            flown = []
            problem = str(error)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    if as_json:
        told = {"file": out, "flown": flown, "not_taken_over": swarm.remarks.lines}
        write_json({"success": not problem, "problem": problem, **told})
    else:
        for line in swarm.remarks.lines:
            ANSWER_CONSOLE.print(line, markup=False, highlight=False, soft_wrap=True)
        rows = len(swarm.drones)
        ANSWER_CONSOLE.print(
            f"{out}: {rows} drones, {len(flown)} of them enabled",
            highlight=False,
            soft_wrap=True,
        )
        if problem:
            ERROR_CONSOLE.print(f"To do: {problem}", markup=False, soft_wrap=True)
    raise typer.Exit(1 if problem else 0)
