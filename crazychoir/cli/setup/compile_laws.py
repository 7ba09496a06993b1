"""crazychoir compile: compile all laws at once, so that no flight waits for them."""

import importlib
import time
from collections.abc import Iterator
from pathlib import Path

import typer

from crazychoir.cli.operate.inspect import JsonOption
from crazychoir.errors import ConfigError
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    set_up_logging,
    write_json,
)
from crazychoir.numerics.compiling import KERNEL_QUEUE

PACKAGE_FOLDER = Path(__file__).parents[2]
"""Folder of this package."""
LAW_IMPORT = "from crazychoir.numerics.kernels import"
"""Text in each module with compiled laws."""


def compile_laws(as_json: JsonOption = False) -> None:
    """Compile the numerical code now, instead of in the first run.

    It takes a minute or two. Laws that are compiled already are only checked.
    """
    set_up_logging()
    from rich.progress import (  # --help does not need it
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TimeElapsedColumn,
    )

    began = time.perf_counter()
    with KERNEL_QUEUE.checks_first():
        for module in find_law_modules():
            import_with_extras(module)
    laws = KERNEL_QUEUE.count_waiting()
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=ERROR_CONSOLE, disable=as_json) as progress:
        bar = progress.add_task("laws", total=laws)
        KERNEL_QUEUE.load_kept(lambda: progress.advance(bar))
        compiled = KERNEL_QUEUE.count_waiting()
        KERNEL_QUEUE.compile(lambda: progress.advance(bar))
    seconds = time.perf_counter() - began
    if as_json:
        write_json({"laws": laws, "compiled": compiled, "seconds": seconds})
    else:
        ANSWER_CONSOLE.print(
            f"{laws} laws are ready, {compiled} of them compiled now ({seconds:.1f} s)"
        )
    raise typer.Exit


def find_law_modules() -> Iterator[str]:
    """Yield the names of the modules with compiled laws."""
    for file in sorted(PACKAGE_FOLDER.rglob("*.py")):
        if LAW_IMPORT in file.read_text(encoding="utf-8"):
            place = file.relative_to(PACKAGE_FOLDER.parent).with_suffix("")
            yield ".".join(place.parts)


def import_with_extras(module: str) -> None:
    """Import a module of this package, unless it needs an extra that is not installed."""
    try:
        importlib.import_module(module)
    except (ModuleNotFoundError, ConfigError) as error:
        missing = error.__cause__ if isinstance(error, ConfigError) else error
        if not isinstance(missing, ModuleNotFoundError):
            raise
        if (missing.name or "").partition(".")[0] == PACKAGE_FOLDER.name:
            raise
