"""The file of a sweep: a line of JSON a run, so that an interrupted sweep goes on where it was."""

import fcntl
import json
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Self

from crazychoir.api.sweep_rows import Row
from crazychoir.errors import ConfigError
from crazychoir.files.output_files import output_file, require_writable_file

ROW_KEY = "key"
"""Name of the key of a run in its line."""


class SweepFile:
    """Keeps the rows of a sweep in a file, for the `with` block.

    While the sweep flies, rows are added in the order in which the runs end. At its end they are
    written in the order of the sweep: the file is the same however often the sweep was interrupted.
    Rows with other inputs, such as more seeds, stay in the file, below those of the sweep.

    path: the file
    runs: {key: inputs} of each run, in the order of the sweep; equal keys mean equal rows

    Attributes:
    rows: {key: row} of the runs of this sweep that have ended
    Raises ConfigError if the file has runs of another sweep, or another sweep writes it now.
    """

    def __init__(self, path: Path, runs: Mapping[str, Row]) -> None:
        self.path = path
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
        self._file.seek(0)
        stale = 0
        length = 0
        for line in self._file.read().splitlines(keepends=True):
            row = _parse_line(line)
            if row is None:
                break
            length += len(line.encode())
            key = row.pop(ROW_KEY)
            if key in self._runs:
                self.rows[key] = row
            elif self._has_inputs_of_a_run(row):
                stale += 1
            else:
                self._other_lines.append(line)
        if stale or (length == 0 and self._file.tell() > 0 and not self._is_cut_line()):
            found = f"{stale} runs of another sweep" if stale else "another file"
            do = (
                "Name another file, or remove it. A sweep is another one if its mission, swarm or "
                "version has changed."
            )
            raise ConfigError(
                str(self.path), found, "a new file, or that of this sweep", do
            )
        self._file.truncate(length)

    def _has_inputs_of_a_run(self, row: Row) -> bool:
        """Return whether a row with another key has the inputs of one of the runs."""
        return any(
            all(name in row and row[name] == value for name, value in inputs.items())
            for inputs in self._runs.values()
        )

    def _is_cut_line(self) -> bool:
        """Return whether the file is the beginning of a first line of a sweep."""
        self._file.seek(0)
        start = f'{{"{ROW_KEY}": '
        text = self._file.read(len(start))
        return start.startswith(text)

    def add(self, key: str, row: Row) -> None:
        """Add the row of a run that has ended."""
        self.rows[key] = row
        self._file.write(_format_line(key, row))
        self._file.flush()

    def finish(self) -> None:
        """Write all rows in the order of the sweep, then those of other inputs."""
        lines = [_format_line(key, self.rows[key]) for key in self._runs]
        lines += self._other_lines
        with output_file(self.path, "file") as place:
            place.write_text("".join(lines), encoding="utf-8")


def _parse_line(line: str) -> Row | None:
    """Return the row of a line with its key; None for a cut line, or one of another program."""
    if not line.endswith("\n"):
        return None
    try:
        row = json.loads(line)
    except ValueError:
        return None
    return row if isinstance(row, dict) and ROW_KEY in row else None


def _format_line(key: str, row: Mapping[str, Any]) -> str:
    return json.dumps({ROW_KEY: key, **row}) + "\n"
