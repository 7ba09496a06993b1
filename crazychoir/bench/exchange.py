"""`crazychoir bench exchange`: rounds a second of the exchange between neighbours.

CycloneDDS and MPI are measured in the same run. Rows are measured in turns and repeated, so
that other load of the machine affects all of them alike. The table shows medians.
"""

import os
from collections.abc import Callable
from typing import Any

from rich.table import Table
from rich.text import Text

from crazychoir.bench.harness import (
    BENCH_GRAPHS,
    ProgramRow,
    fill_table,
    measure_in_turns,
)


def run(
    seconds: float = 0.8,
    repeats: int = 3,
    quick: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Measure all rows.

    seconds: s: length of one window
    repeats: number of windows of each row
    quick: rings only, one turn of short windows
    say: called with a text that says what is being measured
    """
    if quick:
        seconds = min(seconds, 0.5)
        repeats = 1
    rows = _rows(("ring",) if quick else tuple(BENCH_GRAPHS))
    shown = measure_in_turns(rows, seconds, repeats, say)
    return {
        "rows": shown,
        "ratios": _ratios(shown),
        "cores": os.cpu_count(),
        "seconds": seconds,
        "repeats": repeats,
    }


def table(result: dict[str, Any]) -> Table:
    """Return the rows as a table."""
    made = Table(title="Neighbours' exchange: medians of one run")
    rows = sorted(
        result["rows"], key=lambda row: (row["graph"] != "ring", row["agents"])
    )
    notes = fill_table(made, rows, "graph")
    notes[
        "Of several processes, each is bound to a core of its own where there are enough."
    ] = None
    # Text and not markup, because a note may hold brackets.
    made.caption = Text("\n".join(notes))
    return made


def _rows(graphs: tuple[str, ...]) -> list[ProgramRow]:
    rows = []
    cores = os.cpu_count() or 1
    for graph in graphs:
        for n in (10, 30):
            for processes in (1, 2, n):
                rows.append(
                    ProgramRow("crazychoir", "crazychoir_peer", graph, n, processes)
                )
            for processes in (2, n):
                rows.append(
                    ProgramRow(
                        "cyclonedds",
                        "cyclonedds_peer",
                        graph,
                        n,
                        processes,
                        ("cyclonedds",),
                    )
                )
            mpi = ProgramRow("mpi4py-pickle", "mpi4py_peer", graph, n, n, ("mpi4py",))
            if n > cores:
                mpi.note = f"MPI polls: it collapses with more ranks ({n}) than cores ({cores})"
            rows.append(mpi)
    return rows


def _ratios(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return the ratios that the project promises, from the medians of this run."""
    rate = {
        (r["name"], r["graph"], r["agents"], r["processes"]): r["rounds_per_s"]
        for r in rows
    }
    two = rate[("crazychoir", "ring", 10, 2)]
    one = rate[("crazychoir", "ring", 30, 1)]
    pairs = {
        "ring 10: crazychoir, two processes / cyclonedds, one an agent": (
            two,
            rate[("cyclonedds", "ring", 10, 10)],
        ),
        "ring 10: crazychoir, two processes / mpi4py-pickle": (
            two,
            rate[("mpi4py-pickle", "ring", 10, 10)],
        ),
        "ring 30: crazychoir, one process / one an agent": (
            one,
            rate[("crazychoir", "ring", 30, 30)],
        ),
    }
    return {
        name: round(ours / other, 1)
        for name, (ours, other) in pairs.items()
        if ours and other
    }
