"""Fly a mission many times, with other seeds, losses and options, in as many processes as there are cores."""

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from crazychoir.api.flight_request import FlightRequest
from crazychoir.api.flying import require_flyable
from crazychoir.api.sweep_file import SweepFile
from crazychoir.api.sweep_progress import open_progress
from crazychoir.api.sweep_rows import Row, build_first_figures
from crazychoir.api.table import Table
from crazychoir.api.worker_pool import WorkerPool
from crazychoir.bus.json_view import to_plain_values
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, CrazyChoirError, refuse_exit
from crazychoir.files.private_folder import scratch_folder
from crazychoir.guidance.mission import Mission, check_before_flight
from crazychoir.launch.recording import (
    compute_file_digests,
    list_versions,
    read_mission_text,
)
from crazychoir.numerics.compiling import KERNEL_QUEUE
from crazychoir.numerics.kernel_cache import share_with_children
from crazychoir.runtime.user_code_guard import share_watch

REQUEST_INPUTS = ("drones", "loss", "seed")
"""Inputs of a sweep that are no options."""
DEFAULT_SEEDS = range(10)
"""Seeds of a sweep that names none."""
Watch = Callable[[int, int, Row], None]
"""Called after each run with the count of runs that have ended, that of all runs, and the row."""


@dataclass(frozen=True, slots=True)
class SweepRun:
    """One run of a sweep."""

    inputs: dict[str, Any]
    """What the sweep has chosen for it, by name."""
    config: SwarmConfig | None
    """The swarm; None if it is refused."""
    key: str
    """Digest of all that its row depends on."""
    refusal: str | None = None
    """Why it is refused."""

    def build_row(self, row: Row) -> Row:
        """Return the row with the inputs before the figures."""
        return {**self.inputs, **{k: v for k, v in row.items() if k not in self.inputs}}


class SweepInterrupted(KeyboardInterrupt):
    """Ctrl-C has ended a sweep.

    table: the runs that have ended before
    """

    def __init__(self, table: Table) -> None:
        super().__init__()
        self.table = table


def sweep(
    mission: str | Path,
    *,
    seeds: Iterable[int] = DEFAULT_SEEDS,
    loss: float | Iterable[float] | None = None,
    options: Mapping[str, Any] | None = None,
    drones: int | Iterable[int] | None = None,
    jobs: int | None = None,
    file: str | Path | None = None,
    watch: Watch | None = None,
) -> Table:
    """Fly a mission in virtual time for each combination of the values; return a table with a row a run.

    A run that fails is a row with `success` False and its `reason`.

    mission: name of a mission, path of a mission file (.py) or of a swarm file (.toml)
    seeds: the seeds
    loss: share of the messages that is lost, one or several
    options: {name: values} of mission options; "network.delay" names a key in a table of the swarm file
    drones: number of drones, one or several
    jobs: number of processes, at least 1; None: one a core
    file: file (.jsonl) that keeps the rows. After Ctrl-C the same call goes on where it was, and its
        file is the same as without the interruption
    watch: called after each run; None shows a bar of progress on a terminal
    Raises ConfigError for a mission or value that is not allowed, if no run can begin.
    Raises SweepInterrupted, a KeyboardInterrupt with the table until then, on Ctrl-C.
    """
    if jobs is not None and jobs < 1:
        raise ConfigError("jobs", jobs, "1 or more processes")
    if not isinstance(mission, str | Path):
        do = "Save it as a file: each process imports the mission by itself. In a notebook, %%writefile does."
        raise ConfigError("mission", repr(mission), "a name or a file", do)
    grid = _build_grid(seeds, loss, options or {}, drones)
    most = math.prod(len(values) for values in grid.values())
    with ExitStack() as stack:
        # The processes import while this one plans.
        folder = stack.enter_context(scratch_folder("crazychoir-sweep-"))
        stack.enter_context(share_with_children(folder))
        pool = stack.enter_context(WorkerPool(min(jobs or count_cores(), most)))
        runs = plan_runs(str(mission), grid)
        kept = None
        if file is not None:
            inputs = {run.key: to_plain_values(run.inputs) for run in runs}
            name = Path(mission).name
            kept = stack.enter_context(SweepFile(Path(file), name, inputs))
        if watch is None:
            watch = stack.enter_context(open_progress())
        rows = {} if kept is None else dict(kept.rows)
        try:
            fly_runs(runs, rows, pool, kept, watch)
        except KeyboardInterrupt:
            raise SweepInterrupted(_build_table(runs, rows, grid)) from None
    return _build_table(runs, rows, grid)


def _build_table(
    runs: Sequence[SweepRun], rows: Mapping[str, Row], inputs: Iterable[str]
) -> Table:
    """Return the table of the runs that have a row."""
    ended = [run.build_row(rows[run.key]) for run in runs if run.key in rows]
    return Table(ended, list(inputs))


def count_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def plan_runs(mission: str, grid: Mapping[str, Sequence[Any]]) -> list[SweepRun]:
    """Return a run for each combination of the values; those of the last name change fastest.

    grid: values by name; "seed", "loss" and "drones" are those of `FlightRequest`, all others are
        options
    Raises the first error of the mission or its values if no run can begin.
    """
    planner = _Planner(mission)
    with share_watch(), refuse_exit("the mission"):
        runs = [
            planner.plan(dict(zip(grid, values, strict=True)))
            for values in product(*grid.values())
        ]
        planner.require_flyable_run()
    return runs


class _Planner:
    """Chooses the swarm of each run before the first run flies.

    mission: mission or swarm file
    """

    def __init__(self, mission: str) -> None:
        self._errors: list[CrazyChoirError] = []
        self._chosen: list[tuple[SwarmConfig, Mission]] = []
        self._mission = mission
        self._versions = list_versions()
        self._modules: dict[str, str] | None = None

    def plan(self, inputs: dict[str, Any]) -> SweepRun:
        """Return the run with these inputs; a refused run has no swarm."""
        try:
            config, key = self._choose(dict(inputs))
        except CrazyChoirError as error:
            self._errors.append(error)
            text = f"{type(error).__name__}: {error}"
            return SweepRun(inputs, None, _compute_digest([inputs, text]), text)
        return SweepRun(inputs, config, key)

    def require_flyable_run(self) -> None:
        """Raise the first error unless the mission's own check lets one of the runs fly.

        Each process checks the other runs.
        """
        for config, mission in self._chosen:
            try:
                check_before_flight(mission, config)
            except CrazyChoirError as error:
                self._errors.append(error)
            else:
                return
        raise self._errors[0]

    def _choose(self, options: dict[str, Any]) -> tuple[SwarmConfig, str]:
        """Return the swarm and the digest of all that the row of a run depends on."""
        drones, loss, seed = (options.pop(name, None) for name in REQUEST_INPUTS)
        request = FlightRequest(self._mission, drones, None, loss, seed, options)
        config, mission = request.choose()
        require_flyable(config, config.ids, is_virtual=True)
        self._chosen.append((config, mission))
        if self._modules is None:
            self._modules = compute_file_digests(config, mission)
        files = compute_file_digests(config, None)
        text = read_mission_text(mission)
        depends = [config.dumps(), text, self._modules, files, self._versions]
        return config, _compute_digest(depends)


def fly_runs(
    runs: Sequence[SweepRun],
    rows: dict[str, Row],
    pool: WorkerPool,
    kept: SweepFile | None,
    watch: Watch,
) -> None:
    """Fly the runs without a row, and add the row of each as soon as it has ended.

    runs: the runs
    rows: {key: row} of the runs that have ended
    pool: the processes
    kept: file that keeps the rows; None for no file
    watch: called after each run
    """
    left = {run.key: run for run in runs if run.key not in rows}
    count = len({run.key for run in runs})

    def take(key: str, figures: Row) -> None:
        row = rows[key] = left[key].build_row(figures)
        if kept is not None:
            kept.add(key, row)
        watch(len(rows), count, row)

    for run in left.values():
        if run.config is None:
            take(run.key, build_first_figures(False, run.refusal))
    todo = [(run.key, run.config) for run in left.values() if run.config is not None]
    if todo:
        # Compiled here if need be, not once in each process.
        KERNEL_QUEUE.compile()
        for key, row in pool.fly(todo):
            take(key, row)
    if kept is not None:
        kept.finish()


def _build_grid(
    seeds: Iterable[int],
    loss: float | Iterable[float] | None,
    options: Mapping[str, Any],
    drones: int | Iterable[int] | None,
) -> dict[str, list[Any]]:
    """Return the values of each input that is given, by its name; the seeds are the last."""
    given: dict[str, Any] = {"drones": drones, **options, "loss": loss, "seed": seeds}
    if loss is not None:
        given["loss"] = [float(share) for share in _list_values(loss)]
    grid = {name: _list_values(x) for name, x in given.items() if x is not None}
    for name, values in grid.items():
        if not values:
            raise ConfigError(name, "no value", "one value or several")
    return grid


def _list_values(values: Any) -> list[Any]:
    """Return several values as a list; a text or a number is one value."""
    if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        return [values]
    return [value.item() if hasattr(value, "item") else value for value in values]


def _compute_digest(values: Any) -> str:
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
