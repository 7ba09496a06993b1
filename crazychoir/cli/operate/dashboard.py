"""crazychoir dashboard: the operator's web page of a running swarm."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crazychoir.cli.operate.inspect import SwarmOption, run_as_observer
from crazychoir.errors import ConfigError
from crazychoir.files.text_files import read_text
from crazychoir.launch import number_options as options
from crazychoir.launch.console import ERROR_CONSOLE, exit_with_error

if TYPE_CHECKING:
    from crazychoir.launch.observer import Window

LOOPBACK_ADDRESS = "127.0.0.1"
"""Address of the loopback."""
PASSWORD_VARIABLE = "CRAZYCHOIR_PASSWORD"  # noqa: S105 - the name of a variable
DASHBOARD_INSTALL_HINT = "the dashboard's packages: pip install 'crazychoir[dashboard]'"


def dashboard(
    swarm: SwarmOption = None,
    host: Annotated[
        str,
        typer.Option(
            help="Address to serve at; any address but loopback needs a password or an authority."
        ),
    ] = LOOPBACK_ADDRESS,
    port: Annotated[
        int | None, options.whole("Else the first free one from 8765 on.", most=65535)
    ] = None,
    password_file: Annotated[
        Path | None,
        typer.Option(
            help=f"File with the password of the page; or in ${PASSWORD_VARIABLE}."
        ),
    ] = None,
    certificate: Annotated[
        Path | None, typer.Option(help="PEM file, for https; with --key.")
    ] = None,
    key: Annotated[Path | None, typer.Option(help="PEM file of its key.")] = None,
    authority: Annotated[
        Path | None,
        typer.Option(
            help="PEM file of an authority: only browsers with a certificate signed by it may connect."
        ),
    ] = None,
) -> None:
    """Serve the operator's web page: view, commands, drawing, network, log.

    The swarm flies on without it.
    """
    try:
        from crazychoir.dashboard.server import PageAddress, serve
    except ImportError as error:
        exit_with_error(
            ConfigError(
                "crazychoir dashboard",
                f"no module {error.name}",
                DASHBOARD_INSTALL_HINT,
            ),
            as_json=False,
        )
    try:
        served = PageAddress(
            host, port, _password(password_file), certificate, key, authority
        )
    except ConfigError as error:
        exit_with_error(error, as_json=False)

    async def work(window: "Window") -> None:
        await serve(
            window,
            served,
            lambda text: ERROR_CONSOLE.print(
                text, markup=False, highlight=False, soft_wrap=True
            ),
        )

    try:
        run_as_observer(swarm, work)
    except KeyboardInterrupt:
        raise typer.Exit(0) from None


def _password(file: Path | None) -> str | None:
    """Return the password from the file, else from the environment; None if there is none."""
    if file is None:
        return os.environ.get(PASSWORD_VARIABLE)
    return read_text(file, "for --password-file, a text file that can be read").strip()
