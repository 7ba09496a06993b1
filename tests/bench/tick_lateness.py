"""How late the tick of real processes is, on the wall clock.

    python tests/bench/tick_lateness.py                          # 300 drones in 2 processes for 60 s
    python tests/bench/tick_lateness.py --drones 30 --processes 3 --seconds 20 --only lattice

lattice: the drones fly the bearing law on a lattice, K processes over the network of this host.
six: a ring of six drones in six processes: CPU of a process, and the time from pose to command.
thirty: thirty drones in one process: the time from pose to command, as in `crazychoir bench latency`.

The lateness of a tick is its start minus its due time; missed ticks count with the lateness that they
would have had. CPU 1.0 is one core.
"""

import argparse
import asyncio
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from system.agents import Program

from crazychoir.agent.agent import Agent
from crazychoir.bench.latency import CommandStopwatch, pose_to_command
from crazychoir.bench.steady_flight import list_idle
from crazychoir.bench.swarms import FlightCase, build_bench_swarm
from crazychoir.bus.port import Forwarder
from crazychoir.bus.topics import Topic
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import CrazyChoirError
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.network import isolate_swarm
from crazychoir.launch.process.process import run_agent
from crazychoir.numerics.compiling import KERNEL_QUEUE
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.rules.modes import Mode

SETTLING_TIME = 3.0  # s of the law before the measurement begins
START_DEADLINE = 120.0  # s until all processes must have found each other
FLIGHT_ALLOWANCE = 120.0  # s for start, take-off and landing beside the law
SIX_DRONES = FlightCase(6, shape="ring")
"""Six drones, one in each process; four of them fly the law, and two lead."""
BEFORE_WORLD = -1
"""Priority of the meter's tick: it comes before that of the world with the same due time."""
COLUMNS = {
    "late_p50_ms": "late p50 ms",
    "late_p99_ms": "late p99 ms",
    "missed_share": "missed",
    "cpu": "CPU",
    "messages_per_s": "messages/s",
    "pose_to_command_p50_ms": "command p50 ms",
    "pose_to_command_p99_ms": "command p99 ms",
}
"""Columns of the table: the figures of a process."""


# One process of the swarm ---------------------------------------------------------------------------------------


class CountingForwarder:
    """Passes messages on to the network, and counts them.

    inner: the link of this process
    messages: messages to drones of other processes
    """

    def __init__(self, inner: Forwarder) -> None:
        self.inner = inner
        self.messages = 0

    def forward(self, topic: Topic, source: int, to: list[int], *rest: Any) -> None:
        self.messages += len(to)
        self.inner.forward(topic, source, to, *rest)

    def then(self, work: Callable[[], None]) -> None:
        self.inner.then(work)

    def interested(self) -> None:
        self.inner.interested()


@dataclass(frozen=True)
class Reading:
    """Counts of a process at one instant."""

    time: float
    processor: float
    messages: int
    missed: int

    @classmethod
    def take(cls, agent: Agent, forwarder: CountingForwarder) -> "Reading":
        missed = sum(owner.ticks.missed for owner in agent.owners)
        return cls(time.perf_counter(), time.process_time(), forwarder.messages, missed)


class TickMeter(Actor):
    """Measures a process for some seconds, while its drones fly the law.

    agent: the agent of this process
    seconds: s of the measurement
    """

    name = "tick meter"

    def __init__(self, agent: Agent, seconds: float) -> None:
        self.agent = agent
        self.seconds = seconds
        self.late_ns: list[int] = []
        self.command_ns: list[int] = []
        self.figures: dict[str, Any] = {}
        self.forwarder = CountingForwarder(agent.bus.forwarder)
        agent.bus.forwarder = self.forwarder
        pilot = agent.drones[agent.ids[0]].pilot
        CommandStopwatch(pilot.tick, agent.owners[0], self.command_ns)

    async def run(self) -> None:
        clock = self.agent.clock
        while list_idle(self.agent) or not self._flies():
            await clock.sleep(0.1)
        await clock.sleep(SETTLING_TIME)
        self.command_ns.clear()
        before = Reading.take(self.agent, self.forwarder)
        await self._record_ticks()
        after = Reading.take(self.agent, self.forwarder)
        self.figures = self._compute_figures(before, after)

    def _flies(self) -> bool:
        """Return whether all drones of this process hover or fly the law."""
        return all(
            drone.pilot.mode in (Mode.HOVER, Mode.FOLLOW)
            for drone in self.agent.drones.values()
        )

    async def _record_ticks(self) -> None:
        """Tick just before the world of the first drone does, and note how late each tick is."""
        clock = self.agent.clock
        world = self.agent.owners[0].ticks
        ticks = clock.ticks(NS_PER_SECOND / world.period_ns, BEFORE_WORLD)
        ticks.due_ns = world.due_ns
        ends_ns = clock.now_ns() + round(self.seconds * NS_PER_SECOND)
        missed = 0
        async for due_ns in ticks:
            late_ns = clock.now_ns() - due_ns
            skipped = ticks.missed - missed
            missed = ticks.missed
            self.late_ns.append(late_ns)
            self.late_ns += [
                late_ns + k * ticks.period_ns for k in range(1, skipped + 1)
            ]
            if due_ns > ends_ns:
                return

    def _compute_figures(self, before: Reading, after: Reading) -> dict[str, Any]:
        wall = after.time - before.time
        p50, p99 = np.percentile(self.late_ns, [50.0, 99.0]) / 1e6
        found = {
            "drones": len(self.agent.ids),
            "late_p50_ms": round(float(p50), 3),
            "late_p99_ms": round(float(p99), 3),
            "missed_share": round(
                (after.missed - before.missed)
                / (len(self.late_ns) * len(self.agent.owners)),
                5,
            ),
            "cpu": round((after.processor - before.processor) / wall, 4),
            "messages_per_s": round((after.messages - before.messages) / wall, 1),
        }
        if self.command_ns:
            p50, p99 = np.percentile(self.command_ns, [50.0, 99.0]) / 1e6
            found["pose_to_command_p50_ms"] = round(float(p50), 3)
            found["pose_to_command_p99_ms"] = round(float(p99), 3)
        return found


def fly_process(file: Path, ids: tuple[int, ...], seconds: float) -> dict[str, Any]:
    """Fly these drones of the swarm in this process; return the figures of the meter."""
    meters: list[TickMeter] = []

    def make_meter(agent: Agent) -> list[TickMeter]:
        meters.append(TickMeter(agent, seconds))
        return meters

    with KERNEL_QUEUE.checks_first():
        config = SwarmConfig.load(file)
        mission = load_mission(str(config.mission))
    KERNEL_QUEUE.compile()
    flown = run_agent(config, mission, ids, None, None, make_meter)
    failed = {
        i: result["reason"]
        for i, result in flown["results"].items()
        if not result["success"]
    }
    return meters[0].figures | {"failed": failed}


# The swarm ------------------------------------------------------------------------------------------------------


async def fly_swarm(case: FlightCase, processes: int, seconds: float) -> dict[str, Any]:
    """Fly a swarm in some processes, and return the figures of each process, or a note."""
    duration = SETTLING_TIME + seconds + 5.0
    config = build_bench_swarm(case, duration).replace(start_deadline=START_DEADLINE)
    config = isolate_swarm(config, processes)
    found: dict[str, Any] = {"drones": case.drones, "processes": [], "note": ""}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "swarm.json"
        file.write_text(config.dumps())
        programs = []
        try:
            for group in config.processes or ():
                words = ["--fly", file, "--seconds", seconds, "--ids", *group]
                program = await Program.start(sys.executable, __file__, *words)
                programs.append(program)
            limit = duration + FLIGHT_ALLOWANCE
            ended = await asyncio.gather(*(program.end(limit) for program in programs))
        except AssertionError as error:
            return found | {"note": f"not measured: {str(error)[:200]}"}
        finally:
            await asyncio.gather(*(program.kill() for program in programs))
    for one, program in zip(ended, programs, strict=True):
        del one["answer"]
        if one["code"] or "cpu" not in one:
            said = program.said[-1] if program.said else one.get("failed")
            found["note"] = f"not measured: a process did not fly the law: {said}"
        found["processes"].append(one)
    return found


def measure_thirty(seconds: float) -> dict[str, Any]:
    """Measure the time from pose to command of thirty drones in this process."""
    try:
        return pose_to_command(30, seconds).to_json()
    except CrazyChoirError as error:
        return {"note": f"not measured: {error}"}


def measure(drones: int, processes: int, seconds: float, only: str) -> dict[str, Any]:
    """Measure one part, or all parts."""
    found: dict[str, Any] = {"load": os.getloadavg()[0]}
    if only in ("all", "lattice"):
        found["lattice"] = asyncio.run(
            fly_swarm(FlightCase(drones), processes, seconds)
        )
    if only in ("all", "six"):
        found["six"] = asyncio.run(fly_swarm(SIX_DRONES, 6, min(seconds, 20.0)))
    if only in ("all", "thirty"):
        found["thirty"] = measure_thirty(min(seconds, 10.0))
    return found


def show(found: dict[str, Any], console: Console) -> None:
    """Print a table of all processes."""
    table = Table("swarm", title=f"load before: {found['load']:.1f}")
    for head in COLUMNS.values():
        table.add_column(head, justify="right")
    for part in ("lattice", "six"):
        if part not in found:
            continue
        swarm = found[part]
        for process in swarm["processes"]:
            figures = [str(process.get(name, "-")) for name in COLUMNS]
            table.add_row(f"{part}, {swarm['drones']}", *figures)
        if swarm["note"]:
            console.print(f"{part}: {swarm['note']}", highlight=False)
    console.print(table)
    if "thirty" in found:
        console.print(f"thirty drones in one process: {found['thirty']}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drones", type=int, default=300)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument(
        "--only", choices=("all", "lattice", "six", "thirty"), default="all"
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--fly", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--ids", type=int, nargs="*", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.fly:
        print(json.dumps(fly_process(chosen.fly, tuple(chosen.ids), chosen.seconds)))
        return
    found = measure(chosen.drones, chosen.processes, chosen.seconds, chosen.only)
    if chosen.json:
        print(json.dumps(found))
    else:
        show(found, Console())


if __name__ == "__main__":
    main()
