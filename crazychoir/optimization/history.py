"""What came of a distributed algorithm that was run: its iterates, its traffic, and files of them."""

import csv
import json
import math
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.json_view import plain
from crazychoir.errors import ConfigError
from crazychoir.files.output_files import require_writable_file, written_file

SUFFIXES = (".csv", ".json", ".npz")


@dataclass(frozen=True)
class History:
    """What came of a simulation.

    values: {agent: {name: what it was}} at the start and after each step: an array whose first index is the round, or a
    list where the shape changes;  times: {agent: (K+1,) s} of virtual time;  cpu: {agent: (K,) s} a step;
    messages, lost, resent, bytes: of all agents;  simulated_s, wall_s: how long it took, in virtual and in real time;
    common: whether the agents are to agree on x, not `common = False`;  violations: {agent: the largest entry of its
    `violation` at the end}, of those that have one: by how much it takes more than it is allowed;
    results: {agent: its `result` at the end}, of those that have one.
    """

    values: dict[int, dict[str, Any]]
    times: dict[int, Any]
    cpu: dict[int, Any]
    messages: int
    lost: int
    resent: int
    bytes: int
    simulated_s: float
    wall_s: float
    common: bool = True
    violations: dict[int, float] = field(default_factory=dict)
    results: dict[int, Any] = field(default_factory=dict)

    @property
    def violation(self) -> float | None:
        """The largest of all agents at the end; None if none of them has one."""
        return max(self.violations.values(), default=None)

    @property
    def rounds(self) -> int:
        """Steps; of asynchronous agents, those of the one that made most."""
        return max(len(cpu) for cpu in self.cpu.values())

    @property
    def critical_path_s(self) -> float:
        """s of computing if each agent had a processor: the slowest agent of each round; asynchronous, of all."""
        steps = list(self.cpu.values())
        if len({len(cpu) for cpu in steps}) == 1:
            return float(sum(map(max, zip(*steps, strict=True))))
        return float(max(map(sum, steps)))

    def of(self, name: str = "x") -> Any:
        """(N, K+1, ...) of synchronous agents, by increasing id."""
        return np.stack([values[name] for values in self.values.values()])

    def last(self, name: str = "x") -> dict[int, Any]:
        """{agent: what it was at the end}."""
        return {i: values[name][-1] for i, values in self.values.items()}

    def spread(self, name: str = "x") -> Any:
        """(K+1,) max_i |x_i - mean_j x_j|, by round: the disagreement of synchronous agents."""
        x = self.of(name)
        return np.abs(x - x.mean(axis=0)).reshape(*x.shape[:2], -1).max(axis=(0, 2))

    def disagreement(self, name: str = "x") -> float | None:
        """max_i |x_i - mean_j x_j| at the end, inf if an entry is; None of an x of which each agent has its own, and of
        what are no arrays of one shape.
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
        """The figures and, of each agent, the last values; the histories are for `save`."""
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
            last[i]["result"] = _told(
                parts_of(result) if is_dataclass(result) else result
            )
        ends = {
            "disagreement": {name: self.disagreement(name) for name in names},
            "agents": last,
        }
        counted: dict[str, Any] = plain(
            {name: getattr(self, name) for name in figures} | ends
        )
        return counted

    def save(self, path: str | Path) -> None:
        """Write the histories, as the suffix says: .csv (a row an agent and round), .json, .npz (x_3, time_3, ...).

        What an agent does not have, as where others have more entries, is an empty cell of a .csv. The results are in
        the last row of each agent, or result_3, with a part each, result.x_3; what are no numbers as JSON. Raises
        ConfigError for another suffix, and for a .npz of what changes its shape.
        """
        path = Path(path)
        require_suffix(path)
        require_writable_file(path, "history")
        with written_file(path, "history") as place:
            self._write(place, path.suffix.lower())

    def _write(self, path: Path, kind: str) -> None:
        if kind == ".csv":
            with path.open("w", encoding="utf-8", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(self._rows())
        elif kind == ".json":
            told = plain(self.to_json() | {"values": self.values, "times": self.times})
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
            with path.open(
                "wb"
            ) as file:  # np.savez would add .npz to a name that ends in .NPZ
                np.savez(file, allow_pickle=False, **{**series, **times, **results})

    def _rows(self) -> list[list[Any]]:
        """Head and rows; an array has a column an entry."""
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
            *(name + _place(at) for name, at in columns),
        ]
        cells = {
            row: [entries.get(column, "") for column in columns]
            for row, entries in rows.items()
        }
        return [head, *([i, k, self.times[i][k], *cells[i, k]] for i, k in rows)]

    def _entries(self, i: int, k: int) -> dict[tuple[str, tuple[int, ...]], Any]:
        """Of agent i after k steps, by name and place in the array."""
        arrays = {name: np.array(series[k]) for name, series in self.values[i].items()}
        if k == len(self.times[i]) - 1 and i in self.results:
            arrays |= self._result(i)
        return {
            (name, at): x[at].item()
            for name, x in arrays.items()
            for at in np.ndindex(x.shape)
        }

    def _result(self, i: int) -> dict[str, Any]:
        """Of agent i, an array a part."""
        parts = parts_of(self.results[i])
        return {
            f"result.{name}" if name else "result": _array(part)
            for name, part in parts.items()
        }


def require_suffix(path: Path, where: str = "history") -> None:
    """Raise ConfigError for the name of a file that is no history's."""
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(
            where, path.name, f"a file that ends in {', '.join(SUFFIXES)}"
        )


def parts_of(result: Any) -> dict[str, Any]:
    """By name, as those of a dataclass; what has no parts is the one without a name."""
    return (
        {f.name: getattr(result, f.name) for f in fields(result)}
        if is_dataclass(result)
        else {"": result}
    )


def _told(value: Any) -> Any:
    """As JSON has it; else its text."""
    return json.loads(json.dumps(plain(value), default=str))


def _array(value: Any) -> Any:
    """Of numbers, or of a text; of what is neither, of its JSON."""
    try:
        array = np.array(value)
    except ValueError:  # of several lengths
        return np.array(json.dumps(_told(value)))
    return array if array.dtype.kind in "biufU" else np.array(json.dumps(_told(value)))


def _place(at: tuple[int, ...]) -> str:
    return "".join(f"[{n}]" for n in at)
