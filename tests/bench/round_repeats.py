"""What loss, delay and slow agents cost the rounds of a team, in virtual time: seconds and repeats.

    python tests/bench/round_repeats.py

The figures are exact: they do not depend on the machine. A repeat counts as a share of the messages
that the rounds need.
"""

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.bus.port import Bus
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.team import graph as graphs
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph

ROUND_COUNT = 60
LOSSES = (0.0, 0.005, 0.02, 0.2, 0.5)
TIMES = ((0.0, 0.0), (0.001, 0.0005), (0.02, 0.0), (0.002, 0.03), (0.002, 0.12))
"""(delay of a message, mean time of a computation) in s."""


@dataclass(frozen=True)
class RoundCase:
    """A team, its network, and its computations."""

    name: str
    graph: Graph
    loss: float
    delay: float
    """s."""
    computation: float
    """s, mean."""


def list_cases() -> Iterator[RoundCase]:
    """Yield the rows of the table."""
    regular = [[i, (i + step) % 30] for i in range(30) for step in (1, 2)]
    teams = {
        "ring of 10": graphs.ring(10),
        "4-regular of 30": Graph.from_edges(30, regular),
    }
    for name, graph in teams.items():
        for loss in LOSSES:
            for delay, computation in TIMES:
                yield RoundCase(name, graph, loss, delay, computation)


def measure(case: RoundCase) -> tuple[float, float]:
    """Return the virtual time in s of ROUND_COUNT rounds, and the repeats for each needed message."""

    async def main(clock: Clock) -> tuple[float, float]:
        rule = ImpairmentRule({"loss": case.loss, "delay": case.delay})
        bus = Bus(clock, Impairment(1, [rule]))
        bus.impairment.begin(clock.now())
        team = [Communicator(bus.port(i), case.graph) for i in case.graph.ids]
        ends = await asyncio.gather(*(run_rounds(clock, c, case) for c in team))
        needed = ROUND_COUNT * sum(len(case.graph.in_neighbors(c.id)) for c in team)
        return max(ends), sum(c.port.counters.resent for c in team) / needed

    return run_virtual(main)


async def run_rounds(
    clock: Clock, communicator: Communicator, case: RoundCase
) -> float:
    """Compute and exchange; return the time in s of the last exchange."""
    draws = np.random.default_rng(communicator.id)
    for _ in range(ROUND_COUNT):
        if case.computation > 0.0:
            # Times of computations vary.
            await clock.sleep(case.computation * draws.gamma(10.0, 0.1))
        await communicator.neighbors_exchange(np.zeros(2))
    ended = clock.now()
    await communicator.close()
    return ended


def main() -> None:
    """Print the table."""
    table = Table("team", "loss", "delay, ms", "computation, ms", "time, s", "repeats")
    for case in list_cases():
        seconds, repeats = measure(case)
        table.add_row(
            case.name,
            f"{case.loss:.0%}",
            f"{1e3 * case.delay:g}",
            f"{1e3 * case.computation:g}",
            f"{seconds:.2f}",
            f"{repeats:.1%}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
