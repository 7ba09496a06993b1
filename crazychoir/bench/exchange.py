"""`crazychoir bench exchange`: rounds a second of the exchange between neighbours.

CycloneDDS and MPI are measured in the same run. Rows are measured in turns and repeated, so
that other load of the machine affects all of them alike. The table shows medians.
"""

import importlib.util
import json
import os
import secrets
import shutil
import statistics
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from crazychoir.config.addresses import LOCAL_ADDRESS
from crazychoir.launch.network import reserve_ports
from crazychoir.solve.group import ProgramGroup
from crazychoir.team.graph import Graph, k_regular, ring

EXCHANGE_GRAPHS: dict[str, Callable[[int], Graph]] = {
    "ring": ring,
    "4-regular": lambda n: k_regular(n, 4),
}
START_DEADLINE = 90.0
"""Seconds until all processes of a row must have found each other."""
EXCHANGE_WARM_UP = 0.3
"""Seconds of exchange before the measured window."""
BARE_PACKAGE_PROGRAM = (
    "import runpy, sys, types; package = types.ModuleType('crazychoir'); package.__path__ = [sys.argv.pop(1)]; "
    "sys.modules['crazychoir'] = package; runpy.run_module(sys.argv.pop(1), run_name='__main__')"
)
"""Program that runs a module of the package without importing the package's public names.

Importing missions and solvers would cost each process 1 s of CPU.
"""
PACKAGE_FOLDER = Path(__file__).parents[1]
NOT_INSTALLED_NOTE = "not measured: pip install crazychoir[bench]"


@dataclass
class ExchangeRow:
    """One program on one graph."""

    name: str
    """Name of the program."""
    module: str
    """Its module in crazychoir.bench.peers."""
    graph: str
    """Name of the graph."""
    agents: int
    """Number of agents."""
    processes: int
    """Number of processes among which the agents are divided."""
    extra: str = ""
    """Package that must be installed; empty for none."""
    note: str = ""
    """Why the row could not be measured; else empty."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further options of the program."""
    rounds: list[float] = field(default_factory=list)
    """Rounds a second, one value a window."""
    cpu: list[float] = field(default_factory=list)
    """CPU time of a message, us, one value a window."""

    def shown(self) -> dict[str, Any]:
        """Return the row of the result, with medians."""
        shown: dict[str, Any] = {"name": self.name, "graph": self.graph, **self.options}
        shown |= {"agents": self.agents, "processes": self.processes}
        shown["rounds_per_s"] = (
            round(statistics.median(self.rounds), 1) if self.rounds else None
        )
        shown["cpu_us_per_message"] = (
            round(statistics.median(self.cpu), 2) if self.cpu else None
        )
        return shown | ({"note": self.note} if self.note else {})


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
    rows = _rows(("ring",) if quick else tuple(EXCHANGE_GRAPHS))
    for turn in range(repeats):
        for row in rows:
            if row.extra and importlib.util.find_spec(row.extra) is None:
                row.note = NOT_INSTALLED_NOTE
                continue
            say(
                f"{turn + 1}/{repeats}: {row.name}, {row.graph} of {row.agents}, {row.processes} process(es)"
            )
            measure(row, seconds)
    shown = [row.shown() for row in rows]
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
    for name in (
        "graph",
        "agents",
        "program",
        "processes",
        "rounds/s",
        "CPU us/message",
    ):
        made.add_column(
            name, justify="left" if name in ("graph", "program") else "right"
        )
    for row in sorted(
        result["rows"], key=lambda row: (row["graph"] != "ring", row["agents"])
    ):
        rounds = row["rounds_per_s"]
        cpu = row["cpu_us_per_message"]
        figures = [
            "-" if figure is None else f"{figure:,.1f}" for figure in (rounds, cpu)
        ]
        made.add_row(
            row["graph"],
            str(row["agents"]),
            row["name"],
            str(row["processes"]),
            *figures,
        )
    notes = dict.fromkeys(
        f"{row['name']}: {row['note']}" for row in result["rows"] if "note" in row
    )
    notes[
        "Of several processes, each is bound to a core of its own where there are enough."
    ] = None
    # Text and not markup, because a note may hold brackets.
    made.caption = Text("\n".join(notes))
    return made


def _rows(graphs: tuple[str, ...]) -> list[ExchangeRow]:
    rows = []
    cores = os.cpu_count() or 1
    for graph in graphs:
        for n in (10, 30):
            for processes in (1, 2, n):
                rows.append(
                    ExchangeRow("crazychoir", "crazychoir_peer", graph, n, processes)
                )
            for processes in (2, n):
                rows.append(
                    ExchangeRow(
                        "cyclonedds",
                        "cyclonedds_peer",
                        graph,
                        n,
                        processes,
                        "cyclonedds",
                    )
                )
            mpi = ExchangeRow("mpi4py-pickle", "mpi4py_peer", graph, n, n, "mpi4py")
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


# One measurement ----------------------------------------------------------------------------------------------


def measure(row: ExchangeRow, seconds: float) -> None:
    """Measure one window of one row; an error becomes the note of the row."""
    neighbors = {
        i: EXCHANGE_GRAPHS[row.graph](row.agents).in_neighbors(i)
        for i in range(row.agents)
    }
    common = {
        "neighbors": neighbors,
        "warm": EXCHANGE_WARM_UP,
        "seconds": seconds,
        "swarm": f"bench{secrets.token_hex(4)}",
    }
    common |= row.options
    ranks = row.extra == "mpi4py"
    answers = row.agents if ranks else row.processes
    try:
        with (
            reserve_ports(dict.fromkeys(range(row.processes), LOCAL_ADDRESS)) as base,
            ProgramGroup(
                _mpi_command(row, common) if ranks else _commands(row, common, base)
            ) as group,
        ):
            list(group.answers(answers, START_DEADLINE, "do not find each other"))
            group.tell("go")
            found = [
                answer
                for _, answer in group.answers(
                    answers, EXCHANGE_WARM_UP + seconds + 20.0, "do not answer"
                )
            ]
    except (TimeoutError, OSError) as error:
        row.note = f"failed: {error}"
        return
    row.rounds.append(min(one["rounds_per_s"] for one in found))
    messages = sum(one["messages_per_s"] for one in found)
    if messages:
        row.cpu.append(1e6 * sum(one["cores"] for one in found) / messages)


def _commands(row: ExchangeRow, common: dict[str, Any], base: int) -> list[list[str]]:
    """Return one command a process, each with a contiguous part of the agents.

    Each process gets a core of its own if there are enough.
    base: port of the first process
    """
    endpoints = [f"tcp/{LOCAL_ADDRESS}:{base + p}" for p in range(row.processes)]
    domain = 1 + secrets.randbelow(100)  # the ports of higher domains may be in use
    cores = sorted(os.sched_getaffinity(0))
    commands = []
    for p in range(row.processes):
        mine = [i for i in range(row.agents) if i * row.processes // row.agents == p]
        others = [endpoint for q, endpoint in enumerate(endpoints) if q != p]
        own: dict[str, Any] = {"mine": mine, "process": f"{p}-{common['swarm']}"}
        own |= {"listen": [endpoints[p]], "connect": others}
        if 1 < row.processes <= len(cores):
            own["core"] = cores[p]
        commands.append(_python(row, {**common, **own, "domain": domain}))
    return commands


def _mpi_command(row: ExchangeRow, common: dict[str, Any]) -> list[list[str]]:
    beside = Path(sys.executable).parent / "mpiexec"
    mpiexec = str(beside) if beside.exists() else shutil.which("mpiexec") or "mpiexec"
    return [[mpiexec, "-n", str(row.agents), *_python(row, common)]]


def _python(row: ExchangeRow, specification: dict[str, Any]) -> list[str]:
    return [
        sys.executable,
        "-c",
        BARE_PACKAGE_PROGRAM,
        str(PACKAGE_FOLDER),
        f"crazychoir.bench.peers.{row.module}",
        json.dumps(specification),
    ]
