"""`crazychoir bench scale`: cost of 10 to 1000 agents in 1 to 8 processes, and a model for more.

Each agent exchanges with four neighbours, scattered over all processes, as fast as possible. A cell
is one pair (number of agents, number of processes). A model of the cost is fitted to all cells by
non-negative least squares of relative errors:

    processor    s a second = steps/s * step + messages/s to others * far + frames/s * frame
    memory       B of all = processes * process + agents * agent + ends of links * link
    start        s = once + processes * process + ends of links * link
    bytes        B/s over the network = messages/s to others * message + frames/s * head

A step has four messages. `far` is the additional cost of a message to another process.
"""

import random
import secrets
import statistics
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Group as Lines
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from crazychoir.bench.harness import ask_peers, peer_command, share_agents
from crazychoir.config.addresses import LOCAL_ADDRESS
from crazychoir.errors import ConfigError
from crazychoir.launch.namespaces import SwitchedNamespaces, make_switched_namespaces
from crazychoir.launch.network import reserve_ports
from crazychoir.team.graph import k_regular


@dataclass(frozen=True, slots=True)
class ScaleBenchSettings:
    """Settings of `crazychoir bench scale`: the measured cells."""

    agents: tuple[int, ...] = (10, 30, 100, 300, 1000)
    """Numbers of agents."""
    processes: tuple[int, ...] = (1, 2, 4, 8)
    """Numbers of processes."""
    degree: int = 4
    """Neighbours of each agent."""
    agents_per_process: int = 5
    """Least agents of a process, if there are several processes."""
    start_deadline: float = 120.0
    """Seconds until all processes must have found each other."""
    warm_up_time: float = 0.5
    """Seconds of exchange before the measured window."""


SCALE_BENCH = ScaleBenchSettings()


QUICK_RUN_CELLS = (10, 40), (1, 2)
"""Numbers of agents and of processes of a quick run."""


@dataclass(frozen=True, slots=True)
class HostEstimateSettings:
    """The hosts for which the model estimates the cost of a large swarm."""

    hosts: int = 100
    """Number of hosts in the estimate."""
    agents_per_host: int = 100
    """Agents on each of these hosts."""
    round_rate: float = 10.0
    """Rounds a second in the estimate."""
    cores: int = 8
    """Cores of each host."""


HOST_ESTIMATE = HostEstimateSettings()


MODEL_TERMS = {
    "processor": ("step", "far", "frame"),
    "memory": ("process", "agent", "link"),
    "start": ("once", "process", "link"),
    "bytes": ("message", "head"),
}
"""Coefficients of each model."""


@dataclass
class ScaleCell:
    """One measurement: some agents in some processes.

    Figures are sums over all processes and rates a second, unless the field says otherwise.
    """

    agents: int
    """Number of agents."""
    processes: int
    """Number of processes."""
    rounds: float
    """Rounds of the slowest agent."""
    steps: float
    """Steps of all agents."""
    near: float
    """Messages within a process."""
    far: float
    """Messages to other processes."""
    frames: float
    """Frames over the network."""
    bytes: float
    """Bytes over the network."""
    cpu: float
    """Processor time, s."""
    memory: float
    """Memory, B, not a rate."""
    start: float
    """Seconds until all processes had found each other."""
    threads: int
    """Threads of a single process, the largest number."""

    def ends(self) -> int:
        """Return the number of link ends: each process has a link to each other one."""
        return self.processes * (self.processes - 1)


@dataclass
class FittedModel:
    """A model of one figure, with its relative errors as shares."""

    coefficients: dict[str, float]
    """Coefficients, by term."""
    error: float
    """Median error in the cells that it was fitted to."""
    worst: float
    """Largest error in these cells."""
    left_out: float | None
    """Median error in cells of a number of agents, or of processes, that was left out of the fit.

    None if there are too few cells.
    """
    left_out_worst: float | None
    """Largest error in these cells; None if there are too few."""


@dataclass(frozen=True, slots=True)
class ScaleChoice:
    """The cells to measure; an empty field stands for all of the usual ones."""

    agents: tuple[int, ...] = ()
    """Numbers of agents."""
    processes: tuple[int, ...] = ()
    """Numbers of processes; those with too few agents are left out."""


def choose_cells(quick: bool, choice: ScaleChoice) -> list[tuple[int, int]]:
    """Return the pairs of agents and processes to measure.

    quick: fewer pairs
    Raises ConfigError if no pair has enough agents for its processes.
    """
    usual = QUICK_RUN_CELLS if quick else (SCALE_BENCH.agents, SCALE_BENCH.processes)
    cells = [
        (n, p)
        for n in dict.fromkeys(choice.agents or usual[0])
        for p in dict.fromkeys(choice.processes or usual[1])
        if p == 1 or n >= SCALE_BENCH.agents_per_process * p
    ]
    if not cells:
        raise ConfigError(
            "bench scale",
            f"processes {choice.processes}, agents {choice.agents}",
            f"at least {SCALE_BENCH.agents_per_process} agents a process",
        )
    return cells


def run(
    quick: bool,
    namespaces: bool,
    repeats: int,
    say: Callable[[str], None],
    choice: ScaleChoice | None = None,
) -> dict[str, Any]:
    """Measure all cells, pairs of agents and processes, and fit the model of the cost.

    quick: fewer cells, one measurement each
    namespaces: whether each process has its own network namespace
    repeats: measurements of each cell; its figures are medians
    say: called with a text that says what is being measured
    choice: the cells, without a model; None: the usual ones
    Returns the object that `crazychoir bench scale --json` prints.
    """
    cells = []
    count = 1 if quick else repeats
    for n, p in choose_cells(quick, choice or ScaleChoice()):
        turns = []
        for k in range(count):
            say(f"{n} agents in {p} process(es), {k + 1} of {count}")
            turns.append(measure(n, p, 1.0 if quick else 3.0, namespaces))
        cells.append(_median_cell(turns))
    names = () if choice else MODEL_TERMS
    fits = {name: fit_model(name, cells) for name in names}
    return {
        "cells": [asdict(cell) for cell in cells],
        "fits": {name: asdict(one) for name, one in fits.items()},
        "needs": estimate_hosts(fits) if fits else [],
        "namespaces": namespaces,
        "repeats": count,
    }


def _median_cell(turns: list[ScaleCell]) -> ScaleCell:
    """Return the medians of several measurements of one cell."""
    rows = [asdict(turn) for turn in turns]
    medians = {key: statistics.median(row[key] for row in rows) for key in rows[0]}
    whole = {key: rows[0][key] for key in ("agents", "processes", "threads")}
    return ScaleCell(**medians | whole)


# One measurement ----------------------------------------------------------------------------------------------------


def measure(n: int, p: int, seconds: float, namespaces: bool) -> ScaleCell:
    """Measure one window of one cell.

    n: number of agents
    p: number of processes
    seconds: s: length of the window
    namespaces: whether each process has a network of its own
    Raises TimeoutError if the processes do not find each other.
    """
    ids = random.Random(1).sample(range(n), n)  # noqa: S311 - scatters the agents
    graph = k_regular(n, SCALE_BENCH.degree)
    neighbors = {
        ids[i]: sorted(ids[j] for j in graph.in_neighbors(i)) for i in range(n)
    }
    with ExitStack() as stack:
        addresses = {f"h{k}": f"10.76.0.{k + 1}" for k in range(p)}
        hosts = (
            stack.enter_context(make_switched_namespaces(addresses))
            if namespaces
            else None
        )
        base = stack.enter_context(
            reserve_ports(dict.fromkeys(range(p), LOCAL_ADDRESS))
        )
        peers = ask_peers(
            peer_commands(neighbors, p, seconds, hosts, addresses, base),
            p,
            SCALE_BENCH.start_deadline,
            SCALE_BENCH.warm_up_time + seconds + 30.0,
        )
    found = peers.answers
    total = {
        key: sum(one[key] for one in found)
        for key in ("cpu", "steps", "messages", "frames", "bytes", "memory")
    }
    far = sum(one["far"] * one["messages"] for one in found)
    slowest = min(one["steps"] for one in found) / (n / p)
    return ScaleCell(
        n,
        p,
        slowest,
        total["steps"],
        total["messages"] - far,
        far,
        total["frames"],
        total["bytes"],
        total["cpu"],
        total["memory"],
        peers.start_s,
        max(one["threads"] for one in found),
    )


def peer_commands(
    neighbors: Mapping[int, list[int]],
    p: int,
    seconds: float,
    hosts: SwitchedNamespaces | None,
    addresses: dict[str, str],
    base: int,
) -> list[list[str]]:
    """Return one command a process, each with a contiguous part of the agents.

    The processes use the ports from `base` on.
    """
    n = len(neighbors)
    at = list(addresses.values()) if hosts is not None else [LOCAL_ADDRESS] * p
    ends = [f"tcp/{address}:{base + k}" for k, address in enumerate(at)]
    common = {
        "neighbors": neighbors,
        "warm": SCALE_BENCH.warm_up_time,
        "seconds": seconds,
        "processes": p,
        "swarm": f"bench{secrets.token_hex(4)}",
    }
    made = []
    for k in range(p):
        own = {
            "mine": share_agents(n, p, k),
            "process": f"{k}-scale",
            "host": f"h{k}",
            "listen": [ends[k]],
            "connect": ends[:k],
        }
        inside = hosts.command(f"h{k}") if hosts is not None else []
        made.append([*inside, *peer_command("scale", {**common, **own})])
    return made


# The model ----------------------------------------------------------------------------------------------------------


def cell_factors(name: str, cell: ScaleCell) -> list[float]:
    """Return the factors of a model's coefficients in a cell."""
    match name:
        case "processor":
            return [cell.steps, cell.far, cell.frames]
        case "memory":
            return [cell.processes, cell.agents, cell.ends()]
        case "start":
            return [1.0, cell.processes, cell.ends()]
        case _:
            return [cell.far, cell.frames]


def measured_figure(name: str, cell: ScaleCell) -> float:
    """Return the measured figure that a model predicts."""
    return {
        "processor": cell.cpu,
        "memory": cell.memory,
        "start": cell.start,
        "bytes": cell.bytes,
    }[name]


def fit_coefficients(name: str, cells: list[ScaleCell]) -> np.ndarray:
    """Return the coefficients >= 0 that minimise the squares of the relative errors in the cells.

    name: the model, a key of MODEL_TERMS
    """
    from scipy.optimize import nnls

    y = np.array([measured_figure(name, cell) for cell in cells])
    rows = np.array([cell_factors(name, cell) for cell in cells]) / y[:, None]
    scale = np.where(rows.any(axis=0), np.abs(rows).max(axis=0), 1.0)
    return np.asarray(nnls(rows / scale, np.ones(len(y)))[0] / scale)


def relative_errors(
    name: str, coefficients: np.ndarray, cells: list[ScaleCell]
) -> list[float]:
    """Return the relative errors of a model in these cells."""
    return [
        abs(
            float(coefficients @ cell_factors(name, cell)) / measured_figure(name, cell)
            - 1.0
        )
        for cell in cells
    ]


def fit_model(name: str, cells: list[ScaleCell]) -> FittedModel:
    """Return the model of a figure, with its errors in cells of the fit and in other cells."""
    cells = [cell for cell in cells if measured_figure(name, cell) > 0.0]
    coefficients = fit_coefficients(name, cells)
    inside = relative_errors(name, coefficients, cells)
    outside = []
    for key in ("agents", "processes"):
        for value in dict.fromkeys(getattr(cell, key) for cell in cells):
            others = [cell for cell in cells if getattr(cell, key) != value]
            if len(others) >= len(coefficients):
                outside += relative_errors(
                    name,
                    fit_coefficients(name, others),
                    [cell for cell in cells if getattr(cell, key) == value],
                )
    named = dict(zip(MODEL_TERMS[name], map(float, coefficients), strict=True))
    unseen = (statistics.median(outside), max(outside)) if outside else (None, None)
    return FittedModel(named, statistics.median(inside), max(inside), *unseen)


def estimate_hosts(fits: dict[str, FittedModel]) -> list[dict[str, float]]:
    """Return what the hosts of HOST_ESTIMATE need, with its agents a host and its rounds a second.

    The first row has one process a host, the second one process a core.
    All neighbours are on other hosts, and no two messages share a frame. This is the worst case:
    real swarms need less.
    """
    rows = []
    for p in (1, HOST_ESTIMATE.cores):
        processes = HOST_ESTIMATE.hosts * p
        steps = HOST_ESTIMATE.agents_per_host * HOST_ESTIMATE.round_rate
        far = frames = steps * SCALE_BENCH.degree
        links = processes - 1
        cpu, memory, bytes_, start = (
            fits[name].coefficients
            for name in ("processor", "memory", "bytes", "start")
        )
        rows.append(
            {
                "processes": processes,
                "links": processes * links / 2,
                "cores_a_host": steps * cpu["step"]
                + far * cpu["far"]
                + frames * cpu["frame"],
                "memory_a_host": p * memory["process"]
                + HOST_ESTIMATE.agents_per_host * memory["agent"]
                + p * links * memory["link"],
                "bytes_a_host": far * bytes_["message"] + frames * bytes_["head"],
                "start": start["once"]
                + p * start["process"]
                + p * links * start["link"],
            }
        )
    return rows


# What is shown ------------------------------------------------------------------------------------------------------


def format_share(error: float | None) -> str:
    """Return a share, 0 to 1, as a text in per cent; "-" for None."""
    return "-" if error is None else f"{error:.0%}"


def table(result: dict[str, Any]) -> RenderableType:
    """Return the cells, the model and its estimate, if there is one, as tables."""
    columns = (
        "agents",
        "proc",
        "rounds/s",
        "us/msg",
        "B/msg",
        "msg/frame",
        "MiB",
        "start s",
        "threads",
    )
    cells = Table(
        *columns,
        title="Exchange with four neighbours each, scattered over the processes",
    )
    for row in result["cells"]:
        cell = ScaleCell(**row)
        messages = cell.near + cell.far
        cells.add_row(
            str(cell.agents),
            str(cell.processes),
            f"{cell.rounds:,.0f}",
            f"{1e6 * cell.cpu / messages:.1f}",
            f"{cell.bytes / cell.far:.0f}" if cell.bytes else "-",
            f"{cell.far / cell.frames:.1f}" if cell.frames else "-",
            f"{cell.memory / 2**20:.0f}",
            f"{cell.start:.1f}",
            str(cell.threads),
        )
    where = "a network namespace each" if result["namespaces"] else "one network"
    measured: list[RenderableType] = [
        cells,
        Text(f"{where}; medians of {result['repeats']}"),
    ]
    if not result["fits"]:
        return Lines(*measured)
    fits = Table(
        "model of", "coefficients", "off", "worst", "left out", "worst", title="Fitted"
    )
    for name, one in result["fits"].items():
        said = ", ".join(
            f"{term} {value:.3g}" for term, value in one["coefficients"].items()
        )
        fits.add_row(
            name,
            said,
            *map(
                format_share,
                (one[key] for key in ("error", "worst", "left_out", "left_out_worst")),
            ),
        )
    more = Table(
        "processes",
        "links",
        "cores/host",
        "MiB/host",
        "Mbit/s a host",
        "start, s",
        title=(
            f"{HOST_ESTIMATE.hosts * HOST_ESTIMATE.agents_per_host:,} agents on "
            f"{HOST_ESTIMATE.hosts} hosts, {HOST_ESTIMATE.round_rate:g} rounds/s"
        ),
    )
    for row in result["needs"]:
        more.add_row(
            str(row["processes"]),
            f"{row['links']:,.0f}",
            f"{row['cores_a_host']:.2f}",
            f"{row['memory_a_host'] / 2**20:,.0f}",
            f"{8e-6 * row['bytes_a_host']:.1f}",
            f"{row['start']:.0f}",
        )
    return Lines(*measured, fits, more)
