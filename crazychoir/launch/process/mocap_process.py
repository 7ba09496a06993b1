"""The process of motion capture: its connection to the network, its signals, its live table."""

import contextlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from crazychoir.config.addresses import PROCESS_NUMBERS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.launch.process.owner import ProcessIdentity, run_owner
from crazychoir.mocap.process import MocapProcess, make_source
from crazychoir.mocap.recording import FrameRecorder
from crazychoir.mocap.watch import TRACKING_LIMITS, BodyRecord
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock, run_wall

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
        """Show the table MOCAP_TABLE_RATE times a second."""
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
        number = PROCESS_NUMBERS.motion_capture
        me = ProcessIdentity.draw("mocap", number, config.mocap.host)
        source = make_source(clock, config)
        recorder = (
            None if record is None else stack.enter_context(FrameRecorder(record))
        )
        mocap = MocapProcess(
            clock, config, source, me.name, me.host, me.incarnation, recorder
        )
        table = [MocapTableActor(mocap, show)] if show else []
        try:
            figures = await run_owner(config, mocap, me, listen, services=table)
        finally:
            stack.close()  # what is written counts in the report
        return mocap.report() | figures

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
