"""The result of a distributed algorithm: its iterates, its traffic, and files of them."""

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.json_view import to_plain_values
from crazychoir.errors import ConfigError
from crazychoir.files.output_files import output_file, require_writable_file

HISTORY_SUFFIXES = (".csv", ".json", ".npz")
"""Suffixes of the files that `History.save` can write."""


@dataclass(frozen=True)
class History:
    """The result of a simulation."""

    values: dict[int, dict[str, Any]]
    """{agent: {name: series}}: the values at the start and after each step.

    A series is an array with the round as its first index, or a list if the shape changes.
    """
    times: dict[int, Any]
    """{agent: (K+1,) s}: virtual times of the values."""
    cpu: dict[int, Any]
    """{agent: (K,) s}: computing time of each step."""
    messages: int
    """Number of messages of all agents."""
    lost: int
    """Number of lost messages of all agents."""
    resent: int
    """Number of messages that were sent again, of all agents."""
    bytes: int
    """Bytes sent by all agents."""
    simulated_s: float
    """Virtual time of the simulation, s."""
    wall_s: float
    """Real time of the simulation, s."""
    common: bool = True
    """True if the agents are to agree on x."""
    violations: dict[int, float] = field(default_factory=dict)
    """{agent: largest entry of its `violation` at the end}, for agents that have one.

    It says by how much the agent uses more than it may.
    """
    results: dict[int, Any] = field(default_factory=dict)
    """{agent: its `result` at the end}, for agents that have one."""
    traffic: dict[int, Any] = field(default_factory=dict)
    """{agent: (K+1, 2)}: numbers of messages and of bytes that it had sent at each value."""

    @property
    def violation(self) -> float | None:
        """Largest violation of all agents at the end, or None if no agent has one."""
        return max(self.violations.values(), default=None)

    @property
    def rounds(self) -> int:
        """Number of steps; for asynchronous agents the largest number of one agent."""
        return max(len(cpu) for cpu in self.cpu.values())

    @property
    def critical_path_s(self) -> float:
        """Computing time in s if each agent had a processor of its own.

        It is the sum over the rounds of the slowest agent's time. For agents with different numbers
        of steps, it is the time of the slowest agent.
        """
        steps = list(self.cpu.values())
        if len({len(cpu) for cpu in steps}) == 1:
            return float(sum(np.max(steps, axis=0).tolist()))
        return float(max(map(sum, steps)))

    def __repr__(self) -> str:
        names = ", ".join(next(iter(self.values.values()), {})) or "nothing"
        return (
            f"<{type(self).__name__} of {len(self.values)} agents: {self.rounds} rounds, "
            f"{self.messages} messages, recorded: {names}>"
        )

    def by_name(self, names: Sequence[str]) -> dict[str, dict[int, Any]]:
        """Return the series of these recorded values, {name: {agent: series}}."""
        return {
            name: {i: values[name] for i, values in self.values.items()}
            for name in names
        }

    def of(self, name: str = "x") -> Any:
        """Return the values of synchronous agents (N, K+1, ...), by increasing id."""
        return np.stack([values[name] for values in self.values.values()])

    def last(self, name: str = "x") -> dict[int, Any]:
        """Return the values at the end, by agent."""
        return {i: values[name][-1] for i, values in self.values.items()}

    def spread(self, name: str = "x") -> Any:
        """Return the disagreement of synchronous agents in each round.

            max_i |x_i - mean_j x_j|

        Returns an array (K+1,).
        """
        x = self.of(name)
        return np.abs(x - x.mean(axis=0)).reshape(*x.shape[:2], -1).max(axis=(0, 2))

    def disagreement(self, name: str = "x") -> float | None:
        """Return max_i |x_i - mean_j x_j| at the end.

        Returns inf if an entry is not finite. Returns None if each agent has an x of its own, or if
        the values
        are not arrays of one shape.
        """
        if name == "x" and not self.common:
            return None
        last = list(self.last(name).values())
        numeric = all(
            isinstance(x, np.ndarray | np.generic) and x.dtype.kind in "fiu"
            for x in last
        )
        if not numeric or len({x.shape for x in last}) != 1:
            return None
        if not all(np.isfinite(x).all() for x in last):
            return math.inf
        return float(np.abs(np.array(last) - np.mean(last, axis=0)).max(initial=0.0))

    def to_json(self) -> dict[str, Any]:
        """Return the figures and the last values of each agent; `save` writes the series."""
        traffic = ("messages", "lost", "resent", "bytes")
        figures = (
            "rounds",
            "violation",
            *traffic,
            "simulated_s",
            "wall_s",
            "critical_path_s",
        )
        names = next(iter(self.values.values()))
        last = {
            i: {name: series[-1] for name, series in values.items()}
            for i, values in self.values.items()
        }
        for i, result in self.results.items():
            last[i]["result"] = _round_trip_json(
                list_parts(result) if is_dataclass(result) else result
            )
        ends = {
            "disagreement": {name: self.disagreement(name) for name in names},
            "agents": last,
        }
        counted: dict[str, Any] = to_plain_values(
            {name: getattr(self, name) for name in figures} | ends
        )
        return counted

    def save(self, path: str | Path) -> None:
        """Write the series to a file; the suffix of `path` decides the format.

        - .csv: one row for each agent and round
        - .json: all series as lists
        - .npz: arrays named x_3, time_3, ...

        A value that an agent does not have, for example because others have more entries, is an
        empty cell of a .csv.
        The results are in the last row of each agent, or in result_3, with one part
        each, result.x_3. A part that is not numbers is written as JSON.
        Raises ConfigError for another suffix, and for a .npz of values that change their shape.
        """
        path = Path(path)
        require_suffix(path)
        require_writable_file(path, "history")
        with output_file(path, "history") as place:
            self._write(place, path.suffix.lower())

    def _write(self, path: Path, kind: str) -> None:
        if kind == ".csv":
            with path.open("w", encoding="utf-8", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(self._rows())
        elif kind == ".json":
            told = to_plain_values(
                self.to_json() | {"values": self.values, "times": self.times}
            )
            path.write_text(json.dumps(told), encoding="utf-8")
        else:
            series = {
                f"{name}_{i}": x
                for i, values in self.values.items()
                for name, x in values.items()
            }
            changing = next(
                (name for name, x in series.items() if isinstance(x, list)), None
            )
            if changing is not None:
                raise ConfigError(
                    f"history: {changing}",
                    "a shape that changes",
                    "one shape in .npz",
                    "Save as .json.",
                )
            times = {f"time_{i}": time for i, time in self.times.items()}
            results = {
                f"{name}_{i}": x
                for i in self.results
                for name, x in self._result(i).items()
            }
            # An open file: np.savez would add .npz to a name that ends in .NPZ.
            with path.open("wb") as file:
                np.savez(file, allow_pickle=False, **{**series, **times, **results})

    def _rows(self) -> list[list[Any]]:
        """Return the head and the rows; an array has one column for each entry."""
        rows = {
            (i, k): self._entries(i, k)
            for i, times in self.times.items()
            for k in range(len(times))
        }
        found = dict.fromkeys(column for entries in rows.values() for column in entries)
        ends = dict.fromkeys(name for i in self.results for name in self._result(i))
        names = [*next(iter(self.values.values())), *ends]
        columns = sorted(found, key=lambda column: (names.index(column[0]), column[1]))
        head = [
            "agent",
            "round",
            "time_s",
            *(name + _format_index(at) for name, at in columns),
        ]
        cells = {
            row: [entries.get(column, "") for column in columns]
            for row, entries in rows.items()
        }
        return [head, *([i, k, self.times[i][k], *cells[i, k]] for i, k in rows)]

    def _entries(self, i: int, k: int) -> dict[tuple[str, tuple[int, ...]], Any]:
        """Return the values of agent i after k steps, by name and place in the array."""
        arrays = {name: np.array(series[k]) for name, series in self.values[i].items()}
        if k == len(self.times[i]) - 1 and i in self.results:
            arrays |= self._result(i)
        return {
            (name, at): x[at].item()
            for name, x in arrays.items()
            for at in np.ndindex(x.shape)
        }

    def _result(self, i: int) -> dict[str, Any]:
        """Return the result of agent i, one array for each part."""
        parts = list_parts(self.results[i])
        return {
            f"result.{name}" if name else "result": _convert_to_array(part)
            for name, part in parts.items()
        }


def require_suffix(path: Path, where: str = "history") -> None:
    """Raise ConfigError unless the file name has one of the suffixes of a history."""
    if path.suffix.lower() not in HISTORY_SUFFIXES:
        raise ConfigError(
            where, path.name, f"a file that ends in {', '.join(HISTORY_SUFFIXES)}"
        )


def list_parts(result: Any) -> dict[str, Any]:
    """Return the fields of a dataclass by name; other results are one part with the name ""."""
    return (
        {f.name: getattr(result, f.name) for f in fields(result)}
        if is_dataclass(result)
        else {"": result}
    )


def _round_trip_json(value: Any) -> Any:
    """Return the value as it looks after a round trip through JSON; unknown types become text."""
    return json.loads(json.dumps(to_plain_values(value), default=str))


def _convert_to_array(value: Any) -> Any:
    """Return an array of numbers or text; other values become their JSON text."""
    try:
        array = np.array(value)
    except ValueError:  # parts of different lengths
        return np.array(json.dumps(_round_trip_json(value)))
    return (
        array
        if array.dtype.kind in "biufU"
        else np.array(json.dumps(_round_trip_json(value)))
    )


def _format_index(at: tuple[int, ...]) -> str:
    return "".join(f"[{n}]" for n in at)
