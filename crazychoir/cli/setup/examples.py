"""crazychoir examples: the swarm files that come with the package."""

from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.table import Table

from crazychoir.cli.operate.inspect import JsonOption
from crazychoir.cli.setup.new_files import write_new_files
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.files.examples import list_copies, list_examples, require_example
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    exit_with_error,
    set_up_logging,
    write_json,
)


def examples(
    name: Annotated[
        str | None, typer.Argument(help="Example: show its swarm file.")
    ] = None,
    copy: Annotated[
        bool,
        typer.Option(
            "--copy", help="Copy its files into this folder, to be changed there."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """List the swarm files that come with the package; `crazychoir run NAME` flies one."""
    set_up_logging()
    try:
        if name is not None:
            _show_example(name, copy, as_json)
        elif copy:
            raise ConfigError("--copy", "no example", "crazychoir examples NAME --copy")
        else:
            _show_examples(as_json)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)


def _show_examples(as_json: bool) -> None:
    summaries = list_examples()
    if as_json:
        write_json(summaries)
        return
    table = Table("example", "", box=box.SIMPLE_HEAD, padding=0)
    for name, summary in summaries.items():
        table.add_row(name, summary)
    ANSWER_CONSOLE.print(table)


def _show_example(name: str, copy: bool, as_json: bool) -> None:
    copies = list_copies(require_example(name))
    if copy:
        texts = {one.name: one.text for one in copies}
        written = [str(path) for path in write_new_files(Path(), texts)]
        if as_json:
            write_json({"written": written})
        else:
            ANSWER_CONSOLE.print(
                f"Wrote {', '.join(written)}. Fly it: crazychoir run {written[0]} --fast",
                highlight=False,
                soft_wrap=True,
            )
    elif as_json:
        write_json({one.name: one.text for one in copies})
    else:
        ANSWER_CONSOLE.print(
            copies[0].text, markup=False, highlight=False, soft_wrap=True, end=""
        )
