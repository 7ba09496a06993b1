"""Speed of a whole swarm on one core, as a multiple of real time, and the share of each room."""

import math
import signal
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from rich.console import Group
from rich.table import Table

import crazychoir
from crazychoir.agent.agent import Agent
from crazychoir.bench import worlds as bench_worlds
from crazychoir.bench.worlds import WORLD_BENCH
from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.margin import Plant
from crazychoir.errors import Refused
from crazychoir.guidance.mission import load_mission
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.safety.rules.modes import Mode

FLIGHT_CASES: tuple[tuple[int, Plant], ...] = (
    (10, "lightweight"),
    (30, "lightweight"),
    (100, "lightweight"),
    (100, "motors"),
    (1000, "lightweight"),
)
"""Number of drones and engine of each row."""
QUICK_FLIGHT_CASES = FLIGHT_CASES[:2]
"""Rows of a quick run."""
FLIGHT_URIS: dict[Plant, str] = {
    "lightweight": WORLD_URIS.lightweight,
    "motors": WORLD_URIS.motor_level,
}
"""The uri of the drones, by engine."""
FLIGHT_PLATFORMS: dict[Plant, str] = {"lightweight": "paper", "motors": "cf21"}
"""Platform of the drones, by engine."""


@dataclass(frozen=True, slots=True)
class SpeedBenchSettings:
    """Settings of `crazychoir bench flight`: the swarm, the measured windows and the profile."""

    largest_repeated_swarm: int = 300
    """Largest number of drones that fly twice and with full windows, and are profiled."""
    spacing: float = 0.7
    """Distance between neighbours on the ring, m."""
    settling_time: float = 0.5
    """Seconds of the law before the measurement begins."""
    window_length: float = 5.0
    """Simulated seconds of one measurement."""
    windows: int = 3
    """Measurements in a flight, one after the other."""
    profile_interval: float = 0.001
    """Processor time between two samples of a profile, s."""
    profiled_rooms: tuple[str, ...] = (
        "bus",
        "runtime",
        "safety",
        "control",
        "filters",
        "guidance",
        "simulation",
        "mocap",
        "team",
        "config",
        "flight",
        "agent",
        "planning",
    )
    """Rooms of the package that are counted in a profile."""


SPEED_BENCH = SpeedBenchSettings()


Say = Callable[[str], None]


def run(quick: bool = False, say: Say = lambda line: None) -> dict[str, Any]:
    """Return {"rows": [one a flight], "worlds": [one an engine]}.

    quick: fewer rows
    say: called with a text that says what is being measured
    Raises Refused if a flight fails.
    """
    rows = [
        _row(n, plant, 1 if quick or n > SPEED_BENCH.largest_repeated_swarm else 2, say)
        for n, plant in (QUICK_FLIGHT_CASES if quick else FLIGHT_CASES)
    ]
    return {
        "rows": rows,
        "worlds": bench_worlds.run(
            WORLD_BENCH.drone_counts[:1] if quick else WORLD_BENCH.drone_counts, say
        ),
    }


def _row(n: int, plant: Plant, flights: int, say: Say) -> dict[str, Any]:
    window = (
        SPEED_BENCH.window_length
        if n <= SPEED_BENCH.largest_repeated_swarm
        else 0.2 * SPEED_BENCH.window_length
    )
    say(f"{n} drones, {plant}: flying")
    windows = [each for _ in range(flights) for each in fly(n, plant, window)]
    say(f"{n} drones, {plant}: profiling one more flight")
    return {
        "drones": n,
        "plant": plant,
        "processes": 1,
        "real_time_factor": window / statistics.median(wall for wall, _ in windows),
        "real_time_factor_cpu": window / statistics.median(cpu for _, cpu in windows),
        "windows": len(windows),
        "window_s": window,
        "profile": measure_profile(n, plant)
        if n <= SPEED_BENCH.largest_repeated_swarm
        else {},
    }


def tables(result: dict[str, Any]) -> Group:
    """Return the flights and the worlds as tables."""
    return Group(table(result), bench_worlds.table(result["worlds"]))


def table(result: dict[str, Any]) -> Table:
    """Return the flights as a table."""
    shown = Table(title="The whole stack in virtual time, one core")
    for name in (
        "drones",
        "plant",
        "times real time",
        "by processor time",
        "where the time goes",
    ):
        shown.add_column(name, justify="left" if "goes" in name else "right")
    for row in result["rows"]:
        rooms = sorted(row["profile"].items(), key=lambda item: -item[1])
        shares = ", ".join(
            f"{room} {share:.0%}" for room, share in rooms if share >= 0.01
        )
        factors = [
            f"{row[name]:.2f}" for name in ("real_time_factor", "real_time_factor_cpu")
        ]
        shown.add_row(str(row["drones"]), row["plant"], *factors, shares)
    return shown


def fly(
    drones: int,
    plant: Plant = "lightweight",
    window: float = SPEED_BENCH.window_length,
    watch: Callable[[bool], None] = lambda on: None,
) -> list[tuple[float, float]]:
    """Fly once in virtual time; return the (wall, processor) seconds of each window.

    drones: number of drones
    plant: simulated engine
    window: s of simulated time
    watch: called with True when the first window begins, and with False when the last one has ended
    Raises Refused if the flight fails.
    """
    config = ring_swarm(drones, plant, window)

    async def main(clock: Clock) -> list[tuple[float, float]]:
        agent = Agent(clock, config, load_mission("bearing_formation"), config.ids)
        meter = WindowMeter(agent, window, watch)
        agent.services.append(meter)
        failed = {
            i: r["reason"] for i, r in (await agent.run()).items() if not r["success"]
        }
        if (
            failed
            or len(meter.windows) < SPEED_BENCH.windows
            or agent.owners[0].world.crashed
        ):
            raise Refused(
                f"bench flight, {drones} drones",
                f"not a good flight: {failed or meter.windows}",
            )
        return meter.windows

    return run_virtual(main)


def ring_swarm(
    n: int, plant: Plant = "lightweight", window: float = SPEED_BENCH.window_length
) -> SwarmConfig:
    """Return a ring of n drones on the corners of a regular polygon.

    Each drone hears its two neighbours, and two opposite drones lead. They take off into the
    shape, so the law only has to hold it against the noise of the cameras.
    """
    radius = SPEED_BENCH.spacing / (2.0 * math.sin(math.pi / n))
    angles = [2.0 * math.pi * k / n for k in range(n)]
    corners = [[radius * math.cos(angle), radius * math.sin(angle)] for angle in angles]
    far = radius + 2.0
    return SwarmConfig.of(
        {
            "name": f"ring{n}",
            "mission": "bearing_formation",
            "mission_options": {
                "shape": {str(k): [*corner, 1.0] for k, corner in enumerate(corners)},
                "duration": SPEED_BENCH.settling_time
                + SPEED_BENCH.windows * window
                + 0.5,
            },
            "seed": 1,
            "edges": [[k, (k + 1) % n] for k in range(n)],
            "drones": [
                {
                    "id": k,
                    "home": [*corners[k], 0.0],
                    "leader": k in (0, n // 2),
                    "uri": FLIGHT_URIS[plant],
                    "platform": FLIGHT_PLATFORMS[plant],
                }
                for k in range(n)
            ],
            "fence": {"min": [-far, -far, 0.0], "max": [far, far, 3.0]},
        },
        "bench flight",
    )


class WindowMeter(Actor):
    """Measures wall time and processor time of a simulated flight, in equal windows of virtual time.

    It begins SPEED_BENCH.settling_time s after all drones but the leaders fly the mission's law.

    agent: the agent with all drones
    window: length of a window, s of virtual time
    watch: called with True before the first window, and with False after the last
    windows: (wall time s, processor time s) of each window
    """

    name = "meter"

    def __init__(
        self, agent: Agent, window: float, watch: Callable[[bool], None]
    ) -> None:
        self.agent = agent
        self.window = window
        self.watch = watch
        self.windows: list[tuple[float, float]] = []

    async def run(self) -> None:
        """Wait until the law is flown, then measure the windows."""
        clock = self.agent.clock
        while not self._flying():
            await clock.sleep(0.1)
        await clock.sleep(SPEED_BENCH.settling_time)
        self.watch(True)
        for _ in range(SPEED_BENCH.windows):
            wall = time.perf_counter()
            cpu = time.process_time()
            await clock.sleep(self.window)
            self.windows.append((time.perf_counter() - wall, time.process_time() - cpu))
        self.watch(False)

    def _flying(self) -> bool:
        leaders = {drone.id for drone in self.agent.config.drones if drone.leader}
        return all(
            d.pilot.mode is Mode.FOLLOW
            for i, d in self.agent.drones.items()
            if i not in leaders
        )


def measure_profile(drones: int, plant: Plant = "lightweight") -> dict[str, float]:
    """Return the share of each room in the processor time of a flight.

    Code outside of the package counts for the room that calls it.
    """
    seen: Counter[str] = Counter()
    with sample_rooms(seen) as watch:
        fly(drones, plant, watch=watch)
    total = max(seen.total(), 1)
    return {
        room: round(seen[room] / total, 4)
        for room in (*SPEED_BENCH.profiled_rooms, "asyncio", "other")
    }


@contextmanager
def sample_rooms(seen: Counter[str]) -> Iterator[Callable[[bool], None]]:
    """Count the room of the running code every SPEED_BENCH.profile_interval s of processor time.

    Yields a function that starts the counting with True and stops it with False.
    """

    def sampled(number: int, frame: FrameType | None) -> None:
        seen[room_of(frame)] += 1

    def watch(on: bool) -> None:
        signal.setitimer(
            signal.ITIMER_PROF,
            SPEED_BENCH.profile_interval if on else 0.0,
            SPEED_BENCH.profile_interval,
        )

    before = signal.signal(signal.SIGPROF, sampled)
    try:
        yield watch
    finally:
        watch(False)
        signal.signal(signal.SIGPROF, before)


CRAZYCHOIR_FOLDER = Path(crazychoir.__file__).parent


def room_of(frame: FrameType | None) -> str:
    """Return the room of the innermost frame that lies in a room; missions count for guidance."""
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        if (
            path.is_relative_to(CRAZYCHOIR_FOLDER)
            and len(parts := path.relative_to(CRAZYCHOIR_FOLDER).parts) > 1
        ):
            if parts[0] in SPEED_BENCH.profiled_rooms:
                return parts[0]
            return "guidance" if parts[0] == "agents" else "other"
        if path.parent.name == "asyncio":
            return "asyncio"
        frame = frame.f_back
    return "other"
