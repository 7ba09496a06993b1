"""Log variables of a recorded flight: a picture with one axis a variable, and a table."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.recording.analysis.plots import Pictures, set_time_axis
from crazychoir.recording.mcap.decode import MessageDecoder
from crazychoir.recording.mcap.sequence import read_messages
from crazychoir.runtime.clock import NS_PER_SECOND

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_LOG_AXES = 8
"""Largest number of variables in the picture; the table has all."""
AXIS_HEIGHT = 1.1
"""Height of an axis in inches."""
LEAST_STEP = 1e-6
"""s: least time between two values of a variable; a message also repeats older values."""


@dataclass(frozen=True)
class LoggedVariables:
    """The log variables that drones told during a flight."""

    rows: dict[str, dict[int, list[tuple[float, float]]]]
    """(s, value) in order of time, by variable and drone."""

    def write(self, path: Path) -> None:
        """Write a CSV file, one row a value."""
        lines = ["variable,drone,t_s,value"]
        for name, drones in self.rows.items():
            for i, values in drones.items():
                lines += [f"{name},{i},{t:.3f},{value!r}" for t, value in values]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_logged_variables(file: Path, began: float) -> LoggedVariables:
    """Return the log variables in a recording.

    began: s: beginning of the recording
    """
    decoder = MessageDecoder(file)
    rows: dict[str, dict[int, list[tuple[float, float]]]] = {}
    for message in read_messages(file, (DRONE_TOPICS.telemetry.name,)):
        drone = message.source.drone
        if drone is None:
            continue
        born = message.born_ns / NS_PER_SECOND - began
        for name, (value, age) in decoder.of(message).items():
            values = rows.setdefault(name, {}).setdefault(drone, [])
            taken = born - age
            is_new = not values or taken > values[-1][0] + LEAST_STEP
            if is_new and math.isfinite(value):
                values.append((taken, value))
    return LoggedVariables(rows)


def log_pictures(logged: LoggedVariables) -> Pictures:
    """Return the picture of the log variables; none without variables."""
    shown = list(logged.rows)[:MOST_LOG_AXES]
    if not shown:
        return {}
    height = AXIS_HEIGHT * len(shown) + 0.5
    return {"logs": (height, partial(_draw_logs, logged=logged, shown=shown))}


def _draw_logs(figure: "Figure", logged: LoggedVariables, shown: Sequence[str]) -> None:
    grid = figure.subplots(len(shown), 1, sharex=True, squeeze=False)
    end = 0.0
    for name, (axes,) in zip(shown, grid, strict=True):
        for k, (i, values) in enumerate(sorted(logged.rows[name].items())):
            t, x = zip(*values, strict=True)
            end = max(end, t[-1])
            colour = PICTURE_STYLE.colours[k % len(PICTURE_STYLE.colours)]
            axes.plot(t, x, color=colour, label=f"drone {i}")
        axes.set_ylabel(name)
    grid[0][0].legend()
    set_time_axis(grid[-1][0], end, shown[-1])
