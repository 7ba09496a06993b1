"""The harness of benchmarks with several programs: start them, wait until all are ready, say go, collect.

Each program gets one JSON argument, prints {"ready": true}, starts at a line "go" and answers with
one JSON line, see crazychoir.bench.peers.peers. Rows are measured in turns and repeated, so that
other load of the machine affects all of them alike.
"""

import importlib.util
import json
import os
import secrets
import shutil
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.table import Table

from crazychoir.config.addresses import LOCAL_ADDRESS
from crazychoir.files.private_folder import scratch_folder
from crazychoir.launch.network import reserve_ports
from crazychoir.solve.group import ProgramGroup
from crazychoir.team.graph import Graph, k_regular, ring

BENCH_GRAPHS: dict[str, Callable[[int], Graph]] = {
    "ring": ring,
    "4-regular": lambda n: k_regular(n, 4),
}
START_DEADLINE = 90.0
"""Seconds until all processes of a row must have found each other."""
EXCHANGE_WARM_UP = 0.3
"""Seconds of exchange before the measured window."""
ANSWER_PATIENCE = 20.0
"""Seconds after the window until all processes must have answered."""
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
class ProgramRow:
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
    packages: tuple[str, ...] = ()
    """Packages that must be installed."""
    note: str = ""
    """Why the row could not be measured; else empty."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further options of the program."""
    rounds: list[float] = field(default_factory=list)
    """Rounds a second, one value a window."""
    cpu: list[float] = field(default_factory=list)
    """CPU time of a message, us, one value a window."""
    resent: list[float] = field(default_factory=list)
    """Messages that were sent again, a needed message, one value a window."""

    @property
    def has_ranks(self) -> bool:
        """Whether MPI starts the program, with one rank an agent."""
        return "mpi4py" in self.packages

    def describe(self) -> str:
        """Return the program, its options, graph and processes in words."""
        what = ", ".join([self.name, *self.options.values()])
        return f"{what}, {self.graph} of {self.agents}, {self.processes} process(es)"

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
        if self.resent:
            shown["resent_per_message"] = round(statistics.median(self.resent), 3)
        return shown | ({"note": self.note} if self.note else {})


@dataclass(frozen=True, slots=True)
class PeerAnswers:
    """The answers of programs that were started together."""

    answers: list[dict[str, Any]]
    """One answer a program."""
    start_s: float
    """Seconds until all programs were ready."""


def measure_in_turns(
    rows: list[ProgramRow],
    seconds: float,
    repeats: int,
    say: Callable[[str], None],
) -> list[dict[str, Any]]:
    """Measure all rows in turns and return the rows of the result.

    seconds: s: length of one window
    repeats: number of windows of each row
    say: called with a text that says what is being measured
    """
    for turn in range(repeats):
        for row in rows:
            if is_installed(row):
                say(f"{turn + 1}/{repeats}: {row.describe()}")
                measure(row, seconds)
    return [row.shown() for row in rows]


def is_installed(row: ProgramRow) -> bool:
    """Return whether the packages of a row are installed; if not, note it."""
    if all(importlib.util.find_spec(name) is not None for name in row.packages):
        return True
    row.note = NOT_INSTALLED_NOTE
    return False


def measure(row: ProgramRow, seconds: float) -> None:
    """Measure one window of one row; an error becomes the note of the row."""
    found = ask_row(row, seconds)
    if not found:
        return
    row.rounds.append(min(one["rounds_per_s"] for one in found))
    messages = sum(one["messages_per_s"] for one in found)
    if messages:
        row.cpu.append(1e6 * sum(one["cores"] for one in found) / messages)
        if all("resent_per_s" in one for one in found):
            row.resent.append(sum(one["resent_per_s"] for one in found) / messages)


def ask_row(row: ProgramRow, seconds: float) -> list[dict[str, Any]]:
    """Run the processes of a row for one window, and return their answers.

    An error becomes the note of the row; then there are no answers.
    """
    graph = BENCH_GRAPHS[row.graph](row.agents)
    common = {
        "neighbors": {i: graph.in_neighbors(i) for i in range(row.agents)},
        "warm": EXCHANGE_WARM_UP,
        "seconds": seconds,
        "swarm": f"bench{secrets.token_hex(4)}",
    }
    common |= row.options
    answers = row.agents if row.has_ranks else row.processes
    patience = EXCHANGE_WARM_UP + seconds + ANSWER_PATIENCE
    try:
        with (
            reserve_ports(dict.fromkeys(range(row.processes), LOCAL_ADDRESS)) as base,
            scratch_folder("crazychoir-bench-") as folder,
        ):
            commands = (
                _mpi_command(row, common)
                if row.has_ranks
                else _commands(row, {**common, "folder": str(folder)}, base)
            )
            return ask_peers(commands, answers, START_DEADLINE, patience).answers
    except (TimeoutError, OSError) as error:
        row.note = f"failed: {error}"
        return []


def ask_peers(
    commands: list[list[str]], count: int, start_deadline: float, patience: float
) -> PeerAnswers:
    """Start programs, wait until all are ready, say go, and return their answers.

    count: number of answers
    start_deadline: s until all programs must be ready
    patience: s after "go" until all programs must have answered
    Raises TimeoutError if they are late.
    """
    began = time.perf_counter()
    with ProgramGroup(commands) as group:
        list(group.answers(count, start_deadline, "do not find each other"))
        start_s = time.perf_counter() - began
        group.tell("go")
        answers = [
            answer for _, answer in group.answers(count, patience, "do not answer")
        ]
    return PeerAnswers(answers, start_s)


def peer_command(module: str, specification: dict[str, Any]) -> list[str]:
    """Return the command that runs a module of crazychoir.bench.peers with its argument."""
    return [
        sys.executable,
        "-c",
        BARE_PACKAGE_PROGRAM,
        str(PACKAGE_FOLDER),
        f"crazychoir.bench.peers.{module}",
        json.dumps(specification),
    ]


def share_agents(agents: int, processes: int, process: int) -> list[int]:
    """Return the contiguous part of the agents that a process holds."""
    return [i for i in range(agents) if i * processes // agents == process]


def fill_table(
    made: Table, rows: list[dict[str, Any]], first_column: str
) -> dict[str, None]:
    """Add columns and rows to a table; return the notes of rows that could not be measured.

    first_column: key of the rows that the first column shows
    """
    counts_resent = any("resent_per_message" in row for row in rows)
    columns = [
        first_column,
        "agents",
        "program",
        "processes",
        "rounds/s",
        "CPU us/message",
        *(["resent"] if counts_resent else []),
    ]
    for name in columns:
        is_text = name in (first_column, "program")
        made.add_column(name, justify="left" if is_text else "right")
    for row in rows:
        figures = [
            "-" if figure is None else f"{figure:,.1f}"
            for figure in (row["rounds_per_s"], row["cpu_us_per_message"])
        ]
        if counts_resent:
            resent = row.get("resent_per_message")
            figures.append("-" if resent is None else f"{resent:.1%}")
        made.add_row(
            row[first_column],
            str(row["agents"]),
            row["name"],
            str(row["processes"]),
            *figures,
        )
    return dict.fromkeys(
        f"{row['name']}: {row['note']}" for row in rows if "note" in row
    )


def _commands(row: ProgramRow, common: dict[str, Any], base: int) -> list[list[str]]:
    """Return one command a process, each with a contiguous part of the agents.

    Each process gets a core of its own if there are enough.
    base: port of the first process
    """
    endpoints = [f"tcp/{LOCAL_ADDRESS}:{base + p}" for p in range(row.processes)]
    domain = 1 + secrets.randbelow(100)  # the ports of higher domains may be in use
    cores = sorted(os.sched_getaffinity(0))
    shares = [share_agents(row.agents, row.processes, p) for p in range(row.processes)]
    commands = []
    for p, mine in enumerate(shares):
        others = [endpoint for q, endpoint in enumerate(endpoints) if q != p]
        own: dict[str, Any] = {"mine": mine, "process": f"{p}-{common['swarm']}"}
        own |= {"listen": [endpoints[p]], "connect": others}
        own |= {"number": p, "shares": shares}
        if 1 < row.processes <= len(cores):
            own["core"] = cores[p]
        commands.append(peer_command(row.module, {**common, **own, "domain": domain}))
    return commands


def _mpi_command(row: ProgramRow, common: dict[str, Any]) -> list[list[str]]:
    beside = Path(sys.executable).parent / "mpiexec"
    mpiexec = str(beside) if beside.exists() else shutil.which("mpiexec") or "mpiexec"
    return [[mpiexec, "-n", str(row.agents), *peer_command(row.module, common)]]
