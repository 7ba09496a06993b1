"""crazychoir bench latency: how late the control tick is while the same process solves, and from pose to command.

Both are measured in one process in real time. Late is a tick's start after its due time; `added_p99_ms` is the p99
while solving less the p99 alone, of blocks that alternate in this run. From pose to command is from a pose in the
pilot's mailbox to the command on the link, with all drones of the process hovering.
"""

import asyncio
import json
import sys
import time
from collections.abc import Awaitable
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any, cast

import numpy as np
import typer
from rich.table import Table

from crazychoir.agent.agent import Agent
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import CrazyChoirError
from crazychoir.flight.pilot import Pilot
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission import Mission
from crazychoir.launch import number_options as options
from crazychoir.launch.console import STDOUT, fail
from crazychoir.routing.instance.generate import random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.runtime.clock import SECOND, Clock, run_wall
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.owner import WorldOwner
from crazychoir.solve.solving import solve_here
from crazychoir.types import Acceleration, Command, Heard, State

RATE = 100.0
"""Hz of the control tick."""
WARM_UP = 0.3
"""s at the start of a block that are not counted: the loop itself starts."""


@dataclass(frozen=True)
class Lateness:
    """One row: quantiles in ms over all samples of this name."""

    name: str
    drones: int
    samples_ns: tuple[int, ...]

    @property
    def p99_ms(self) -> float:
        """The 99th percentile."""
        return self._quantile(99.0)

    def to_json(self) -> dict[str, Any]:
        """As `--json` prints it."""
        return {
            "name": self.name,
            "drones": self.drones,
            "p50_ms": self._quantile(50.0),
            "p99_ms": self.p99_ms,
            "max_ms": self._quantile(100.0),
            "samples": len(self.samples_ns),
        }

    def _quantile(self, percent: float) -> float:
        return round(float(np.percentile(self.samples_ns, percent)) / 1e6, 4)


# The control tick beside the solver ------------------------------------------------------------------------------


async def watched(clock: Clock, work: Awaitable[Any], late_ns: list[int]) -> Any:
    """Await the work with a control tick beside it."""
    ticks = asyncio.create_task(_tick(clock, late_ns), name="control tick")
    try:
        return await work
    finally:
        ticks.cancel()
        await asyncio.wait([ticks])


async def _tick(clock: Clock, late_ns: list[int]) -> None:
    ticks = clock.ticks(RATE)
    counted_from_ns = clock.now_ns() + round(WARM_UP * SECOND)
    missed = 0
    async for due_ns in ticks:
        if due_ns >= counted_from_ns:
            late_ns.append(clock.now_ns() - due_ns)
            late_ns.extend(
                k * ticks.period_ns for k in range(1, ticks.missed - missed + 1)
            )
        missed = ticks.missed


def tick_alone(seconds: float) -> Lateness:
    """The control tick in a process that does nothing else."""
    late_ns: list[int] = []
    run_wall(lambda clock: watched(clock, clock.sleep(seconds + WARM_UP), late_ns))
    return Lateness("tick alone", 1, tuple(late_ns))


def tick_while_solving(instance: Instance, seconds: float) -> Lateness:
    """The control tick while all robots of an instance solve it in the same process, again and again."""
    late_ns: list[int] = []
    ends = time.perf_counter() + seconds
    while time.perf_counter() < ends:
        solve_here(
            instance,
            run=lambda main: run_wall(
                lambda clock: watched(clock, main(clock), late_ns)
            ),
        )
    return Lateness("tick while solving", 1, tuple(late_ns))


def added_p99_ms(alone: Lateness, solving: Lateness) -> float:
    """What solving adds to the p99."""
    return round(solving.p99_ms - alone.p99_ms, 4)


# From pose to command --------------------------------------------------------------------------------------------


class StopwatchLink:
    """A link that notes how long ago the cameras have seen all drones when the command of its drone leaves."""

    def __init__(self, pilot: Pilot, owner: WorldOwner, elapsed_ns: list[int]) -> None:
        self.pilot = pilot
        self.owner = owner
        self.link = pilot.link
        self.elapsed_ns = elapsed_ns

    def send(self, command: Command) -> None:
        """Pass it on, then look at the clock."""
        self.link.send(command)
        if self.pilot.mode is Mode.FOLLOW:
            self.elapsed_ns.append(self.pilot.clock.now_ns() - self.owner.looked_ns)

    def cut(self) -> None:
        """Pass it on."""
        self.link.cut()


class Hold(CFDistributedFeedback):
    """u = kp (p_0 - p) - kv v, beside the cost of hearing two neighbours."""

    def __init__(self, seconds: float) -> None:
        self.duration = seconds
        self.place: np.ndarray | None = None

    def step(self, me: State, heard: Heard) -> Acceleration:
        """Back to where the law began."""
        self.place = me.p if self.place is None else self.place
        return Acceleration(2.0 * (self.place - me.p) - 2.5 * me.v)


class HoldMission:
    """A mission of the Hold law."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def guidance(self, i: int, config: SwarmConfig) -> CFGuidance:
        """The same law for every drone."""
        return Hold(self.seconds)


def pose_to_command(drones: int, seconds: float) -> Lateness:
    """All drones in one process and in the air, each with a law at 100 Hz on its neighbours' states."""
    elapsed_ns: list[int] = []
    mission = cast(Mission, HoldMission(seconds))

    async def main(clock: Clock) -> dict[int, dict[str, Any]]:
        agent = Agent(clock, default_swarm(drones), mission, tuple(range(drones)))
        for drone in agent.drones.values():
            drone.pilot.link = StopwatchLink(drone.pilot, agent.owners[0], elapsed_ns)
        return await agent.run()

    results = run_wall(main)
    if not all(result["success"] for result in results.values()):
        raise CrazyChoirError(f"bench latency: {drones} drones did not fly: {results}")
    return Lateness("pose_to_command", drones, tuple(elapsed_ns))


# Command line ----------------------------------------------------------------------------------------------------


def measure(
    instance: Instance, drones: int, seconds: float, repeats: int
) -> dict[str, Any]:
    """Alternate the blocks; the medians over `repeats` of what solving adds, and of pose to command."""
    solve_here(instance)  # kernels are compiled or loaded
    blocks = [
        (tick_alone(seconds), tick_while_solving(instance, seconds))
        for _ in range(repeats)
    ]
    flights = [pose_to_command(drones, seconds) for _ in range(repeats)]
    rows = [
        pooled([a for a, _ in blocks]),
        pooled([b for _, b in blocks]),
        pooled(flights),
    ]
    return {
        "rows": [row.to_json() for row in rows],
        "added_p99_ms": median(added_p99_ms(a, b) for a, b in blocks),
        "pose_to_command_p99_ms": median(flight.p99_ms for flight in flights),
        "instance": instance.name,
        "repeats": repeats,
    }


def pooled(blocks: list[Lateness]) -> Lateness:
    """All samples of one name."""
    return Lateness(
        blocks[0].name,
        blocks[0].drones,
        tuple(ns for block in blocks for ns in block.samples_ns),
    )


def latency(
    instance: Annotated[
        Path | None,
        typer.Option(help="Instance to solve; else 10 robots, 15 tasks, drawn."),
    ] = None,
    drones: Annotated[
        int, options.size("Drones of one process for pose_to_command.")
    ] = 30,
    seconds: Annotated[
        float, options.seconds("Length of a block.", open_below=True)
    ] = 5.0,
    repeats: Annotated[int, options.whole("Blocks of each kind, interleaved.")] = 3,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """How late the control tick is beside the solver, and from pose to command."""
    try:
        problem = ten_robots() if instance is None else Instance.load(instance)
        result = measure(problem, drones, seconds, repeats)
    except CrazyChoirError as error:
        fail(error, as_json)
    if as_json:
        sys.stdout.write(json.dumps(result) + "\n")
    else:
        STDOUT.print(_table(result))


def ten_robots() -> Instance:
    """Ten robots and fifteen tasks in a room of 10 m, flights of at most 25 m."""
    return random_instance(
        10, 15, seed=1, loads=(1, 1), capacities=(2, 3), route_length_limit=25.0
    )


def _table(result: dict[str, Any]) -> Table:
    title = (
        f"solving adds {result['added_p99_ms']:.2f} ms to the p99 of the control tick"
    )
    table = Table(
        "what", "drones", "p50 ms", "p99 ms", "max ms", "samples", title=title
    )
    for row in result["rows"]:
        table.add_row(
            *(
                str(row[key])
                for key in ("name", "drones", "p50_ms", "p99_ms", "max_ms", "samples")
            )
        )
    return table
