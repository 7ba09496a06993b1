"""Round trips of 64 bytes between two drones in two processes, beside other programs in the same run.

All drones but those of TCP run in asyncio. Each process is bound to a core of its own where there
are two.
"""

import statistics
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from rich.table import Table
from rich.text import Text

from crazychoir.bench.harness import ProgramRow, ask_row, is_installed

TRIP_TEAM = ("ring", 2, 2)
"""Graph, agents and processes of a round trip."""

TABLE_WIDTH = 78
"""Characters of the table, so that its notes fit on a line."""


@dataclass
class TripRow:
    """The round trips of one program."""

    program: ProgramRow
    """The program."""
    medians: list[float] = field(default_factory=list)
    """us: the median of each window."""
    p99s: list[float] = field(default_factory=list)
    """us: the 99th percentile of each window."""

    def shown(self) -> dict[str, Any]:
        """Return the row of the result, with medians of all windows."""
        shown: dict[str, Any] = {"name": self.program.name}
        for name, values in (("median_us", self.medians), ("p99_us", self.p99s)):
            shown[name] = round(statistics.median(values), 1) if values else None
        note = self.program.note
        return shown | ({"note": note} if note else {})


def list_trips() -> list[TripRow]:
    """Return a row for each program."""
    programs = (
        ("crazychoir", "crazychoir_trip", ()),
        ("TCP, blocking, no asyncio", "tcp_trip", ()),
        ("pyzmq", "pyzmq_trip", ("zmq",)),
        ("cyclonedds", "cyclonedds_trip", ("cyclonedds",)),
        ("mango-agents", "mango_trip", ("mango",)),
        (
            "asyncio-for-robotics, zenoh",
            "asyncio_for_robotics_trip",
            ("asyncio_for_robotics",),
        ),
    )
    return [
        TripRow(ProgramRow(name, f"trips.{module}", *TRIP_TEAM, packages))
        for name, module, packages in programs
    ]


def measure_trips(
    seconds: float, repeats: int, say: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Measure all programs in turns, and return the rows of the result.

    seconds: s: length of one window
    repeats: number of windows of each program
    say: called with a text that says what is being measured
    """
    rows = list_trips()
    for turn in range(repeats):
        for row in rows:
            if is_installed(row.program):
                say(f"{turn + 1}/{repeats}: round trips of {row.program.name}")
                measure_trip(row, seconds)
    return [row.shown() for row in rows]


def measure_trip(row: TripRow, seconds: float) -> None:
    """Measure one window of a program; an error becomes its note."""
    for answer in ask_row(row.program, seconds):
        if answer:
            row.medians.append(answer["median_us"])
            row.p99s.append(answer["p99_us"])


def trip_table(rows: list[dict[str, Any]]) -> Table:
    """Return the rows as a table."""
    made = Table(
        title="Round trips of 64 bytes between two processes: medians of one run",
        min_width=TABLE_WIDTH,
    )
    made.add_column("program")
    made.add_column("median us", justify="right")
    made.add_column("p99 us", justify="right")
    for row in rows:
        figures = [row["median_us"], row["p99_us"]]
        texts = ["-" if figure is None else f"{figure:,.1f}" for figure in figures]
        made.add_row(row["name"], *texts)
    notes = [f"{row['name']}: {row['note']}" for row in rows if "note" in row]
    made.caption = Text("\n".join(notes))
    return made
