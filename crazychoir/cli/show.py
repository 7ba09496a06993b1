"""What people see: tables, live progress, errors."""

import json
import logging
import sys
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.live import Live
from rich.logging import RichHandler
from rich.table import Table

from crazychoir.errors import CrazyChoirError
from crazychoir.launch import Score

STDERR = Console(stderr=True)
REFRESH = 4
"""Tables a second."""


def set_up_logging(level: int = logging.WARNING) -> None:
    """Logs go to standard error."""
    if sys.stderr.isatty():
        handler: logging.Handler = RichHandler(console=STDERR, show_path=False, rich_tracebacks=False)
    else:
        handler = logging.StreamHandler()
    logging.basicConfig(level=level, format="%(message)s", handlers=[handler], force=True)


def fail(error: CrazyChoirError, as_json: bool) -> NoReturn:
    """Say what is wrong, and end with exit code 2."""
    if as_json:
        sys.stdout.write(json.dumps({"success": False, "error": str(error), "kind": type(error).__name__}) + "\n")
    STDERR.print(f"[bold red]{type(error).__name__}[/]: ", end="")
    STDERR.print(str(error), markup=False, highlight=False, soft_wrap=True)
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


def status_table(score: Score) -> Table:
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


class Progress:
    """A live table of a score, REFRESH times a second; call it with the score."""

    def __init__(self, enabled: bool) -> None:
        self.live = Live(console=STDERR, refresh_per_second=REFRESH, transient=True) if enabled else None

    def __call__(self, score: Score) -> None:
        """Show the newest state."""
        if self.live is not None:
            self.live.update(status_table(score))

    def say(self, line: str) -> None:
        """A line above the table."""
        STDERR.print(line, markup=False, highlight=False, soft_wrap=True)

    def __enter__(self) -> "Progress":
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
