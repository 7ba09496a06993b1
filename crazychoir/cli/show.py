"""What people see: tables, live progress, errors."""

import contextlib
import json
import logging
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Generic, NoReturn, Self, TypeVar

import typer
from rich.console import Console
from rich.table import Table

from crazychoir.errors import CrazyChoirError, Refused

if TYPE_CHECKING:
    from crazychoir.launch.score import Score

T = TypeVar("T")
STDERR = Console(stderr=True)
REFRESH = 4
"""Tables a second."""


def set_up_logging(level: int = logging.WARNING) -> None:
    """Logs go to standard error."""
    if sys.stderr.isatty():
        from rich.logging import RichHandler

        handler: logging.Handler = RichHandler(console=STDERR, show_path=False, rich_tracebacks=False)
    else:
        handler = logging.StreamHandler()
    logging.basicConfig(level=level, format="%(message)s", handlers=[handler], force=True)


@contextlib.contextmanager
def prints_aside() -> Iterator[None]:
    """Standard output is for what a command answers: what missions, and programs that they start, print goes aside,
    to standard error.
    """
    output = os.dup(1)
    os.dup2(2, 1)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(output, 1)
        os.close(output)


def write_json(value: Any) -> None:
    """One line of JSON on standard output, at once."""
    sys.stdout.write(json.dumps(plain(value), default=str) + "\n")
    sys.stdout.flush()


def plain(value: Any) -> Any:
    """What JSON has for any value that travels: lists for arrays, fields by name, null for what is not finite."""
    if isinstance(value, dict):
        return {key if isinstance(key, str | int) else str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # an array
        return plain(value.tolist())
    if hasattr(value, "__struct_fields__"):  # a wire type
        return {name: plain(getattr(value, name)) for name in value.__struct_fields__}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def fail(error: CrazyChoirError, as_json: bool) -> NoReturn:
    """Say what is wrong, and end with exit code 2."""
    if as_json:
        write_json({"success": False, "error": str(error), "kind": type(error).__name__})
    STDERR.print(f"[bold red]{type(error).__name__}[/]: ", end="")
    text = f"{error.by}: {error.reason}" if isinstance(error, Refused) else str(error)  # its name is said already
    STDERR.print(text, markup=False, highlight=False, soft_wrap=True)
    raise typer.Exit(2)


def result_table(results: dict[Any, dict[str, Any]]) -> Table:
    """One row a drone."""
    table = Table("drone", "success", "detail")
    for i, result in results.items():
        detail = result.get("reason") or ", ".join(f"{k} {_short(v)}" for k, v in result.items() if k != "success")
        table.add_row(str(i), "yes" if result.get("success") else "[red]no[/]", detail)
    return table


def _short(value: Any) -> str:
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def status_table(score: "Score") -> Table:
    """The live view of a swarm: drones, phase, task, round, cost, messages lost, trouble."""
    table = Table("drone", "phase", "task", "round", "cost", "sent", "lost", "resent", "silent", "note")
    for i in score.ids:
        status = score.statuses.get(i)
        if status is None:
            table.add_row(str(i), "[dim]not heard yet[/]")
            continue
        silent = ", ".join([*(f"{j}?" for j in status.suspect), *(f"{j}!" for j in status.gone)])
        cost = "" if status.cost != status.cost else f"{status.cost:.3f}"
        numbers = [str(status.round), cost, str(status.sent), str(status.lost), str(status.resent)]
        table.add_row(str(i), status.phase, status.task, *numbers, silent, status.note)
    return table


class Progress(Generic[T]):
    """A live table of what it is called with, REFRESH times a second, and lines above it."""

    def __init__(self, table: Callable[[T], Table], enabled: bool) -> None:
        from rich.live import Live

        self.table = table
        self.live = Live(console=STDERR, refresh_per_second=REFRESH, transient=True) if enabled else None
        self._due = 0.0

    def __call__(self, seen: T) -> None:
        """Show the newest state, when it is time."""
        if self.live is None or time.perf_counter() < self._due:
            return
        self._due = time.perf_counter() + 1.0 / REFRESH
        self.live.update(self.table(seen))

    def say(self, line: str) -> None:
        """A line above the table."""
        STDERR.print(line, markup=False, highlight=False, soft_wrap=True)

    def __enter__(self) -> Self:
        if self.live is not None:
            self.live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self.live is not None:
            self.live.stop()


def summary_table(run: dict[str, Any]) -> Table:
    """The result of a run, one row a figure."""
    table = Table("figure", "value", title=f"{run['mission']}: {'success' if run['success'] else 'failed'}")
    shown = [
        ("drones", "{}"), ("tasks", "{}"), ("cost", "{:.4f} m"), ("plan_digest", "{:.16}"), ("simulated_s", "{:.2f} s"),
        ("wall_s", "{:.2f} s"), ("real_time_factor", "{:.1f}"), ("rounds", "{}"), ("messages", "{}"),
        ("min_separation_m", "{:.3f} m"), ("formation_error_m", "{:.4f} m"), ("settling_s", "{:.2f} s"),
        ("planned_m", "{}"), ("flown_m", "{}"), ("digest", "{}"), ("picture", "{}"),
    ]  # fmt: skip
    if len(run["here"]) < run["drones"]:
        table.add_row("started here", ", ".join(map(str, run["here"])))
    for key, form in shown:
        if run.get(key) is not None:
            table.add_row(key, form.format(run[key] if not isinstance(run[key], dict) else _pairs(run[key])))
    for i, reason in run["reasons"].items():
        table.add_row(f"drone {i}", f"[red]{reason}[/]")
    if run["absent"]:
        table.add_row("absent", f"[red]{run['absent']}[/]")
    return table


def _pairs(values: dict[Any, Any]) -> str:
    return ", ".join(f"{key}: {_short(value)}" for key, value in values.items())
