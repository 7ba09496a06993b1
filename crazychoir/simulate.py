"""Any distributed algorithm on simulated agents: all in this process, over the communicator and a simulated network."""

import asyncio
import contextlib
import csv
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from crazychoir.bus.impairment import Impairment
from crazychoir.bus.local import Bus
from crazychoir.bus.plain import plain
from crazychoir.bus.rules import Rule
from crazychoir.errors import AgentFailed, ConfigError, CrazyChoirError, RoundTimeout
from crazychoir.optimization.checks import nan_in, require_team
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.swarm.communicator import Communicator
from crazychoir.swarm.graph import Graph, GraphSequence
from crazychoir.swarm.round import Round
from crazychoir.swarm.running import Interval, Pace, run_algorithm

A = TypeVar("A", bound=Round)
Run = Callable[[Callable[[Clock], Any]], Any]
MOST_ROUNDS: Final = 1_000_000
"""Of an algorithm that never ends by itself."""
DELAY: Final = 0.001
"""s that a message is on its way: so that time goes on with the rounds."""
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
        numeric = all(isinstance(x, np.ndarray | np.generic) and x.dtype.kind in "fiu" for x in last)
        if not numeric or len({x.shape for x in last}) != 1:
            return None
        if not all(np.isfinite(x).all() for x in last):
            return math.inf
        return float(np.abs(np.array(last) - np.mean(last, axis=0)).max(initial=0.0))

    def to_json(self) -> dict[str, Any]:
        """The figures and, of each agent, the last values; the histories are for `save`."""
        traffic = ("messages", "lost", "resent", "bytes")
        figures = ("rounds", "violation", *traffic, "simulated_s", "wall_s", "critical_path_s")
        names = next(iter(self.values.values()))
        last = {i: {name: series[-1] for name, series in values.items()} for i, values in self.values.items()}
        for i, result in self.results.items():
            last[i]["result"] = _told(parts_of(result) if is_dataclass(result) else result)
        ends = {"disagreement": {name: self.disagreement(name) for name in names}, "agents": last}
        counted: dict[str, Any] = plain({name: getattr(self, name) for name in figures} | ends)
        return counted

    def save(self, path: str | Path) -> None:
        """Write the histories, as the suffix says: .csv (a row an agent and round), .json, .npz (x_3, time_3, ...).

        What an agent does not have, as where others have more entries, is an empty cell of a .csv. The results are in
        the last row of each agent, or result_3, with a part each, result.x_3; what are no numbers as JSON. Raises
        ConfigError for another suffix, and for a .npz of what changes its shape.
        """
        path = Path(path)
        if path.suffix not in SUFFIXES:
            raise ConfigError("history", path.name, f"a file that ends in {', '.join(SUFFIXES)}")
        path.parent.mkdir(exist_ok=True)
        if path.suffix == ".csv":
            with path.open("w", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(self._rows())
        elif path.suffix == ".json":
            path.write_text(json.dumps(plain(self.to_json() | {"values": self.values, "times": self.times})))
        else:
            series = {f"{name}_{i}": x for i, values in self.values.items() for name, x in values.items()}
            changing = next((name for name, x in series.items() if isinstance(x, list)), None)
            if changing is not None:
                raise ConfigError(f"history: {changing}", "a shape that changes", "one shape in .npz", "Save as .json.")
            times = {f"time_{i}": time for i, time in self.times.items()}
            results = {f"{name}_{i}": x for i in self.results for name, x in self._result(i).items()}
            np.savez(path, allow_pickle=False, **{**series, **times, **results})

    def _rows(self) -> list[list[Any]]:
        """Head and rows; an array has a column an entry."""
        rows = {(i, k): self._entries(i, k) for i, times in self.times.items() for k in range(len(times))}
        found = dict.fromkeys(column for entries in rows.values() for column in entries)
        ends = dict.fromkeys(name for i in self.results for name in self._result(i))
        names = [*next(iter(self.values.values())), *ends]
        columns = sorted(found, key=lambda column: (names.index(column[0]), column[1]))
        head = ["agent", "round", "time_s", *(name + _place(at) for name, at in columns)]
        cells = {row: [entries.get(column, "") for column in columns] for row, entries in rows.items()}
        return [head, *([i, k, self.times[i][k], *cells[i, k]] for i, k in rows)]

    def _entries(self, i: int, k: int) -> dict[tuple[str, tuple[int, ...]], Any]:
        """Of agent i after k steps, by name and place in the array."""
        arrays = {name: np.array(series[k]) for name, series in self.values[i].items()}
        if k == len(self.times[i]) - 1 and i in self.results:
            arrays |= self._result(i)
        return {(name, at): x[at].item() for name, x in arrays.items() for at in np.ndindex(x.shape)}

    def _result(self, i: int) -> dict[str, Any]:
        """Of agent i, an array a part."""
        parts = parts_of(self.results[i])
        return {f"result.{name}" if name else "result": _array(part) for name, part in parts.items()}


class Interrupted(KeyboardInterrupt):
    """Ctrl-C has ended a simulation; history: until then, which need not be the same round at all agents."""

    def __init__(self, history: History) -> None:
        super().__init__()
        self.history = history


def parts_of(result: Any) -> dict[str, Any]:
    """By name, as those of a dataclass; what has no parts is the one without a name."""
    return {f.name: getattr(result, f.name) for f in fields(result)} if is_dataclass(result) else {"": result}


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


def simulate(
    agents: Mapping[int, A],
    graph: Graph | GraphSequence,
    *,
    loss: float = 0.0,
    network: Mapping[str, float] | None = None,
    seed: int = 0,
    rounds: int | None = None,
    record: Sequence[str] | None = None,
    sleep: Interval = (0.0, 0.02),
    compute: Interval = (0.0, 0.0),
    watch: Callable[[Mapping[int, A]], None] = lambda agents: None,
    run: Run = run_virtual,
    channel: str = "optimize",
) -> History:
    """Run agents i of `graph` together until all are done, or have made so many `rounds`.

    Synchronous algorithms get the same messages whatever is lost; asynchronous ones (`asynchronous = True`) wake after
    a random `sleep`, take what has come, and compute for a random `compute`, both (shortest, longest) s.
    loss: share of messages that is lost;  network: more of it, as {"burst": 4, "delay": 0.01, "jitter": 0.02};
    record: attributes to keep of each agent after each step, else x, if all have one;  watch: is shown the agents after
    each step;  run: run_virtual, or run_wall for real time.
    An agent has failed, with its name and the round, where a nan is in what it sends, or in what is recorded of it
    after a step. An infinity is let pass, for some algorithms mean it (the maximum of nothing, the price of what cannot
    be done); where one is an overflow the next difference makes a nan of it.
    Raises ConfigError where agents do not fit each other or the graph; what an agent raises, or AgentFailed; on Ctrl-C
    Interrupted, a KeyboardInterrupt, with the history until then.
    """
    began = time.perf_counter()
    require_team(agents, graph)
    names = recorded(agents, record)
    followed = {i: _Followed(i, agents[i], names, rounds, lambda: watch(agents)) for i in graph.ids}
    rule = Rule({"delay": DELAY, "loss": loss, **(network or {})})
    pace = Pace(sleep, compute, seed)
    errors: dict[int, CrazyChoirError] = {}
    buses: list[Bus] = []

    async def part(communicator: Communicator, agent: _Followed) -> None:
        try:
            await run_algorithm(communicator, agent, channel=channel, pace=pace)
            if not agent.asynchronous:
                await communicator.close(channel)
        except RoundTimeout as late:
            errors[communicator.id] = late.simulated()
        except CrazyChoirError as error:  # the others hear of it, and end too
            errors[communicator.id] = error

    async def main(clock: Clock) -> float:
        bus, start = Bus(clock, Impairment(seed, [rule])), clock.now()
        for agent in followed.values():
            agent.begin(clock)
        buses.append(bus)
        communicators = {i: Communicator(bus.port(i), graph) for i in followed}
        async with asyncio.TaskGroup() as group:
            for i, agent in followed.items():
                group.create_task(part(communicators[i], agent), name=f"agent {i}")
        return clock.now() - start

    interrupted = False
    try:
        simulated_s = _unwrapped(run, main)
    except KeyboardInterrupt:
        if not buses:
            raise
        interrupted, simulated_s = True, max(agent.whole() for agent in followed.values())
    if errors:
        raise _origin(errors)
    counters = [port.counters for port in buses[0].ports.values()]
    history = History(
        values={i: agent.values() for i, agent in followed.items()},
        times={i: np.array(agent.times) for i, agent in followed.items()},
        cpu={i: np.array(agent.cpu) for i, agent in followed.items()},
        messages=sum(c.sent for c in counters),
        lost=sum(c.lost for c in counters),
        resent=sum(c.resent for c in counters),
        bytes=sum(c.bytes for c in counters),
        simulated_s=simulated_s,
        wall_s=time.perf_counter() - began,
        common=all(getattr(agent, "common", True) for agent in agents.values()),
        results={i: end for i in graph.ids if not callable(end := getattr(agents[i], "result", len))},
        violations={i: v for i in graph.ids if (v := _largest(getattr(agents[i], "violation", None))) is not None},
    )
    if interrupted:
        raise Interrupted(history)
    return history


def recorded(agents: Mapping[int, Any], record: Sequence[str] | None = None) -> tuple[str, ...]:
    """What is kept of each agent: what is asked for, else x, if all have one."""
    if record is not None:
        return tuple(record)
    return ("x",) if all(hasattr(agent, "x") for agent in agents.values()) else ()


class _Followed:
    """An agent that is followed: what it is after each step, when that was, and how long the step took."""

    def __init__(
        self, i: int, agent: Any, record: Sequence[str], rounds: int | None, watch: Callable[[], None]
    ) -> None:
        self.i, self.agent, self.watch = i, agent, watch
        self.most = MOST_ROUNDS if rounds is None else rounds
        self.asynchronous = bool(getattr(agent, "asynchronous", False))
        self.heavy = bool(getattr(agent, "heavy", False))
        self.kept: dict[str, list[Any]] = {name: [] for name in record}
        self.times: list[float] = []
        self.cpu: list[float] = []

    def begin(self, clock: Clock) -> None:
        """Keep what it is at the start."""
        self.clock, self.began = clock, clock.now()
        self._keep()

    @property
    def done(self) -> bool:
        return bool(self.agent.done) or len(self.cpu) >= self.most

    def message(self) -> Any:
        message = self.agent.message()
        self._require_numbers(message, "message()", len(self.cpu))
        return message

    def step(self, heard: dict[int, Any]) -> None:
        now = time.thread_time if self.heavy else time.perf_counter  # which asks no kernel, but counts its pauses
        began = now()
        self.agent.step(heard)
        self.cpu.append(now() - began)
        self._keep()
        for name, series in self.kept.items():
            self._require_numbers(series[-1], name, len(self.cpu) - 1)
        self.watch()

    def whole(self) -> float:
        """Forget the part of a step in which Ctrl-C came; returns when the last whole one was."""
        steps = min(len(self.cpu), len(self.times) - 1, *(len(series) - 1 for series in self.kept.values()))
        del self.cpu[steps:], self.times[steps + 1 :]
        for series in self.kept.values():
            del series[steps + 1 :]
        return self.times[-1]

    def _require_numbers(self, value: Any, name: str, k: int) -> None:
        place = nan_in(value)
        if place is not None:
            do = "Look at its data, at divisions by zero, and at its step size: too large a one overflows."
            raise AgentFailed(self.i, f"round {k}: nan in {name}{place}. {do}")

    def _keep(self) -> None:
        self.times.append(self.clock.now() - self.began)
        for name, series in self.kept.items():
            kind = type(self.agent).__name__
            try:
                series.append(np.array(getattr(self.agent, name)))
            except AttributeError:
                allowed = f"attributes of agent {self.i}, a {kind}, as {', '.join(_numbers(self.agent)) or 'x'}"
                do = "A `result` is kept without it, at the end." if name == "result" else ""
                raise ConfigError("record", name, allowed, do) from None
            except ValueError as error:
                allowed = f"numbers, or arrays of one shape, of agent {self.i}, a {kind}"
                raise ConfigError("record", name, allowed, "", str(error)) from None

    def values(self) -> dict[str, Any]:
        """Arrays where the shapes allow."""
        return {
            name: np.stack(series) if len({x.shape for x in series}) == 1 else [x.tolist() for x in series]
            for name, series in self.kept.items()
        }


def _numbers(agent: Any) -> list[str]:
    """The attributes that are numbers, or arrays of them."""
    names = {*dir(agent), *dir(getattr(agent, "algorithm", None))}  # of one that rides on another, also that one's
    found = []
    for name in sorted(name for name in names if not name.startswith("_")):
        with contextlib.suppress(Exception):  # a property of something that is not there yet
            value = getattr(agent, name)
            if isinstance(value, float | int | np.ndarray | np.generic) and np.asarray(value).dtype.kind in "fiu":
                found.append(name)
    return found


def _largest(violation: Any) -> float | None:
    """Its largest entry, if it is numbers."""
    if not isinstance(violation, float | int | np.ndarray | np.generic):
        return None
    entries = np.asarray(violation)
    return float(entries.max(initial=0.0)) if entries.dtype.kind in "fiu" else None


def _unwrapped(run: Run, main: Callable[[Clock], Any]) -> Any:
    """Run it; of the errors of several agents, which are not this package's, the first."""
    try:
        return run(main)
    except BaseExceptionGroup as errors:
        raise errors.exceptions[0] from errors


def _origin(errors: Mapping[int, CrazyChoirError]) -> CrazyChoirError:
    """The error of the agent that failed itself; of several, of the lowest id."""
    own = [errors[i] for i in sorted(errors) if not isinstance(errors[i], AgentFailed)]
    return own[0] if own else errors[min(errors)]
