"""`crazychoir bench exchange`: rounds a second of the exchange between neighbours, and round trips.

Plain sockets, Zenoh alone, ZeroMQ, CycloneDDS and MPI are measured in the same run: as many agents
in as many processes, with the same payload. Rows are measured in turns and repeated, so that other
load of the machine affects all of them alike. The tables show medians.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from crazychoir.bench.harness import (
    BENCH_GRAPHS,
    ProgramRow,
    fill_table,
    measure_in_turns,
)
from crazychoir.bench.round_trips import measure_trips, trip_table
from crazychoir.errors import ConfigError

USUAL_AGENTS: Final = (10, 30)
"""Numbers of agents without a choice."""


@dataclass(frozen=True, slots=True)
class ExchangeChoice:
    """The teams to measure; an empty field stands for all of the usual ones."""

    agents: tuple[int, ...] = ()
    """Numbers of agents."""
    processes: tuple[int, ...] = ()
    """Numbers of processes; those above the number of agents are left out."""
    graphs: tuple[str, ...] = ()
    """Names of graphs, of BENCH_GRAPHS."""


def run(
    seconds: float = 0.8,
    repeats: int = 3,
    quick: bool = False,
    say: Callable[[str], None] = lambda text: None,
    choice: ExchangeChoice | None = None,
) -> dict[str, Any]:
    """Measure all rows.

    seconds: s: length of one window
    repeats: number of windows of each row
    quick: rings only, one turn of short windows
    say: called with a text that says what is being measured
    choice: teams to measure; None: the usual ones, and round trips
    """
    has_trips = choice is None
    choice = choice or ExchangeChoice()
    if quick:
        seconds = min(seconds, 0.5)
        repeats = 1
        choice = replace(choice, graphs=choice.graphs or ("ring",))
    rows = _rows(choice)
    if not rows:
        raise ConfigError(
            "bench exchange",
            f"{_list_numbers(choice.processes)} processes, {_list_numbers(choice.agents)} agents",
            "at most as many processes as agents",
        )
    shown = measure_in_turns(rows, seconds, repeats, say)
    return {
        "rows": shown,
        "round_trips": measure_trips(seconds, repeats, say) if has_trips else [],
        "ratios": _ratios(shown),
        "cores": os.cpu_count(),
        "seconds": seconds,
        "repeats": repeats,
    }


def run_trips(
    seconds: float = 1.5,
    repeats: int = 5,
    quick: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Measure round trips alone; the arguments are those of `run`."""
    if quick:
        seconds = min(seconds, 0.5)
        repeats = 1
    return {
        "rows": [],
        "round_trips": measure_trips(seconds, repeats, say),
        "cores": os.cpu_count(),
        "seconds": seconds,
        "repeats": repeats,
    }


def table(result: dict[str, Any]) -> RenderableType:
    """Return the rows, and the round trips, as tables."""
    tables = []
    if result["rows"]:
        tables.append(exchange_table(result["rows"]))
    if result["round_trips"]:
        tables.append(trip_table(result["round_trips"]))
    return Group(*tables)


def exchange_table(shown: list[dict[str, Any]]) -> Table:
    """Return the rows of the exchange as a table."""
    made = Table(title="Neighbours' exchange: medians of one run")
    rows = sorted(shown, key=lambda row: (row["graph"] != "ring", row["agents"]))
    notes = fill_table(made, rows, "graph")
    notes[
        "Of several processes, each is bound to a core of its own where there are enough."
    ] = None
    # Text and not markup, because a note may hold brackets.
    made.caption = Text("\n".join(notes))
    return made


def _rows(choice: ExchangeChoice) -> list[ProgramRow]:
    rows = []
    for graph in choice.graphs or tuple(BENCH_GRAPHS):
        for n in dict.fromkeys(choice.agents or USUAL_AGENTS):
            for processes in dict.fromkeys(choice.processes or (1, 2, n)):
                if processes <= n:
                    rows.extend(_list_programs(graph, n, processes))
    return rows


def _list_numbers(numbers: tuple[int, ...]) -> str:
    """Return numbers as text."""
    return " and ".join(map(str, numbers))


def _list_programs(graph: str, agents: int, processes: int) -> list[ProgramRow]:
    """Return a row for each program that can divide these agents among these processes."""
    team = (graph, agents, processes)
    rows = [ProgramRow("crazychoir", "crazychoir_peer", *team)]
    if processes > 1:
        rows.append(ProgramRow("plain sockets", "socket_peer", *team))
        rows.append(ProgramRow("zenoh", "zenoh_peer", *team))
        rows.append(ProgramRow("pyzmq", "pyzmq_peer", *team, ("zmq",)))
        rows.append(ProgramRow("cyclonedds", "cyclonedds_peer", *team, ("cyclonedds",)))
    if processes == agents:
        mpi = ProgramRow("mpi4py-pickle", "mpi4py_peer", *team, ("mpi4py",))
        cores = os.cpu_count() or 1
        if agents > cores:
            mpi.note = f"MPI polls: it collapses with more ranks ({agents}) than cores ({cores})"
        rows.append(mpi)
    return rows


def _ratios(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return the ratios that the project promises, from the medians of this run."""
    rate = {
        (r["name"], r["graph"], r["agents"], r["processes"]): r["rounds_per_s"]
        for r in rows
    }
    two = rate.get(("crazychoir", "ring", 10, 2))
    one = rate.get(("crazychoir", "ring", 30, 1))
    pairs = {
        "ring 10: crazychoir, two processes / cyclonedds, one an agent": (
            two,
            rate.get(("cyclonedds", "ring", 10, 10)),
        ),
        "ring 10: crazychoir, two processes / mpi4py-pickle": (
            two,
            rate.get(("mpi4py-pickle", "ring", 10, 10)),
        ),
        "ring 30: crazychoir, one process / one an agent": (
            one,
            rate.get(("crazychoir", "ring", 30, 30)),
        ),
    }
    return {
        name: round(ours / other, 1)
        for name, (ours, other) in pairs.items()
        if ours and other
    }
