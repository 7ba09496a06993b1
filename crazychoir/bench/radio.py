"""Delay of the event loop of a process while dongle owners serve twenty links and open another."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from crazychoir.bus.topics import LINK, POSE
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import Refused
from crazychoir.launch.network import attached, isolate_swarm, observer
from crazychoir.runtime.clock import SECOND, Clock, run_wall
from crazychoir.runtime.mailbox import Call
from crazychoir.types import LinkStatus

LINKS = 20
"""Number of links of the second phase."""
PER_DONGLE = 4
"""Links of one dongle."""
RATE = 100.0
"""Rate of the measured ticks, Hz."""
PATIENCE = 60.0
"""Seconds within which all links must be up."""
PHASES = ("idle", "20 links", "a 21st connects")
"""The phases of a run, in order."""


def run(quick: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """Return the delays of ticks in the phases of one run, in ms: p50, p99 and worst.

    This process observes as an agent does: it receives the poses and link states of all drones
    over Zenoh. The last drone connects with an empty cache, by an owner that starts meanwhile.
    """
    seconds = 5.0 if quick else 20.0

    async def main(clock: Clock) -> dict[str, Any]:
        config = _swarm()
        found = dict[int, str]()
        link = observer(clock, config)
        address = next(iter(link.bus.ports))
        for i in config.ids:
            for topic, hear in (
                (POSE, _nothing),
                (LINK, lambda status, age, i=i: _note(found, i, status)),
            ):
                link.bus.subscribe(
                    topic, config.source(topic, i), address, Call(clock, hear)
                )
        with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as started:
            file = Path(folder) / "swarm.json"
            file.write_text(config.dumps(), encoding="utf-8")
            async with attached(link):
                say("idle")
                late = {PHASES[0]: await _lateness(clock, seconds)}
                for words in _programs(file):
                    started.enter_context(_running(words, {}))
                say(f"connecting {LINKS} virtual drones")
                await _until(
                    clock,
                    lambda: sum(state == "up" for state in found.values()) >= LINKS,
                )
                say(f"{LINKS} links")
                late[PHASES[1]] = await _lateness(clock, seconds)
                say("one more connects")
                started.enter_context(
                    _running(
                        _owner(file, LINKS // PER_DONGLE), {"XDG_CACHE_HOME": folder}
                    )
                )
                late[PHASES[2]] = await _lateness(clock, seconds / 2.0)
                await _until(clock, lambda: found.get(LINKS) == "up")
        return {"links": LINKS, "ticks_hz": RATE, "late_ms": late}

    return run_wall(main)


def _swarm() -> SwarmConfig:
    """Return twenty drones on five dongles, and one more on a sixth."""
    with contextlib.ExitStack() as kept:
        first = _free_ports(LINKS + 2, kept)
    drones = [
        {
            "id": i,
            "home": drone.home,
            "uri": f"udp://127.0.0.1:{first + 1 + i}",
            "dongle": i // PER_DONGLE,
        }
        for i, drone in enumerate(default_swarm(LINKS + 1).drones)
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
    for dongle in range(LINKS // PER_DONGLE):
        yield _owner(file, dongle)


def _owner(file: Path, dongle: int) -> list[str]:
    return [
        "crazychoir.cli.fly.radio_owner",
        "--swarm",
        str(file),
        "--dongle",
        str(dongle),
    ]


@contextlib.contextmanager
def _running(words: list[str], environment: dict[str, str]) -> Iterator[None]:
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


def _nothing(value: Any, age: float) -> None:
    """Ignore a value that is only received."""


def _note(found: dict[int, str], i: int, status: LinkStatus) -> None:
    found[i] = status.state


async def _until(clock: Clock, holds: Callable[[], bool]) -> None:
    ends = clock.now() + PATIENCE
    while not holds():
        if clock.now() > ends:
            raise Refused("bench radio", f"not all links are up within {PATIENCE:g} s")
        await clock.sleep(0.05)


async def _lateness(clock: Clock, seconds: float) -> dict[str, float]:
    """Return the delays of ticks, ms."""
    ticks = clock.ticks(RATE)
    late = list[float]()
    async for _ in ticks:
        late.append((clock.now_ns() - ticks.due_ns) / SECOND * 1e3)
        if len(late) >= seconds * RATE:
            break
    p50, p99 = np.percentile(late, (50.0, 99.0))
    return {
        "p50": round(float(p50), 3),
        "p99": round(float(p99), 3),
        "worst": round(max(late), 3),
    }


def table(result: dict[str, Any]) -> Table:
    """Return a table with one row a phase."""
    found = Table(
        "", "p50", "p99", "worst", title="ms by which a tick of the event loop is late"
    )
    for phase, row in result["late_ms"].items():
        found.add_row(phase, *(f"{row[key]:.2f}" for key in ("p50", "p99", "worst")))
    return found
