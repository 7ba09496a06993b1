"""The file of a sweep: a line of JSON a run, so that an interrupted sweep goes on where it was."""

import fcntl
import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NoReturn, Self

import msgspec

from crazychoir.api.sweep_rows import Row
from crazychoir.errors import ConfigError
from crazychoir.files.output_files import output_file, require_writable_file

log = logging.getLogger(__name__)
LINE_START = b'{"key": '
"""Start of each line of the file."""


class KeptRun(msgspec.Struct, frozen=True):
    """A line of the file: a run that has ended."""

    key: str
    """Key of the run; equal keys mean equal rows."""
    mission: str
    """Name of its mission, or of its file."""
    row: dict[str, Any]
    """Its row of the table."""


class SweepFile:
    """Keeps the rows of a sweep in a file, for the `with` block.

    While the sweep flies, rows are added in the order in which the runs end. At its end they are
    written in the order of the sweep: the file is the same however often the sweep was interrupted.
    Rows with other inputs, such as more seeds, stay in the file, below those of the sweep. A damaged
    line is left out with a warning, and its run flies again.

    path: the file
    mission: name of the mission, or of its file
    runs: {key: inputs} of each run, in the order of the sweep; equal keys mean equal rows

    Attributes:
    rows: {key: row} of the runs of this sweep that have ended
    Raises ConfigError if the file has runs of another sweep or mission, or another sweep writes it now.
    """

    def __init__(self, path: Path, mission: str, runs: Mapping[str, Row]) -> None:
        self.path = path
        self._mission = mission
        self.rows: dict[str, Row] = {}
        self._runs = dict(runs)
        self._other_lines: list[str] = []

    def __enter__(self) -> Self:
        require_writable_file(self.path, "file", parents=True)
        self._file: IO[str] = self.path.open("a+", encoding="utf-8")
        try:
            self._lock()
            self._read()
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            found = "a file that another sweep writes"
            raise ConfigError(str(self.path), found, "a file of its own") from None

    def _read(self) -> None:
        """Read the rows of an earlier sweep, and remove a line that was not written to its end."""
        lines = self.path.read_bytes().splitlines(keepends=True)
        is_cut = bool(lines) and _is_cut(lines[-1])
        cut_line = lines.pop() if is_cut else b""
        runs = [_parse_line(line) for line in lines]
        self._require_runs(cut_line, runs)
        missions: dict[str, int] = {}
        stale = 0
        for number, (line, run) in enumerate(zip(lines, runs, strict=True), 1):
            if run is None:
                do = "it is left out, and its run flies again if it is of this sweep"
                log.warning("%s: line %d is damaged: %s", self.path, number, do)
            elif run.key in self._runs:
                self.rows[run.key] = run.row
            elif run.mission != self._mission:
                missions[run.mission] = missions.get(run.mission, 0) + 1
            elif self._has_inputs_of_a_run(run.row):
                stale += 1
            else:
                self._other_lines.append(line.decode().rstrip("\n") + "\n")
        self._require_own_runs(missions, stale)
        self._file.truncate(sum(len(line) for line in lines))
        if is_cut:
            log.warning("%s: the last line was cut off, and is removed", self.path)
        if lines and not lines[-1].endswith(b"\n"):
            self._file.write("\n")

    def _require_runs(self, cut_line: bytes, runs: Sequence[KeptRun | None]) -> None:
        """Raise ConfigError for a file that no sweep has written.

        cut_line: its last line if that was not written to its end; empty if it was
        """
        is_foreign = runs or not LINE_START.startswith(cut_line[: len(LINE_START)])
        if is_foreign and all(run is None for run in runs):
            self._refuse("another file", "")

    def _require_own_runs(self, missions: Mapping[str, int], stale: int) -> None:
        """Raise ConfigError if the file has runs of other missions, or of another sweep of this one.

        missions: {mission: number of its runs} of all others
        stale: number of runs with the inputs, but not the key, of a run of this sweep
        """
        if missions:
            texts = [f"{count} of {name}" for name, count in missions.items()]
            found = f"runs of another mission: {', '.join(texts)}"
            self._refuse(found, f"This sweep flies {self._mission}.")
        if stale:
            do = "A sweep is another one if its mission, swarm or version has changed."
            self._refuse(f"{stale} runs of another sweep", do)

    def _refuse(self, found: str, do: str) -> NoReturn:
        advice = f"Name another file, or remove it. {do}".rstrip()
        allowed = "a new file, or that of this sweep"
        raise ConfigError(str(self.path), found, allowed, advice)

    def _has_inputs_of_a_run(self, row: Row) -> bool:
        """Return whether a row with another key has the inputs of one of the runs."""
        return any(
            all(name in row and row[name] == value for name, value in inputs.items())
            for inputs in self._runs.values()
        )

    def add(self, key: str, row: Row) -> None:
        """Add the row of a run that has ended."""
        self.rows[key] = row
        self._file.write(self._format_line(key, row))
        self._file.flush()

    def finish(self) -> None:
        """Write all rows in the order of the sweep, then those of other inputs."""
        lines = [self._format_line(key, self.rows[key]) for key in self._runs]
        lines += self._other_lines
        with output_file(self.path, "file") as place:
            place.write_text("".join(lines), encoding="utf-8")

    def _format_line(self, key: str, row: Mapping[str, Any]) -> str:
        return json.dumps({"key": key, "mission": self._mission, "row": row}) + "\n"


def _parse_line(line: bytes) -> KeptRun | None:
    """Return the run of a line; None for a damaged line, or one of another program."""
    try:
        return msgspec.convert(json.loads(line), KeptRun)
    except (ValueError, RecursionError, msgspec.ValidationError):
        return None


def _is_cut(last_line: bytes) -> bool:
    """Return whether the last line of a file was not written to its end."""
    if last_line.endswith(b"\n"):
        return False
    try:
        json.loads(last_line)
    except (ValueError, RecursionError):
        return True
    return False
