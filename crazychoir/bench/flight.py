"""crazychoir bench flight: speed of a whole swarm on one core, as a multiple of real time.

Each row flies in a process of its own, so that the memory and the caches of one row do not change
the figures of the next. A row that takes too long is given up, and its note says so.
"""

import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from crazychoir.bench import worlds as bench_worlds
from crazychoir.bench.swarms import CollisionMethod, FlightCase
from crazychoir.bench.worlds import WORLD_BENCH
from crazychoir.control.margin import Plant
from crazychoir.solve.group import ProgramGroup


@dataclass(frozen=True, slots=True)
class FlightBenchLimits:
    """How long the rows of `crazychoir bench flight` may take, and how long their windows are."""

    row_time: float = 45.0
    """Seconds for a row of the default table."""
    table_time: float = 140.0
    """Seconds for all rows of the default table; the worlds alone follow."""
    least_row_time: float = 5.0
    """Seconds that must be left for a row to begin."""
    chosen_row_time: float = 1200.0
    """Seconds for a row with a chosen number of drones."""
    window: float = 1.0
    """Length of one measurement, s of virtual time."""
    short_window: float = 0.5
    """Length of one measurement of a large swarm, s of virtual time."""
    large_swarm: int = 300
    """Number of drones above which the windows are short."""


FLIGHT_BENCH = FlightBenchLimits()

FLIGHT_CASES = (
    FlightCase(30),
    FlightCase(30, shape="ring"),
    FlightCase(100),
    FlightCase(100, shape="ring"),
    FlightCase(100, law="python"),
    FlightCase(100, shape="ring", law="python"),
    FlightCase(100, plant="motors"),
    FlightCase(300),
    FlightCase(1000, window=FLIGHT_BENCH.short_window),
)
"""Rows of the default table; the rows that take longest are the last ones."""
QUICK_FLIGHT_CASES = (FlightCase(30), FlightCase(100))
"""Rows of a quick run."""

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class FlightChoice:
    """What the user chooses instead of the default table; None: as in the table."""

    drones: tuple[int, ...] = ()
    """Numbers of drones of a lattice, one row each; empty for the rows of the default table."""
    plant: Plant | None = None
    """Simulated engine."""
    window: float | None = None
    """Length of one measurement, s of virtual time."""
    collision: CollisionMethod | None = None
    """How the drones keep clear of each other."""


DEFAULT_CHOICE = FlightChoice()


def run(
    quick: bool = False,
    say: Say = lambda line: None,
    choice: FlightChoice = DEFAULT_CHOICE,
) -> dict[str, Any]:
    """Return {"rows": [one a flight], "worlds": [one an engine]}.

    quick: fewer rows
    say: called with a text that says what is being measured
    choice: what the user chooses instead of the default table; with numbers of drones the worlds
        alone are not measured
    """
    cases = choose_cases(choice, quick)
    rows = measure_cases(cases, bool(choice.drones), say)
    if choice.drones:
        return {"rows": rows, "worlds": []}
    counts = WORLD_BENCH.drone_counts[:1] if quick else WORLD_BENCH.drone_counts
    return {"rows": rows, "worlds": bench_worlds.run(counts, say)}


def choose_cases(choice: FlightChoice, quick: bool) -> list[FlightCase]:
    """Return the rows of the default table, or the rows that the user has chosen."""
    cases: Sequence[FlightCase] = QUICK_FLIGHT_CASES if quick else FLIGHT_CASES
    if choice.drones:
        cases = [
            FlightCase(n, window=choose_window(n)) for n in dict.fromkeys(choice.drones)
        ]
    changes = {
        name: value
        for name, value in asdict(choice).items()
        if name != "drones" and value is not None
    }
    changed = [FlightCase(**(asdict(case) | changes)) for case in cases]
    return list(dict.fromkeys(changed))


def choose_window(drones: int) -> float:
    """Return the length of a measurement, s."""
    if drones > FLIGHT_BENCH.large_swarm:
        return FLIGHT_BENCH.short_window
    return FLIGHT_BENCH.window


def measure_cases(
    cases: list[FlightCase], is_chosen: bool, say: Say
) -> list[dict[str, Any]]:
    """Measure one row after the other; a row that fails or is late has a note and no figures.

    is_chosen: whether the user has chosen the numbers of drones; then each row may take long
    """
    ends = time.perf_counter() + FLIGHT_BENCH.table_time
    rows = []
    for k, case in enumerate(cases):
        title = f"{k + 1} of {len(cases)}: {case.describe()}"
        left = ends - time.perf_counter()
        if is_chosen:
            row = measure_row(case, FLIGHT_BENCH.chosen_row_time, title, say)
        elif left < FLIGHT_BENCH.least_row_time:
            row = {"note": f"not measured: {FLIGHT_BENCH.table_time:.0f} s were over"}
        else:
            seconds = min(FLIGHT_BENCH.row_time, left)
            row = measure_row(case, seconds, title, say)
        rows.append(asdict(case) | row)
    return rows


def measure_row(
    case: FlightCase, seconds: float, title: str, say: Say
) -> dict[str, Any]:
    """Return the figures of a case, measured in a process of its own, or a note.

    seconds: s until the process is given up
    title: what is measured, for the texts of the progress
    say: called with the title and what the process is doing
    """
    ends = time.perf_counter() + seconds
    doing = "starting"
    command = [sys.executable, "-m", "crazychoir.bench.flight_row"]
    with ProgramGroup([[*command, json.dumps(asdict(case))]]) as group:
        while True:
            say(f"{title}: {doing}")
            left = max(0.0, ends - time.perf_counter())
            try:
                [(_, answer)] = group.answers(1, left, "have not answered")
            except TimeoutError as error:
                late = time.perf_counter() >= ends
                why = f"not done in {seconds:.0f} s ({doing})" if late else str(error)
                return {"note": f"not measured: {why}"}
            if "row" in answer:
                return {"note": "", **answer["row"]}
            if "failed" in answer:
                return {"note": f"not measured: {answer['failed']}"}
            doing = answer["doing"]


def tables(result: dict[str, Any]) -> Group:
    """Return the flights and the worlds as tables, with the notes of rows without figures."""
    rows = result["rows"]
    shown: list[RenderableType] = [flight_table(rows), profile_table(rows)]
    shown += [
        Text(f"{describe_row(row)}: {row['note']}") for row in rows if row["note"]
    ]
    if result["worlds"]:
        shown.append(bench_worlds.table(result["worlds"]))
    return Group(*shown)


def flight_table(rows: list[dict[str, Any]]) -> Table:
    """Return the speed and the memory of each flight as a table."""
    shown = Table(title="The whole stack in virtual time, one core")
    shown.add_column("flight")
    for name in (
        "times real time",
        "by processor time",
        "us a drone and tick",
        "collision filter acts",
        "MB",
    ):
        shown.add_column(name, justify="right")
    for row in rows:
        figures = []
        if not row["note"]:
            figures = [
                f"{row['real_time_factor']:.2f}",
                f"{row['real_time_factor_cpu']:.2f}",
                f"{row['us_per_drone_tick']:.1f}",
                f"{row['filter_share']:.1%}",
                f"{row['peak_memory_mb']:.0f}",
            ]
        shown.add_row(describe_row(row), *figures)
    return shown


def profile_table(rows: list[dict[str, Any]]) -> Table:
    """Return the shares of the rooms of each flight as a table."""
    shown = Table("flight", "where the time goes", title="Shares of processor time")
    for row in rows:
        if row["note"]:
            continue
        rooms = sorted(row["profile"].items(), key=lambda item: -item[1])
        shares = ", ".join(
            f"{room} {share:.0%}" for room, share in rooms if share >= 0.01
        )
        shown.add_row(describe_row(row), shares)
    return shown


def describe_row(row: dict[str, Any]) -> str:
    """Return the case of a row in words."""
    return FlightCase(
        **{name: row[name] for name in FlightCase.__dataclass_fields__}
    ).describe()
