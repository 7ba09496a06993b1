"""crazychoir foxglove: serve a running swarm to Foxglove, over its WebSocket protocol."""

import json
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crazychoir.cli.operate.inspect import SwarmOption, run_as_observer
from crazychoir.errors import ConfigError
from crazychoir.files.output_files import output_file, require_writable_file
from crazychoir.launch import number_options as options
from crazychoir.launch.console import ERROR_CONSOLE, exit_with_error

if TYPE_CHECKING:
    from crazychoir.launch.observer import Window

FOXGLOVE_INSTALL_HINT = "the SDK of Foxglove: pip install 'crazychoir[foxglove]'"
FOXGLOVE_PORT = 8765
"""Port that Foxglove suggests."""
KEY_BYTES = 6
"""Random bytes in the key of the commands."""
LAYOUT_MODE = 0o600
"""Permissions of a layout: it may hold the key of the commands."""


def foxglove(
    swarm: SwarmOption = None,
    port: Annotated[
        int, options.whole("Port here; 0 for a free one.", least=0, most=65535)
    ] = FOXGLOVE_PORT,
    rate: Annotated[
        float,
        options.real("Transforms and states a second.", least=0.5, most=100.0),
    ] = 20.0,
    commands: Annotated[
        bool, typer.Option(help="Accept commands that have the key that is printed.")
    ] = False,
    layout: Annotated[
        Path | None,
        typer.Option(
            help="Write a layout of Foxglove's panels into this file (.json)."
        ),
    ] = None,
) -> None:
    """Show a running swarm in Foxglove.

    Serves transforms, a scene, states, status and log to this machine alone.
    The swarm flies on without it.
    """
    try:
        from crazychoir.bridges.foxglove_stream import serve_foxglove
    except ImportError as error:
        exit_with_error(
            ConfigError(
                "crazychoir foxglove",
                f"no module {error.name}",
                FOXGLOVE_INSTALL_HINT,
            ),
            as_json=False,
        )
    key = secrets.token_urlsafe(KEY_BYTES) if commands else None

    async def work(window: "Window") -> None:
        if key is not None:
            window.require_operator()
        if layout is not None:
            write_layout(layout, window.config.ids, key or "")
        await serve_foxglove(
            window,
            port,
            rate,
            key,
            lambda text: ERROR_CONSOLE.print(
                text, markup=False, highlight=False, soft_wrap=True
            ),
        )

    try:
        if layout is not None:
            require_writable_file(layout, "--layout", (".json",))
        run_as_observer(swarm, work)
    except ConfigError as error:
        exit_with_error(error, as_json=False)
    except KeyboardInterrupt:
        raise typer.Exit(0) from None


def write_layout(path: Path, drones: tuple[int, ...], key: str) -> None:
    """Write the layout for these drones; raise ConfigError if it cannot be written."""
    from crazychoir.bridges.foxglove_layout import make_layout

    with output_file(path, "layout") as place:
        text = json.dumps(make_layout(drones, key), indent=2)
        place.write_text(text + "\n", encoding="utf-8")
        place.chmod(LAYOUT_MODE)
