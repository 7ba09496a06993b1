"""Thirty drones that hold their formation in real time: whether memory grows, and what each counter counted.

    python tests/bench/soak.py                 # 20 minutes; the world, and two processes of fifteen drones
    python tests/bench/soak.py --minutes 4 --each 3

Memory is what a process has for itself alone (USS); its slope is a line fitted after the first tenth of the flight.
"""

import argparse
import asyncio
import contextlib
import json
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from crazychoir.config.addresses import Addresses

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from system.agents import AGENT, WORLD, Program, results

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.network import isolate_swarm

FILE = Path(__file__).resolve().parents[2] / "deploy/grid30.toml"
MISSION = load_mission("bearing_formation")
EACH_S, SETTLED = 5.0, 0.1
MIB = 1 << 20
TRAFFIC = ("frames_sent", "frames_received", "bytes_sent", "worst_put_s")
"""Counters that say nothing is wrong."""


def swarm(minutes: float, each: int) -> SwarmConfig:
    """Return deploy's grid of thirty drones: its law runs for `minutes`, with `each` drones a process and one world."""
    config = SwarmConfig.load(FILE)
    ids = list(config.ids)
    options = json.loads(config.dumps())["mission_options"] | {
        "duration": 60.0 * minutes
    }
    groups = [ids[k : k + each] for k in range(0, len(ids), each)]
    changed = config.replace(
        mission_options=options,
        processes=groups,
        world={"owned": True},
        start_deadline=120.0,
    )
    return isolate_swarm(changed, None)


async def soak(minutes: float, each: int, progress: Progress) -> dict[str, object]:
    config = swarm(minutes, each)
    compiled = await Program.start(
        sys.executable, "-c", "import crazychoir.launch.process.process"
    )
    await compiled.end(300.0)  # a process that compiles the laws takes twice the memory
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "swarm.json"
        file.write_text(config.dumps())
        programs = {"world": await Program.start(*WORLD, "--swarm", file, "--json")}
        try:
            for group in Addresses(config).groups():
                words = [word for i in group for word in ("--id", str(i))]
                name = f"drones {group[0]} to {group[-1]}"
                programs[name] = await Program.start(
                    *AGENT, "--swarm", file, "--json", *words
                )
            agents = [program for name, program in programs.items() if name != "world"]
            task = progress.add_task("flying", total=60.0 * minutes)
            began, samples = time.monotonic(), []
            while all(agent.process.returncode is None for agent in agents):
                samples.append(
                    (
                        time.monotonic() - began,
                        [used(program) for program in programs.values()],
                    )
                )
                progress.update(task, completed=samples[-1][0])
                await asyncio.sleep(EACH_S)
                assert samples[-1][0] < 60.0 * minutes + 300.0, "it does not end"
            ended = await asyncio.gather(*(agent.end(60.0) for agent in agents))
            programs["world"].signal(signal.SIGINT)
            told = dict(
                zip(programs, [await programs["world"].end(30.0), *ended], strict=True)
            )
        finally:
            await asyncio.gather(*(program.kill() for program in programs.values()))
    found = results(dict(enumerate(ended)))
    report = MISSION.report(config, found)
    flown = [(t, used) for t, used in samples if min(used) > 0][:-1]
    return {
        "success": report["success"],
        "reasons": report["reasons"],
        "minutes": flown[-1][0] / 60.0,
        "memory": {name: line(flown, k) for k, name in enumerate(programs)},
        "counters": {name: one.get("network", {}) for name, one in told.items()},
        "late_ms": {
            name: 1000.0 * one.get("late_s", 0.0) for name, one in told.items()
        },
        "samples": [(t, *used) for t, used in flown],
    }


def used(program: Program) -> int:
    """Bytes that are this process's alone; 0 once it has ended."""
    with contextlib.suppress(psutil.Error):
        return int(psutil.Process(program.process.pid).memory_full_info().uss)
    return 0


def line(samples: list[tuple[float, list[int]]], k: int) -> dict[str, float]:
    """Memory in MiB after the settling and at the end, and MiB in ten minutes, of a line through all between."""
    t, m = (
        np.array([t for t, _ in samples]),
        np.array([used[k] for _, used in samples]) / MIB,
    )
    settled = t >= SETTLED * t[-1]
    slope, at = np.polyfit(t[settled], m[settled], 1)
    return {
        "first": float(m[settled][0]),
        "last": float(m[-1]),
        "most": float(m.max()),
        "in_10_min": float(600.0 * slope),
        "off": float(np.abs(m[settled] - slope * t[settled] - at).max()),
    }


def show(found: dict[str, object], console: Console) -> None:
    memory = Table(
        "process",
        "MiB first",
        "last",
        "most",
        "MiB in 10 min",
        "off the line",
        "latest tick, ms",
    )
    for name, one in found["memory"].items():
        figures = [
            f"{one[key]:.2f}" for key in ("first", "last", "most", "in_10_min", "off")
        ]
        memory.add_row(name, *figures, f"{found['late_ms'][name]:.1f}")
    console.print(memory)
    names = list(next(iter(found["counters"].values())))
    counters = Table("counter", *found["counters"])
    for name in names:
        values = [one.get(name, 0) for one in found["counters"].values()]
        if name in TRAFFIC or any(values):
            counters.add_row(
                name,
                *(
                    f"{value:.4g}" if isinstance(value, float) else str(value)
                    for value in values
                ),
            )
    console.print(counters)
    zero = ", ".join(
        n
        for n in names
        if n not in TRAFFIC and not any(c.get(n) for c in found["counters"].values())
    )
    console.print(f"0 everywhere: {zero}", highlight=False)
    said = f"{found['minutes']:.1f} minutes, success: {found['success']} {found['reasons'] or ''}"
    console.print(said, highlight=False)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--each", type=int, default=15, help="drones a process")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    console = Console(stderr=True)
    with Progress(console=console) as progress:
        found = asyncio.run(soak(chosen.minutes, chosen.each, progress))
    if chosen.json:
        print(json.dumps(found))
    else:
        show(found, Console())


if __name__ == "__main__":
    main()
