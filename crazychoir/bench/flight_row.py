"""One row of `crazychoir bench flight`, measured in a process of its own.

The argument is a FlightCase as JSON. The process prints one JSON object a line: {"doing": text}
while it works, then {"row": the figures} or {"failed": reason}. It ends with its standard input.
"""

import json
import resource
import statistics
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from crazychoir.agent.agent import Agent
from crazychoir.bench.peers.peers import end_with_parent, say
from crazychoir.bench.python_law import PythonBearingMission
from crazychoir.bench.room_profile import compute_shares, sample_rooms
from crazychoir.bench.steady_flight import Say, fly_steadily
from crazychoir.bench.swarms import FlightCase, build_bench_swarm
from crazychoir.errors import CrazyChoirError
from crazychoir.guidance.mission import Mission, load_mission

WINDOW_COUNT = 3
"""Measurements in a flight, one after the other. Further windows are profiled."""
LAW_DURATION = 1e6
"""s of virtual time that the law lasts: the flight is over before."""
PROFILE_SAMPLES = 200
"""Samples of a profile after which it ends."""
PROFILE_TIME = 3.0
"""Seconds of wall time after which a profile ends, however few samples it has."""
KIB_PER_MB = 1e6 / 1024.0
"""KiB in a megabyte."""


@dataclass(frozen=True, slots=True)
class FlightWindow:
    """What one measurement took."""

    wall: float
    """Wall time, s."""
    processor: float
    """Processor time, s."""
    acting: float
    """Share of the ticks of all drones in which the collision filter acted."""


def measure_case(case: FlightCase, say: Say = lambda text: None) -> dict[str, Any]:
    """Fly a case once in virtual time, and return its figures.

    say: called with a text that says what is being done
    Raises Refused if the flight fails.
    """
    config = build_bench_swarm(case, LAW_DURATION)
    mission = (
        cast(Mission, PythonBearingMission())
        if case.law == "python"
        else load_mission("bearing_formation")
    )
    ticks = round(case.window * config.mocap.rate)
    seen: Counter[str] = Counter()

    async def measure(agent: Agent) -> tuple[list[FlightWindow], float]:
        windows = []
        for k in range(WINDOW_COUNT):
            say(f"measuring, {k + 1} of {WINDOW_COUNT}")
            windows.append(await measure_window(agent, case, ticks))
        memory = read_peak_memory()
        say("profiling")
        ends = time.perf_counter() + PROFILE_TIME
        with sample_rooms(seen) as watch:
            watch(True)
            while seen.total() < PROFILE_SAMPLES and time.perf_counter() < ends:
                await agent.clock.sleep(case.window)
        return windows, memory

    windows, memory = fly_steadily(config, mission, measure, say)
    wall = statistics.median(window.wall for window in windows)
    processor = statistics.median(window.processor for window in windows)
    return {
        "real_time_factor": case.window / wall,
        "real_time_factor_cpu": case.window / processor,
        "us_per_drone_tick": 1e6 * processor / (case.drones * ticks),
        "filter_share": statistics.mean(window.acting for window in windows),
        "peak_memory_mb": round(memory, 1),
        "windows": len(windows),
        "profile": compute_shares(seen),
    }


async def measure_window(agent: Agent, case: FlightCase, ticks: int) -> FlightWindow:
    """Return what a window of virtual time took.

    ticks: ticks of a drone in the window
    """
    acted = count_filter_ticks(agent)
    wall = time.perf_counter()
    processor = time.process_time()
    await agent.clock.sleep(case.window)
    return FlightWindow(
        time.perf_counter() - wall,
        time.process_time() - processor,
        (count_filter_ticks(agent) - acted) / (case.drones * ticks),
    )


def count_filter_ticks(agent: Agent) -> int:
    """Return the ticks in which the collision filter has flown a drone, summed over all drones."""
    return sum(drone.pilot.follower.clearance.ticks for drone in agent.drones.values())


def read_peak_memory() -> float:
    """Return the largest memory of this process so far, MB.

    Linux counts the memory of the parent in the usage of a child, but not in its status.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / KIB_PER_MB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / KIB_PER_MB


def main() -> None:
    """Measure the case of the argument."""
    end_with_parent()
    case = FlightCase(**json.loads(sys.argv[1]))
    try:
        say({"row": measure_case(case, lambda text: say({"doing": text}))})
    except CrazyChoirError as error:
        say({"failed": str(error)})


if __name__ == "__main__":
    main()
