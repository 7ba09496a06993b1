"""The progress of a sweep: a bar on a terminal, a line in a notebook."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from crazychoir.api.sweep_rows import Row
from crazychoir.launch.console import ERROR_CONSOLE

Step = Callable[[int, int, Row], None]
"""Called with the count of runs that have ended, that of all runs, and the row of the newest."""


@contextmanager
def open_progress() -> Iterator[Step]:
    """Yield the function that shows the progress; it shows nothing where no human reads it."""
    if _is_in_notebook():
        yield _show_line()
    elif ERROR_CONSOLE.is_terminal:
        with Progress(
            TextColumn("runs"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left:"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[failed]}"),
            console=ERROR_CONSOLE,
            transient=True,
        ) as progress:
            yield _show_bar(progress)
    else:
        yield lambda ended, count, row: None


def _show_bar(progress: Progress) -> Step:
    """Return the function that moves a bar."""
    bar = progress.add_task("runs", total=None, failed="")
    failed = 0

    def show(ended: int, count: int, row: Row) -> None:
        nonlocal failed
        failed += not row["success"]
        told = f"failed: {failed}" if failed else ""
        progress.update(bar, completed=ended, total=count, failed=told)

    return show


def _is_in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    shell = sys.modules.get("IPython")
    return shell is not None and hasattr(shell.get_ipython(), "kernel")


def _show_line() -> Step:
    """Return the function that changes one line below the cell."""
    # A kernel has imported it.
    display: Any = sys.modules["IPython.display"].display
    shown: Any = None

    def show(ended: int, count: int, row: Row) -> None:
        nonlocal shown
        line = {"text/plain": f"{ended} of {count} runs"}
        if shown is None:
            shown = display(line, raw=True, display_id=True)
        else:
            shown.update(line, raw=True)

    return show
