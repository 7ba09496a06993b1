"""`crazychoir bench optimization`: rounds a second of distributed algorithms, compared to a peer.

The peer is a program in the style of DISROPT, a Python package for distributed optimisation. Both
run the same algorithm on the same graph with the same solver of the local problem, in one run. They
differ in how agents are divided among processes, how messages travel, and how many exchanges a
round needs.
"""

import os
from collections.abc import Callable
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from crazychoir.bench.harness import ProgramRow, fill_table, measure_in_turns

MEASURED_ALGORITHMS = ("consensus", "dual decomposition")
PROMISED_RATIOS = {"consensus": 10.0, "dual decomposition": 3.0}
"""Smallest ratio to DISROPT's pattern that the project promises, by algorithm."""
DISROPT_PATTERN = "DISROPT's pattern"


def run(
    seconds: float = 1.0,
    repeats: int = 3,
    quick: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Measure all rows in turns.

    seconds: s: length of one window
    repeats: number of windows of each row
    quick: one turn of short windows, 10 agents
    say: called with a text that says what is being measured
    """
    if quick:
        seconds = 0.5
        repeats = 1
    rows = _rows((10,) if quick else (10, 20))
    shown = measure_in_turns(rows, seconds, repeats, say)
    return {
        "rows": shown,
        "ratios": ratios(shown),
        "cores": os.cpu_count(),
        "seconds": seconds,
        "repeats": repeats,
    }


def _rows(agents: tuple[int, ...]) -> list[ProgramRow]:
    rows = []
    for n in agents:
        for algorithm in MEASURED_ALGORITHMS:
            options = {"algorithm": algorithm}
            rows += [
                ProgramRow("crazychoir", "rounds", "ring", n, p, options=options)
                for p in (1, 2)
            ]
            rows.append(
                ProgramRow(
                    DISROPT_PATTERN,
                    "mpi4py_rounds",
                    "ring",
                    n,
                    n,
                    ("mpi4py", "dill"),
                    options=options,
                )
            )
    return rows


def ratios(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return for each algorithm and size the ratio of our better row to the pattern.

    Each ratio stands beside the smallest ratio that the README promises.
    """
    found = []
    for n, algorithm in dict.fromkeys(
        (row["agents"], row["algorithm"]) for row in rows
    ):
        here = [
            row
            for row in rows
            if (row["agents"], row["algorithm"]) == (n, algorithm)
            and row["rounds_per_s"]
        ]
        ours = max(
            (row["rounds_per_s"] for row in here if row["name"] != DISROPT_PATTERN),
            default=None,
        )
        theirs = next(
            (row["rounds_per_s"] for row in here if row["name"] == DISROPT_PATTERN),
            None,
        )
        ratio = round(ours / theirs, 1) if ours and theirs else None
        found.append(
            {
                "agents": n,
                "algorithm": algorithm,
                "ratio": ratio,
                "promised": PROMISED_RATIOS[algorithm],
            }
        )
    return found


def table(result: dict[str, Any]) -> Table:
    """Return the rows as a table."""
    title = "Distributed algorithms on a ring: medians of one run"
    made = Table(title=title, box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    notes = fill_table(made, result["rows"], "algorithm")
    for ratio in result["ratios"]:
        times = "-" if ratio["ratio"] is None else f"{ratio['ratio']:g}"
        notes[
            f"{ratio['algorithm']}, {ratio['agents']} agents: {times} times {DISROPT_PATTERN}"
        ] = None
    made.caption = Text("\n".join(notes))
    made.caption_justify = "left"
    return made
