"""Frames in a CSV file, `t,name,x,y,z,qx,qy,qz,qw`: recorded while published, and replayed."""

import csv
import io
import itertools
import logging
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, TextIO

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.files.text_files import read_text
from crazychoir.mocap.frames import Frame, frame_of
from crazychoir.mocap.source import Complaints, Say, Take
from crazychoir.mocap.view import LARGEST_TIME
from crazychoir.runtime.clock import SECOND, Clock

log = logging.getLogger(__name__)
HEAD = ("t", "name", "x", "y", "z", "qx", "qy", "qz", "qw")
"""The columns.

t: s from any origin, equal in all rows of a frame
name: name of the body
x, y, z: m
qx, qy, qz, qw: unit quaternion, body to world
"""
LONGEST_GAP = 600.0  # s
"""Longest time between two frames.

A longer gap means that the clock of the recording was set; a replay would wait for as long.
"""
SLOWEST_PERIOD = 2.0  # s
"""Median time between two frames below which the times are in s."""
PERIODS = (1e-4, 1.0)  # s
"""Range of the time between two frames of cameras, to guess the unit of times that are not in s."""
UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # s
"""Other units of time."""


class Recorder:
    """Writes frames into a new file, until its `with` block ends.

    Raises ConfigError if the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.frames = 0
        """Frames written."""
        self.error = ""
        """Reason why the recording ended early; empty if it did not."""
        try:
            self._file: TextIO = open(path, "x", encoding="utf-8", newline="")  # noqa: SIM115 - closed by __exit__
        except OSError as error:
            raise ConfigError(
                "--record", str(path), "a new file", f"{error.strerror}."
            ) from error
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow(HEAD)
        self._began = math.nan

    def write(self, frame: Frame, at: float) -> None:
        """Write a frame that was seen at `at` s. A full disk ends only the recording."""
        if self.error:
            return
        if math.isnan(self._began):
            self._began = at
        t = repr(at - self._began)
        try:
            self._writer.writerows(
                [t, name, *map(repr, flat.tolist())]
                for name, flat in frame.bodies.items()
            )
            self.frames += 1
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.error = self.error or str(error.strerror)
        log.warning("recording %s: %s; it ends here", self.path, error.strerror)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self._file.close()
        except OSError as failed:
            self._fail(failed)

    def report(self) -> dict[str, Any]:
        """Return the file, the number of its frames, and why it ended early."""
        return {"file": str(self.path), "frames": self.frames, "error": self.error}


def read_recording(path: str | Path) -> list[Frame]:
    """Return the frames of a file, in order of time.

    Raises ConfigError, with file, line and content, if the file is not valid.
    """
    allowed = f"a CSV file with the columns {','.join(HEAD)}"
    text = read_text(path, allowed)
    try:
        rows = list(csv.reader(io.StringIO(text)))
    except csv.Error as error:
        raise ConfigError(str(path), str(error), allowed) from error
    if not rows or tuple(cell.strip() for cell in rows[0]) != HEAD:
        found = ",".join(rows[0]) if rows else "an empty file"
        raise ConfigError(f"{path}, line 1", found, ",".join(HEAD))
    read = [
        _row(path, line, cells)
        for line, cells in enumerate(rows[1:], 2)
        if any(cell.strip() for cell in cells)
    ]
    if not read:
        raise ConfigError(
            str(path), "no row", "at least one row below the names of the columns"
        )
    return _frames(path, read)


Row = tuple[int, float, str, list[float]]
"""Line number, time, name and pose."""


def _row(path: str | Path, line: int, cells: list[str]) -> Row:
    """Return line, time, name and pose."""
    try:
        t, *numbers = (float(cell) for cell in (cells[0], *cells[2:]))
    except (ValueError, IndexError):
        t = math.nan
        numbers = []
    if len(numbers) != 7 or not all(map(math.isfinite, (t, *numbers))):
        raise ConfigError(
            f"{path}, line {line}",
            ",".join(cells),
            f"{','.join(HEAD)}: finite numbers, and a name",
        )
    name = cells[1].strip()
    if not name:
        raise ConfigError(
            f"{path}, line {line}",
            ",".join(cells),
            f"{','.join(HEAD)}: a name in the second column",
        )
    return line, t, name, numbers


def _frames(path: str | Path, rows: list[Row]) -> list[Frame]:
    _require_seconds(path, rows)
    frames: list[Frame] = []
    for t, group in itertools.groupby(rows, key=lambda row: row[1]):
        seen = list(group)
        line = seen[0][0]
        if frames:
            _require_later(path, line, frames[-1].time, t)
        frame = frame_of(
            len(frames), t, [(name, np.array(flat)) for _, _, name, flat in seen]
        )
        if frame.doubled:
            raise _doubled(path, seen, frame.doubled[0])
        frames.append(frame)
    return frames


def _require_seconds(path: str | Path, rows: list[Row]) -> None:
    """Raise ConfigError if times are not in s: too large, or too far from each other."""
    line, largest = max(
        ((row[0], row[1]) for row in rows), key=lambda timed: abs(timed[1])
    )
    times = sorted({row[1] for row in rows})
    periods = sorted(b - a for a, b in itertools.pairwise(times))
    period = periods[len(periods) // 2] if periods else 0.0
    if abs(largest) < LARGEST_TIME and (len(times) < 3 or period < SLOWEST_PERIOD):
        return
    found = f"t = {largest!r}, frames {period:g} apart"
    fits = [
        unit
        for unit, factor in UNITS.items()
        if PERIODS[0] <= period * factor <= PERIODS[1]
    ]
    do = (
        f"They are {' or '.join(fits)}, as it seems: convert t to s."
        if fits
        else "Convert t to s."
    )
    allowed = f"t in s: below {LARGEST_TIME:g} s, from any origin, and mostly less than {SLOWEST_PERIOD:g} s apart"
    raise ConfigError(f"{path}, line {line}", found, allowed, do)


def _require_later(path: str | Path, line: int, before: float, t: float) -> None:
    """Raise ConfigError if the clock of a recording was set.

    Its times then go back, or ahead by more than a replay can wait.
    """
    where = f"{path}, line {line}"
    do = "The clock of the recording was set there: cut the file in two, or shift the times that follow."
    if t < before:
        raise ConfigError(where, f"t = {t!r}", f"{before!r} or more, as before", do)
    if t - before > LONGEST_GAP:
        raise ConfigError(
            where,
            f"t = {t!r}, {t - before:.6g} s after the frame before",
            f"{LONGEST_GAP:g} s",
            do,
        )


def _doubled(path: str | Path, seen: list[Row], name: str) -> ConfigError:
    """Return the error for a body with two poses in one frame."""
    lines = [row[0] for row in seen if row[2] == name]
    found = (
        f"body {name!r} twice at t = {seen[0][1]!r}, in lines {lines[0]} and {lines[1]}"
    )
    do = "Remove one of them, give it another name, or write t with more digits."
    return ConfigError(str(path), found, "each body once in a frame", do)


class ReplaySource:
    """Replays a recording once, as fast as it was recorded.

    The times of the recording have any origin; the times of the replayed frames count from the
    first frame.

    Raises ConfigError if it cannot be read.
    """

    live = False
    again = 0

    def __init__(self, clock: Clock, path: str, say: Say | None = None) -> None:
        self.clock = clock
        self.where = f"replay of {path}"
        self.state = "replaying"
        self.frames = read_recording(path)
        self._complain = Complaints(self.where, say)

    async def run(self, take: Take) -> None:
        """Replay the recording to its end."""
        began_ns = self.clock.now_ns()
        origin = self.frames[0].time
        for frame in self.frames:
            seconds = frame.time - origin
            due_ns = began_ns + round(seconds * SECOND)
            await self.clock.sleep_until(due_ns)
            take(replace(frame, time=seconds), (self.clock.now_ns() - due_ns) / SECOND)
        self.state = "over"
        seconds = self.frames[-1].time - origin
        self._complain(
            self.clock.now(),
            "over",
            f"it is over after {seconds:.1f} s, no more frames",
        )
