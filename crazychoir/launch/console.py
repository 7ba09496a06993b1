"""What a command shows to the user: tables, live progress, errors."""

import contextlib
import json
import logging
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NoReturn, Self, TypeVar

import typer
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from crazychoir.bus.json_view import to_plain_values
from crazychoir.bus.network import handshakes
from crazychoir.errors import ConfigError, CrazyChoirError, Refused, error_text
from crazychoir.files.output_files import require_writable_file

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.launch.flight_observer import FlightScore
    from crazychoir.recording.mcap.reading import Recording
    from crazychoir.types import Status

log = logging.getLogger(__name__)
T = TypeVar("T")
ERROR_CONSOLE = Console(stderr=True, markup=False, emoji=False)
"""Console for progress and errors.

A text is printed as it is, because names may look like the markup of rich.
"""


class AnswerConsole(Console):
    """Standard output, for the answers of commands.

    If standard output cannot be written, the answer goes to standard error.
    """

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does.

        Exits with 1 after an error of standard output.
        """
        try:
            super().print(*objects, **options)
        except BrokenPipeError:
            raise
        except OSError as error:
            _give_up_on_output(error)
            ERROR_CONSOLE.print(*objects, **options)
            raise typer.Exit(1) from error


ANSWER_CONSOLE = AnswerConsole(markup=False, emoji=False)
"""Console for the answers of commands."""
LIVE_TABLE_RATE = 4
"""Updates of a live table, Hz."""
WIDE_TERMINAL = 100
"""Width of a terminal, in columns, from which on tables show all counters."""
PICTURE_SUFFIXES = (".png", ".pdf", ".svg")
"""Suffixes of the pictures that can be drawn."""


class SingleTraceFormatter(logging.Formatter):
    """Formats log records, and prints each traceback only once.

    If thirty drones fail in the same law, each reports its failure, but the traceback appears once.
    """

    def __init__(self) -> None:
        super().__init__("%(message)s")
        self._shown: set[tuple[object, ...]] = set()

    def formatException(self, ei: Any) -> str:
        """Return the traceback; empty if a traceback with the same lines was printed before."""
        places = traceback.extract_tb(ei[2])
        key = (ei[0], *((place.filename, place.lineno) for place in places))
        if key in self._shown:
            return ""
        self._shown.add(key)
        return super().formatException(ei)


def set_up_logging(level: int = logging.WARNING) -> None:
    """Send all logs to standard error, those of the network too."""
    handshakes.read_output()
    if sys.stderr.isatty():
        from rich.logging import RichHandler

        handler: logging.Handler = RichHandler(
            console=ERROR_CONSOLE, show_path=False, rich_tracebacks=False
        )
    else:
        handler = logging.StreamHandler()
    handler.setFormatter(SingleTraceFormatter())
    logging.basicConfig(level=level, handlers=[handler], force=True)
    # Matplotlib otherwise logs the place of its list of fonts.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)


@contextlib.contextmanager
def redirect_prints() -> Iterator[None]:
    """Redirect standard output to standard error.

    Standard output is for the answer of the command only. Missions, and the programs that they
    start, may print too.
    """
    with (
        contextlib.redirect_stdout(sys.stderr),
        contextlib.nullcontext()
        if handshakes.is_reading_output()
        else _redirect_output(),
    ):
        yield


@contextlib.contextmanager
def _redirect_output() -> Iterator[None]:
    output = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        os.dup2(output, 1)
        os.close(output)


def write_json(value: Any) -> None:
    """Write a value as one line of JSON to standard output, and flush."""
    line = json.dumps(to_plain_values(value), default=str) + "\n"
    try:
        sys.stdout.write(line)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        _give_up_on_output(error)
        sys.stderr.write(line)
        raise typer.Exit(1) from error


def _give_up_on_output(error: OSError) -> None:
    """Report that standard output cannot be written, as on a full disk, and drop its buffer."""
    text = f"standard output: {error.strerror}: the answer is printed here. Name another file, or make room."
    ERROR_CONSOLE.print(
        text, style="red", markup=False, highlight=False, soft_wrap=True
    )
    with contextlib.suppress(OSError, ValueError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stdout.fileno())
        os.close(nothing)


def require_drawable(path: Path | None) -> None:
    """Raise ConfigError, before anything is computed, if the picture cannot be drawn.

    The reason is an unknown suffix, or a folder that does not exist.
    """
    if path is not None:
        require_writable_file(path, "--picture", PICTURE_SUFFIXES)


def require_reached(config: "SwarmConfig", which: str, drone: int) -> None:
    """Raise ConfigError for a drone that no radio reaches.

    config: the swarm
    which: text that says where the swarm comes from
    drone: id of the drone
    """
    if drone not in config.topology.reached:
        do = (
            ""
            if config.topology.reached
            else f"There are none in {which}: name another swarm file by --swarm."
        )
        raise ConfigError(
            "DRONE",
            drone,
            f"drones that a radio reaches: {list(config.topology.reached)}",
            do,
        )


class CommandOutputs:
    """Writes the files that a command must write beside its answer.

    If a file fails, this is reported and the answer is still printed.

    failed: the reason for each option with a failed file
    """

    def __init__(self) -> None:
        self.failed: dict[str, str] = {}

    @contextlib.contextmanager
    def writing(self, option: str) -> Iterator[None]:
        """Note every exception of the block as the failure of this option.

        Examples are a full disk, values that cannot be drawn, and errors in a mission's own code.
        """
        try:
            yield
        except Exception as error:
            text = (
                str(error) if isinstance(error, CrazyChoirError) else error_text(error)
            )
            self.failed[option] = text
            log.debug("%s", option, exc_info=error)

    def say(self) -> None:
        """Print a line to standard error for each file that was not written."""
        for option, why in self.failed.items():
            text = why if why.startswith(option) else f"{option}: {why}"
            ERROR_CONSOLE.print(
                f"Not written: {text}",
                style="red",
                markup=False,
                highlight=False,
                soft_wrap=True,
            )

    @property
    def told(self) -> dict[str, Any]:
        """The part of a JSON answer that lists the failed files: {"not_written": ...}, or {}."""
        return {"not_written": self.failed} if self.failed else {}


def exit_with_error(error: CrazyChoirError, as_json: bool) -> NoReturn:
    """Print the error and exit with 2."""
    if as_json:
        write_json(
            {"success": False, "error": str(error), "kind": type(error).__name__}
        )
    ERROR_CONSOLE.print(Text.assemble((type(error).__name__, "bold red"), ": "), end="")
    # The text of Refused would repeat the name of the class.
    text = f"{error.by}: {error.reason}" if isinstance(error, Refused) else str(error)
    ERROR_CONSOLE.print(text, markup=False, highlight=False, soft_wrap=True)
    raise typer.Exit(2)


def exit_interrupted(as_json: bool) -> NoReturn:
    """Report that Ctrl-C has ended a command that flies no real drone, and exit with 130."""
    text = "Ctrl-C: the run ends here, without a result"
    if as_json:
        write_json({"success": False, "error": text, "kind": "KeyboardInterrupt"})
    ERROR_CONSOLE.print(text)
    raise typer.Exit(130)


def warn_of_gaps(recording: "Recording", left: str) -> None:
    """Warn about what a recording lacks.

    recording: the recording
    left: text that says what happens with the part that is there
    The warnings concern the end of the recording, and messages that were lost or missed.
    """
    said = [f"the recording was {recording.fault}: {left}"] if recording.fault else []
    said += (
        [f"messages lost while it was recorded: {recording.lost}"]
        if recording.lost
        else []
    )
    said += (
        [f"messages that the network did not bring to its recorder: {recording.missed}"]
        if recording.missed
        else []
    )
    for text in said:
        ERROR_CONSOLE.print(
            f"{recording.path}: {text}",
            style="yellow",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )


def build_result_table(results: dict[Any, dict[str, Any]]) -> Table:
    """Return a table with one row for each drone."""
    table = Table("drone", "success", "detail")
    for i, result in results.items():
        rest = ", ".join(
            f"{k} {_format_short_value(v)}" for k, v in result.items() if k != "success"
        )
        detail = _strip_drone(i, result["reason"]) if result.get("reason") else rest
        table.add_row(
            str(i), "yes" if result.get("success") else Text("no", "red"), Text(detail)
        )
    return table


def _strip_drone(i: Any, reason: Any) -> str:
    """Return the reason of drone i without "drone i: " at its beginning."""
    return str(reason).removeprefix(f"drone {i}: ")


def group_reasons(reasons: Mapping[int, Any]) -> list[tuple[str, str]]:
    """Return each reason once, behind the drones that have it, such as "drones 0 to 3"."""
    from crazychoir.team.graph import describe_ids  # --help does not need it

    drones_by_reason: dict[str, list[int]] = {}
    for i, reason in reasons.items():
        drones_by_reason.setdefault(_strip_drone(i, reason), []).append(int(i))
    return [
        (f"drone{'s' if len(ids) > 1 else ''} {describe_ids(ids)}", reason)
        for reason, ids in drones_by_reason.items()
    ]


def _format_short_value(value: Any) -> str:
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def build_status_table(
    score: "FlightScore", names: Mapping[int, str] | None = None
) -> Group:
    """Return the live view of a swarm: one line for each drone, and the notes of the drones below.

    A narrow terminal leaves out two counters.

    names: name of each drone that has one
    """
    counters = (
        ("sent", "lost", "resent")
        if ERROR_CONSOLE.width >= WIDE_TERMINAL
        else ("lost",)
    )
    columns = ("drone", "phase", "task", "round", "cost", *counters, "silent")
    table = Table(*columns, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    below = []
    marked = False
    for i in score.ids:
        drone = f"{i} {(names or {}).get(i, '')}".rstrip()
        status = score.statuses.get(i)
        if status is None:
            table.add_row(drone, "", Text("not heard yet", "dim"))
            continue
        silent = _list_silent_drones(status, score.statuses)
        marked = marked or bool(silent)
        cost = "" if status.cost != status.cost else f"{status.cost:.3f}"
        numbers = [
            str(status.round),
            cost,
            *(str(getattr(status, name)) for name in counters),
        ]
        table.add_row(
            drone,
            *(
                _fit_on_line(text)
                for text in (status.phase, status.task, *numbers, silent)
            ),
        )
        if status.note:
            below.append(_fit_on_line(f"drone {i}: {status.note}"))
    for describe in (_describe_clocks, _describe_links):
        below += [_fit_on_line(text) for text in describe(score.statuses.values())]
    if marked:
        below.append(
            _fit_on_line(
                "silent: drones that it does not hear; ? for a second or more, ! given up"
            )
        )
    return Group(table, *below)


def _list_silent_drones(status: "Status", statuses: Mapping[int, "Status"]) -> str:
    """Return the drones that this drone does not hear, as text.

    Drones that have ended on the ground are left out: they need not send any more.
    """
    from crazychoir.agent.drone import WAITING_TASK

    ended = [
        j
        for j, s in statuses.items()
        if s.phase == "on ground" and s.task != WAITING_TASK
    ]
    marks = [*((j, "?") for j in status.suspect), *((j, "!") for j in status.gone)]
    return ", ".join(f"{j}{mark}" for j, mark in marks if j not in ended)


def _describe_clocks(statuses: Iterable["Status"]) -> list[str]:
    """Return one line for each pair of hosts with the difference between their clocks."""
    said: dict[frozenset[str], str] = {}
    for status in statuses:
        for host, offset, error in zip(
            status.hosts, status.offsets, status.offset_errors, strict=False
        ):
            how = f"{abs(offset):.6f} s {'ahead of' if offset > 0.0 else 'behind'} that of {status.host}"
            said.setdefault(
                frozenset((host, status.host)),
                f"the clock of host {host} is {how}, within {error:.6f} s",
            )
    return list(said.values())


def _describe_links(statuses: Iterable["Status"]) -> list[str]:
    """Return one line for each process with a link that has dropped frames or was broken."""
    faults = {
        status.process: "; ".join(status.link_faults)
        for status in statuses
        if status.link_faults
    }
    return [
        f"link of process {process} since its start: {faults[process]}"
        for process in sorted(faults)
    ]


def _fit_on_line(text: str) -> Text:
    """Return a text that stays on one line and is cut if the terminal is too narrow."""
    return Text(text, no_wrap=True, overflow="ellipsis")


class LiveTable(Generic[T]):
    """A live table, updated LIVE_TABLE_RATE times a second, with lines above it.

    table: makes the table from the newest state
    enabled: whether the table is shown
    """

    def __init__(self, table: Callable[[T], RenderableType], enabled: bool) -> None:
        from rich.live import Live

        self.table = table
        self.live = (
            Live(
                console=ERROR_CONSOLE,
                refresh_per_second=LIVE_TABLE_RATE,
                transient=True,
            )
            if enabled
            else None
        )
        self._due = 0.0

    def __call__(self, seen: T) -> None:
        """Show the newest state if an update is due."""
        if self.live is None or time.perf_counter() < self._due:
            return
        self._due = time.perf_counter() + 1.0 / LIVE_TABLE_RATE
        self.live.update(self.table(seen))

    def say(self, line: str) -> None:
        """Print a line above the table."""
        ERROR_CONSOLE.print(line, markup=False, highlight=False, soft_wrap=True)

    def __enter__(self) -> Self:
        if self.live is not None:
            self.live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self.live is not None:
            self.live.stop()


def _describe_success(run: dict[str, Any]) -> str:
    if not run["success"]:
        return "failed"
    return "success, ended by its operator" if run.get("ended") else "success"


def build_summary_table(run: dict[str, Any]) -> Table:
    """Return the result of a run as a table with one row for each figure."""
    table = Table(
        "figure", "value", title=f"{_describe_flown(run)}: {_describe_success(run)}"
    )
    shown = [
        ("drones", "{}"),
        ("tasks", "{}"),
        ("cost", "{:.4f} m"),
        ("plan_digest", "{:.16}"),
        ("simulated_s", "{:.2f} s"),
        ("startup_s", "{:.2f} s"),
        ("wall_s", "{:.2f} s"),
        ("real_time_factor", "{:.1f}"),
        ("rounds", "{}"),
        ("messages", "{}"),
        ("min_separation_m", "{:.3f} m"),
        ("kept_clear_s", "{}"),
        ("at_fence_s", "{}"),
        ("refused_references", "{}"),
        ("apart", "{}"),
        ("formation_error_m", "{:.4f} m"),
        ("settling_s", "{:.2f} s"),
        ("planned_m", "{}"),
        ("flown_m", "{}"),
        ("digest", "{}"),
        ("picture", "{}"),
    ]
    if len(run["here"]) < run["drones"]:
        table.add_row("started here", ", ".join(map(str, run["here"])))
    # In real time the simulated time is the wall time, so these two figures say nothing.
    same = () if run.get("digest") else ("simulated_s", "real_time_factor")
    for key, form in shown:
        if run.get(key) is not None and key not in same:
            table.add_row(
                key,
                form.format(
                    run[key]
                    if not isinstance(run[key], dict)
                    else _format_pairs(run[key])
                ),
            )
    for key in run.get("report", ()):
        if key not in dict(shown) and (text := _format_report_value(run[key])):
            table.add_row(key, Text(text))
    if run.get("recording"):
        table.add_row("recording", Text(_describe_recording(run["recording"])))
    if run.get("reason"):
        table.add_row("reason", Text(run["reason"], "red"))
    for i, words in run.get("ended", {}).items():
        table.add_row(f"drone {i}", Text(_strip_drone(i, words)))
    for names, reason in group_reasons(run["reasons"]):
        table.add_row(names, Text(reason, "red"))
    return table


def _describe_flown(run: dict[str, Any]) -> str:
    """Return the mission without its folder, and the name of the swarm if it has its own file."""
    mission = Path(run["mission"]).name
    return f"swarm {run['swarm']}, {mission}" if "swarm" in run else mission


def _describe_recording(recording: dict[str, Any]) -> str:
    """Return where the recording is, and what it lacks."""
    text = f"{recording['file']}: {recording['messages']} messages"
    error = recording["error"]
    text += "".join(
        f", {recording[name]} {name}" for name in ("lost", "missed") if recording[name]
    )
    return text + (f"; ended early: {error}" if error else "")


def _format_report_value(value: Any) -> str:
    """Return a value of a mission's report on one line.

    Empty for a list with other entries than figures and texts: only JSON shows these.
    """
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, dict):
        return _format_pairs(value)
    if not isinstance(value, list | tuple):
        return _format_short_value(value)
    plain = all(isinstance(one, bool | int | float | str) for one in value)
    return ", ".join(_format_short_value(one) for one in value) if plain else ""


def _format_pairs(values: dict[Any, Any]) -> str:
    return ", ".join(
        f"{key}: {_format_short_value(value)}" for key, value in values.items()
    )
