"""crazychoir keys: make the authority of a lab and a certificate for each of its hosts."""

from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.table import Table

from crazychoir.bus.network import CERTIFICATE_DAYS
from crazychoir.errors import ConfigError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import ANSWER_CONSOLE, exit_with_error, write_json

app = typer.Typer(
    help="Make and revoke certificates of the hosts of a swarm.",
    no_args_is_help=True,
)
Folder = Annotated[
    Path,
    typer.Option(
        "--folder", help="Folder of the certificates; in swarm files: security.keys."
    ),
]
Days = Annotated[
    int, options.whole("Days for which the certificates are valid.", most=36_500)
]
Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object, nothing else.")
]
KEYS_FOLDER = Path("keys")
RESTART_NOTE = "It counts for a process from its next start: copy each folder to its host, then restart all programs."


@app.command()
def init(
    folder: Folder = KEYS_FOLDER, days: Days = CERTIFICATE_DAYS, as_json: Json = False
) -> None:
    """Make an authority, once for a lab. Its key stays on this machine."""
    from crazychoir.bus.network import authority

    try:
        certificate = authority.make_authority(folder, days)
    except (ConfigError, OSError) as error:
        _fail(error, folder, as_json)
    _say(
        {"success": True, "authority": certificate},
        f"{certificate}: keep {certificate.parent} secret",
        as_json,
    )


@app.command()
def add(
    host: Annotated[
        str,
        typer.Argument(help="Its name, as in the table hosts or security.operators."),
    ],
    folder: Folder = KEYS_FOLDER,
    days: Days = CERTIFICATE_DAYS,
    as_json: Json = False,
) -> None:
    """Give a host, or an operator, a certificate."""
    from crazychoir.bus.network import authority

    try:
        own = authority.add_host(folder, host, days)
    except (ConfigError, OSError) as error:
        _fail(error, folder, as_json)
    do = f"{own}: copy it to {host}, to where the swarm file there has its {folder.name}/"
    _say({"success": True, "folder": own}, do, as_json)


@app.command()
def revoke(
    host: Annotated[str, typer.Argument(help="Host to exclude.")],
    folder: Folder = KEYS_FOLDER,
    days: Days = CERTIFICATE_DAYS,
    as_json: Json = False,
) -> None:
    """Exclude a host.

    All others get a new authority and new certificates, which count from their
    next start.
    """
    from crazychoir.bus.network import authority

    try:
        others = authority.revoke_host(folder, host, days)
    except (ConfigError, OSError) as error:
        _fail(error, folder, as_json)
    text = (
        f"{host} is out; new: {', '.join(others) or 'no host is left'}. {RESTART_NOTE}"
    )
    _say(
        {"success": True, "revoked": host, "new": others, "effective": "next start"},
        text,
        as_json,
    )


@app.command(name="list")
def held(folder: Folder = KEYS_FOLDER, as_json: Json = False) -> None:
    """List the hosts that have a certificate, and how long it is valid."""
    from crazychoir.bus.network import authority
    from crazychoir.runtime.clock import date_and_time

    try:
        found = authority.certified_hosts(folder)
    except (ConfigError, OSError) as error:
        _fail(error, folder, as_json)
    if as_json:
        write_json(
            {
                "success": True,
                "holders": {one.name: one.until.isoformat() for one in found},
            }
        )
        return
    table = Table("host", "good until", "days left")
    now = date_and_time()
    for one in found:
        table.add_row(one.name, f"{one.until:%Y-%m-%d}", str((one.until - now).days))
    ANSWER_CONSOLE.print(table)


def _fail(error: Exception, folder: Path, as_json: bool) -> NoReturn:
    if not isinstance(error, ConfigError):
        error = ConfigError(
            "--folder", str(folder), "a folder to write to", problem=str(error)
        )
    exit_with_error(error, as_json)


def _say(told: dict[str, Any], text: str, as_json: bool) -> None:
    if as_json:
        write_json(told)
    else:
        ANSWER_CONSOLE.print(text, markup=False, highlight=False, soft_wrap=True)
