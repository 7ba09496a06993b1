"""The process of motion capture: its connection to the network, its signals, its live table."""

import contextlib
import math
import random
import socket
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from crazychoir.bus.network.hello import PACKAGE_VERSION
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.config.swarm_config import PROCESS_NUMBERS, SwarmConfig
from crazychoir.launch.process.signals import end_on_signals
from crazychoir.mocap.process import MocapProcess, make_source
from crazychoir.mocap.recording import FrameRecorder
from crazychoir.mocap.watch import TRACKING_LIMITS, BodyRecord
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.runtime.watchdog import Watchdog

MOCAP_TABLE_RATE = 4.0
"""Updates of the live table, Hz."""
Show = Callable[[MocapProcess], None]


class MocapTableActor(Actor):
    """Shows the live table."""

    name = "table"

    def __init__(self, process: MocapProcess, show: Show) -> None:
        self._process = process
        self._show = show

    async def run(self) -> None:
        """Show the table SHOWS times a second."""
        async for _ in self._process.clock.ticks(MOCAP_TABLE_RATE):
            self._show(self._process)


def run_mocap(
    config: SwarmConfig, listen: str | None, record: Path | None, show: Show | None
) -> dict[str, Any]:
    """Publish the poses of the tracked drones over Zenoh until a signal ends it; return a report.

    config: the swarm
    listen: Zenoh endpoint, None for that of the swarm file
    record: CSV file to record the poses into, None for none
    show: shows the state, None for no table
    """

    async def main(clock: Clock) -> dict[str, Any]:
        incarnation = random.SystemRandom().getrandbits(62)
        name = f"mocap-{incarnation & 0xFFFFFFFF:08x}"
        host = config.mocap.host or socket.gethostname().split(".")[0]
        source = make_source(clock, config)
        recorder = (
            None if record is None else stack.enter_context(FrameRecorder(record))
        )
        mocap = MocapProcess(clock, config, source, name, host, incarnation, recorder)
        link = ZenohLink(
            mocap.bus,
            config.name,
            listen=[listen or config.endpoints()[PROCESS_NUMBERS.motion_capture]],
            connect=[],
            routers=config.routers,
            incarnation=incarnation,
            version=PACKAGE_VERSION,
            lease=config.lease,
            access=config.access(host, *filter(None, [listen])),
            on_refused=mocap.refuse,
            agreed=config.of_bodies(),
        )
        link.open()
        watchdog = Watchdog(clock)
        watchdog.start()
        end_on_signals(clock, mocap)
        try:
            await mocap.serve(link, *([MocapTableActor(mocap, show)] if show else []))
        finally:
            watchdog.stop()
            stack.close()
        return mocap.report() | {
            "network": asdict(link.counters),
            "late_s": watchdog.worst,
        }

    with contextlib.ExitStack() as stack:
        return run_wall(main)


def build_mocap_table(process: MocapProcess) -> Table:
    """Return a table of the bodies: drone, rate, age, place, number of frames without the body."""
    watch = process.watch
    now = process.clock.now()
    title = f"{process.source.where}: {process.source.state}, {_format_hertz(watch.mean_rate)} Hz"
    table = Table(
        "body",
        "drone",
        "Hz",
        "age s",
        "x",
        "y",
        "z",
        "dropped",
        title=title,
        box=box.SIMPLE_HEAD,
    )
    owners = {name: str(i) for i, name in watch.names.items()}
    for name in dict.fromkeys([*owners, *sorted(watch.sights)]):
        sight = watch.sights.get(name)
        cells = (
            ["never seen"] if sight is None else _format_cells(sight, now - sight.last)
        )
        table.add_row(name, owners.get(name, "-"), *cells)
    return table


def _format_cells(sight: BodyRecord, age: float) -> list[str | Text]:
    shown = (
        Text(f"{age:.1f}", "red")
        if age > TRACKING_LIMITS.missing_time
        else f"{age:.2f}"
    )
    return [
        _format_hertz(sight.rate),
        shown,
        *(f"{c:.3f}" for c in sight.flat[0:3]),
        str(sight.dropped),
    ]


def _format_hertz(rate: float) -> str:
    """Return a mean rate as text; "-" if there is none yet."""
    return "-" if math.isnan(rate) else f"{rate:.0f}"
