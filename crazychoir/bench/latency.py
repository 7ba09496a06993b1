"""crazychoir bench latency: delay of the control tick beside a solver, and from pose to command.

Both are measured in one process in real time. A block is one measurement without a pause. The delay
of a tick is its start minus its due time. `added_p99_ms` is the p99 while solving minus the p99
without, from blocks that alternate in this run. The time from pose to command begins when the
cameras look and ends when the commands of all drones are sent, with all drones of the process
hovering.
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
from crazychoir.flight.batch import MODE_NUMBERS
from crazychoir.flight.tick import FlightTick
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission import Mission
from crazychoir.launch import number_options as options
from crazychoir.launch.console import ANSWER_CONSOLE, exit_with_error
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, run_wall
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.owner import WorldOwner
from crazychoir.solve.solving import solve_here
from crazychoir.types import Acceleration, Heard, State

CONTROL_TICK_RATE = 100.0
"""Rate of the control tick, Hz."""
BLOCK_WARM_UP = 0.3
"""Seconds at the start of a block that do not count, because the loop itself starts."""


@dataclass(frozen=True)
class Lateness:
    """The delays of one kind of measurement, which is one row of the table."""

    name: str
    """Name of the row."""
    drones: int
    """Number of drones."""
    samples_ns: tuple[int, ...]
    """All samples, ns."""

    @property
    def p99_ms(self) -> float:
        """The 99th percentile, ms."""
        return self._quantile(99.0)

    def to_json(self) -> dict[str, Any]:
        """Return the row as `--json` prints it: quantiles in ms."""
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


async def run_beside_tick(
    clock: Clock, work: Awaitable[Any], late_ns: list[int]
) -> Any:
    """Await the work with a control tick beside it; the delays are appended to `late_ns`."""
    ticks = asyncio.create_task(_tick(clock, late_ns), name="control tick")
    try:
        return await work
    finally:
        ticks.cancel()
        await asyncio.wait([ticks])


async def _tick(clock: Clock, late_ns: list[int]) -> None:
    ticks = clock.ticks(CONTROL_TICK_RATE)
    counted_from_ns = clock.now_ns() + round(BLOCK_WARM_UP * NS_PER_SECOND)
    missed = 0
    async for due_ns in ticks:
        if due_ns >= counted_from_ns:
            late_ns.append(clock.now_ns() - due_ns)
            late_ns.extend(
                k * ticks.period_ns for k in range(1, ticks.missed - missed + 1)
            )
        missed = ticks.missed


def tick_alone(seconds: float) -> Lateness:
    """Measure the control tick in a process that does nothing else."""
    late_ns: list[int] = []
    run_wall(
        lambda clock: run_beside_tick(
            clock, clock.sleep(seconds + BLOCK_WARM_UP), late_ns
        )
    )
    return Lateness("tick alone", 1, tuple(late_ns))


def tick_while_solving(instance: Instance, seconds: float) -> Lateness:
    """Measure the control tick while all robots solve an instance in the same process.

    They solve it again and again until the time is over.
    """
    late_ns: list[int] = []
    ends = time.perf_counter() + seconds
    while time.perf_counter() < ends:
        solve_here(
            instance,
            run=lambda main: run_wall(
                lambda clock: run_beside_tick(clock, main(clock), late_ns)
            ),
        )
    return Lateness("tick while solving", 1, tuple(late_ns))


def added_p99_ms(alone: Lateness, solving: Lateness) -> float:
    """Return what solving adds to the p99, ms."""
    return round(solving.p99_ms - alone.p99_ms, 4)


# From pose to command --------------------------------------------------------------------------------------------


class CommandStopwatch:
    """Stores the age of the newest poses when the commands of a tick are sent.

    Each drone that ticks and follows its law counts once.

    tick: of the process
    owner: owner of the world, which says when the cameras last saw all drones
    elapsed_ns: list of the ages, ns
    """

    def __init__(
        self, tick: FlightTick, owner: WorldOwner, elapsed_ns: list[int]
    ) -> None:
        self.tick = tick
        self.owner = owner
        self.elapsed_ns = elapsed_ns
        tick.observers.append(self.stop)

    def stop(self) -> None:
        """Note the time: the commands are sent."""
        age_ns = self.tick.clock.now_ns() - self.owner.looked_ns
        drones = self.tick.batch.drones
        follows = drones["mode"] == MODE_NUMBERS[Mode.FOLLOW]
        count = np.count_nonzero(follows & (drones["ticks"] > 0))
        self.elapsed_ns += [age_ns] * int(count)


class HoldLaw(CFDistributedFeedback):
    """A law that holds the drone in place. It receives the neighbours' states, but does not use them.

    u = kp (p_0 - p) - kv v
    """

    def __init__(self, seconds: float) -> None:
        self.duration = seconds
        self.place: np.ndarray | None = None

    def step(self, me: State, heard: Heard) -> Acceleration:
        """Return the acceleration back to the place where the law began."""
        self.place = me.p if self.place is None else self.place
        return Acceleration(2.0 * (self.place - me.p) - 2.5 * me.v)


class HoldMission:
    """A mission in which every drone flies HoldLaw.

    seconds: duration of the law
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def guidance(self, i: int, config: SwarmConfig) -> CFGuidance:
        """Return the same law for every drone."""
        return HoldLaw(self.seconds)


def pose_to_command(drones: int, seconds: float) -> Lateness:
    """Measure the time from pose to command while all drones hover in one process.

    Each drone flies HoldLaw at 100 Hz.
    """
    elapsed_ns: list[int] = []
    mission = cast(Mission, HoldMission(seconds))

    async def main(clock: Clock) -> dict[int, dict[str, Any]]:
        agent = Agent(clock, default_swarm(drones), mission, tuple(range(drones)))
        CommandStopwatch(agent.drones[0].pilot.tick, agent.owners[0], elapsed_ns)
        return await agent.run()

    results = run_wall(main)
    if not all(result["success"] for result in results.values()):
        raise CrazyChoirError(f"bench latency: {drones} drones did not fly: {results}")
    return Lateness("pose_to_command", drones, tuple(elapsed_ns))


# Command line ----------------------------------------------------------------------------------------------------


def measure(
    instance: Instance, drones: int, seconds: float, repeats: int
) -> dict[str, Any]:
    """Measure the delay of the control tick without and with a solver, and from pose to command.

    The two measurements of the tick alternate, `repeats` times each, so that a change of the
    machine's load affects both. The flights follow.

    instance: the instance to solve
    drones: drones of the process that flies
    seconds: length of one measurement
    repeats: number of measurements of each kind
    Returns the object that `--json` prints: the rows, and medians of the p99 in ms.
    """
    solve_here(instance)  # compiles or loads the kernels
    blocks = [
        (tick_alone(seconds), tick_while_solving(instance, seconds))
        for _ in range(repeats)
    ]
    flights = [pose_to_command(drones, seconds) for _ in range(repeats)]
    rows = [
        pool_samples([a for a, _ in blocks]),
        pool_samples([b for _, b in blocks]),
        pool_samples(flights),
    ]
    return {
        "rows": [row.to_json() for row in rows],
        "added_p99_ms": median(added_p99_ms(a, b) for a, b in blocks),
        "pose_to_command_p99_ms": median(flight.p99_ms for flight in flights),
        "instance": instance.name,
        "repeats": repeats,
    }


def pool_samples(blocks: list[Lateness]) -> Lateness:
    """Return the samples of several blocks of one kind as one row."""
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
    """Measure the delay of the control tick beside a solver, and from pose to command."""
    try:
        problem = ten_robot_instance() if instance is None else Instance.load(instance)
        result = measure(problem, drones, seconds, repeats)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    if as_json:
        sys.stdout.write(json.dumps(result) + "\n")
    else:
        ANSWER_CONSOLE.print(_table(result))


def ten_robot_instance() -> Instance:
    """Return ten robots and fifteen tasks in a room of 10 m, with routes of at most 25 m."""
    return random_instance(
        10,
        15,
        seed=1,
        shape=InstanceShape(loads=(1, 1), capacities=(2, 3), route_length_limit=25.0),
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
