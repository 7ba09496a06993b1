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
from crazychoir.files.recorded_times import require_later, require_seconds
from crazychoir.files.text_files import read_text
from crazychoir.mocap.frames import PoseFrame, make_frame
from crazychoir.mocap.source import ReportText, SourceComplaints, TakeFrame
from crazychoir.runtime.clock import NS_PER_SECOND, Clock

log = logging.getLogger(__name__)
RECORDING_COLUMNS = ("t", "name", "x", "y", "z", "qx", "qy", "qz", "qw")
"""t: s from any origin, the same in all rows of a frame;  x, y, z: m;  q: body to world."""


class FrameRecorder:
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
        self._writer.writerow(RECORDING_COLUMNS)
        self._began = math.nan

    def write(self, frame: PoseFrame, at: float) -> None:
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


def read_recording(path: str | Path) -> list[PoseFrame]:
    """Return the frames of a file, in order of time.

    Raises ConfigError, with file, line and content, if the file is not valid.
    """
    allowed = f"a CSV file with the columns {','.join(RECORDING_COLUMNS)}"
    text = read_text(path, allowed)
    try:
        rows = list(csv.reader(io.StringIO(text)))
    except csv.Error as error:
        raise ConfigError(str(path), str(error), allowed) from error
    if not rows or tuple(cell.strip() for cell in rows[0]) != RECORDING_COLUMNS:
        found = ",".join(rows[0]) if rows else "an empty file"
        raise ConfigError(f"{path}, line 1", found, ",".join(RECORDING_COLUMNS))
    read = [
        _parse_row(path, line, cells)
        for line, cells in enumerate(rows[1:], 2)
        if any(cell.strip() for cell in cells)
    ]
    if not read:
        raise ConfigError(
            str(path), "no row", "at least one row below the names of the columns"
        )
    return _group_frames(path, read)


RecordedRow = tuple[int, float, str, list[float]]
"""Line number, time, name and pose."""


def _parse_row(path: str | Path, line: int, cells: list[str]) -> RecordedRow:
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
            f"{','.join(RECORDING_COLUMNS)}: finite numbers, and a name",
        )
    name = cells[1].strip()
    if not name:
        raise ConfigError(
            f"{path}, line {line}",
            ",".join(cells),
            f"{','.join(RECORDING_COLUMNS)}: a name in the second column",
        )
    return line, t, name, numbers


def _group_frames(path: str | Path, rows: list[RecordedRow]) -> list[PoseFrame]:
    require_seconds(path, [row[0] for row in rows], [row[1] for row in rows])
    frames: list[PoseFrame] = []
    for t, group in itertools.groupby(rows, key=lambda row: row[1]):
        seen = list(group)
        line = seen[0][0]
        if frames:
            require_later(path, line, frames[-1].time, t)
        frame = make_frame(
            len(frames), t, [(name, np.array(flat)) for _, _, name, flat in seen]
        )
        if frame.doubled:
            raise _doubled_error(path, seen, frame.doubled[0])
        frames.append(frame)
    return frames


def _doubled_error(path: str | Path, seen: list[RecordedRow], name: str) -> ConfigError:
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

    def __init__(self, clock: Clock, path: str, say: ReportText | None = None) -> None:
        self.clock = clock
        self.where = f"replay of {path}"
        self.state = "replaying"
        self.frames = read_recording(path)
        self._complain = SourceComplaints(self.where, say)

    async def run(self, take: TakeFrame) -> None:
        """Replay the recording to its end."""
        began_ns = self.clock.now_ns()
        origin = self.frames[0].time
        for frame in self.frames:
            seconds = frame.time - origin
            due_ns = began_ns + round(seconds * NS_PER_SECOND)
            await self.clock.sleep_until(due_ns)
            take(
                replace(frame, time=seconds),
                (self.clock.now_ns() - due_ns) / NS_PER_SECOND,
            )
        self.state = "over"
        seconds = self.frames[-1].time - origin
        self._complain(
            self.clock.now(),
            "over",
            f"it is over after {seconds:.1f} s, no more frames",
        )
