"""What a dongle carries, and the delay of an event loop while dongle owners serve twenty links."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table

from crazychoir.bench import dongle
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import Refused
from crazychoir.launch.network import isolate_swarm, make_observer_link, run_attached
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, run_wall
from crazychoir.runtime.mailbox import Call
from crazychoir.types import LinkStatus


@dataclass(frozen=True, slots=True)
class RadioBenchSettings:
    """Settings of `crazychoir bench radio`: its links, its ticks and its phases."""

    links: int = 20
    """Number of links of the second phase."""
    links_per_dongle: int = 4
    """Links of one dongle."""
    tick_rate: float = 100.0
    """Rate of the measured ticks, Hz."""
    connect_timeout: float = 60.0
    """Seconds within which all links must be up."""
    phases: tuple[str, ...] = ("idle", "20 links", "a 21st connects")
    """The phases of a run, in order."""


RADIO_BENCH = RadioBenchSettings()


def run(quick: bool, say: Callable[[str], None], model: bool = False) -> dict[str, Any]:
    """Measure one dongle on the radio model, and what many links cost a process.

    quick: shorter phases
    say: called with a text that says what is being measured
    model: True for the radio model only
    """
    rows = {"dongle": dongle.run(quick, say)}
    return rows if model else rows | _run_links(quick, say)


def _run_links(quick: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """Measure how late the event loop of this process wakes, in each of RADIO_BENCH.phases.

    Like an agent, this process receives the poses and link states of all drones over Zenoh. In the
    last phase, another owner of a dongle starts, and connects one more drone with an empty cache.

    quick: shorter phases
    say: called with a text that says what is being measured
    Returns the delays in ms of each phase: p50, p99 and worst.
    """
    seconds = 5.0 if quick else 20.0

    async def main(clock: Clock) -> dict[str, Any]:
        config = _swarm()
        found = dict[int, str]()
        link = make_observer_link(clock, config)
        address = next(iter(link.bus.ports))
        for i in config.ids:
            for topic, hear in (
                (DRONE_TOPICS.pose, _ignore_value),
                (
                    DRONE_TOPICS.link,
                    lambda status, age, i=i: _note_link_state(found, i, status),
                ),
            ):
                link.bus.subscribe(
                    topic, config.topology.source(topic, i), address, Call(clock, hear)
                )
        with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as started:
            file = Path(folder) / "swarm.json"
            file.write_text(config.dumps(), encoding="utf-8")
            async with run_attached(link):
                say("idle")
                late = {RADIO_BENCH.phases[0]: await _measure_lateness(clock, seconds)}
                for words in _programs(file):
                    started.enter_context(_run_program(words, {}))
                say(f"connecting {RADIO_BENCH.links} virtual drones")
                await _wait_until(
                    clock,
                    lambda: (
                        sum(state == "up" for state in found.values())
                        >= RADIO_BENCH.links
                    ),
                )
                say(f"{RADIO_BENCH.links} links")
                late[RADIO_BENCH.phases[1]] = await _measure_lateness(clock, seconds)
                say("one more connects")
                started.enter_context(
                    _run_program(
                        _owner(file, RADIO_BENCH.links // RADIO_BENCH.links_per_dongle),
                        {"XDG_CACHE_HOME": folder},
                    )
                )
                late[RADIO_BENCH.phases[2]] = await _measure_lateness(
                    clock, seconds / 2.0
                )
                await _wait_until(clock, lambda: found.get(RADIO_BENCH.links) == "up")
        return {
            "links": RADIO_BENCH.links,
            "ticks_hz": RADIO_BENCH.tick_rate,
            "late_ms": late,
        }

    return run_wall(main)


def _swarm() -> SwarmConfig:
    """Return twenty drones on five dongles, and one more on a sixth."""
    with contextlib.ExitStack() as kept:
        first = _free_ports(RADIO_BENCH.links + 2, kept)
    drones = [
        {
            "id": i,
            "home": drone.home,
            "uri": f"udp://127.0.0.1:{first + 1 + i}",
            "dongle": i // RADIO_BENCH.links_per_dongle,
        }
        for i, drone in enumerate(default_swarm(RADIO_BENCH.links + 1).drones)
    ]
    raw = {
        "name": "bench",
        "drones": drones,
        "control": {"sender": "xyz"},
        "mocap": {"port": first},
    }
    return isolate_swarm(
        SwarmConfig.of(raw | {"fence": {"min": [-4, -4, 0], "max": [9, 9, 3]}}), None
    )


def _free_ports(count: int, kept: contextlib.ExitStack) -> int:
    """Return the first of `count` free UDP ports in a row."""
    for first in range(30_000, 60_000, 100):
        probes = [
            kept.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            for _ in range(count)
        ]
        with contextlib.suppress(OSError):
            for k, probe in enumerate(probes):
                probe.bind(("127.0.0.1", first + k))
            return first
    raise Refused("bench radio", "no free UDP ports")


def _programs(file: Path) -> Iterator[list[str]]:
    swarm = ["--swarm", str(file)]
    yield ["crazychoir.cli.main", "virtual", *swarm]
    yield ["crazychoir.cli.fly.mocap", *swarm]
    for number in range(RADIO_BENCH.links // RADIO_BENCH.links_per_dongle):
        yield _owner(file, number)


def _owner(file: Path, number: int) -> list[str]:
    return [
        "crazychoir.cli.fly.radio_owner",
        "--swarm",
        str(file),
        "--dongle",
        str(number),
    ]


@contextlib.contextmanager
def _run_program(words: list[str], environment: dict[str, str]) -> Iterator[None]:
    quiet = subprocess.DEVNULL
    child = subprocess.Popen(
        [sys.executable, "-m", *words],
        stdout=quiet,
        stderr=quiet,
        env=os.environ | environment,
    )
    try:
        yield
    finally:
        child.send_signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(10.0)
        child.kill()
        child.wait()


def _ignore_value(value: Any, age: float) -> None:
    """Ignore a value that is only received."""


def _note_link_state(found: dict[int, str], i: int, status: LinkStatus) -> None:
    found[i] = status.state


async def _wait_until(clock: Clock, holds: Callable[[], bool]) -> None:
    ends = clock.now() + RADIO_BENCH.connect_timeout
    while not holds():
        if clock.now() > ends:
            raise Refused(
                "bench radio",
                f"not all links are up within {RADIO_BENCH.connect_timeout:g} s",
            )
        await clock.sleep(0.05)


async def _measure_lateness(clock: Clock, seconds: float) -> dict[str, float]:
    """Return the delays of ticks, ms."""
    ticks = clock.ticks(RADIO_BENCH.tick_rate)
    late = list[float]()
    async for _ in ticks:
        late.append((clock.now_ns() - ticks.due_ns) / NS_PER_SECOND * 1e3)
        if len(late) >= seconds * RADIO_BENCH.tick_rate:
            break
    p50, p99 = np.percentile(late, (50.0, 99.0))
    return {
        "p50": round(float(p50), 3),
        "p99": round(float(p99), 3),
        "worst": round(max(late), 3),
    }


def tables(result: dict[str, Any]) -> Group:
    """Return a table of the radio model, and one with one row a phase."""
    found = [dongle.table(result["dongle"])]
    if "late_ms" in result:
        found.append(_table_lateness(result["late_ms"]))
    return Group(*found)


def _table_lateness(phases: dict[str, dict[str, float]]) -> Table:
    found = Table(
        "", "p50", "p99", "worst", title="ms by which a tick of the event loop is late"
    )
    for phase, row in phases.items():
        found.add_row(phase, *(f"{row[key]:.2f}" for key in ("p50", "p99", "worst")))
    return found
