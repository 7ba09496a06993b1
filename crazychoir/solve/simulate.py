"""Any distributed algorithm on simulated agents: all in this process, over the communicator and a simulated network."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

import numpy as np

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import Rule
from crazychoir.bus.port import Bus
from crazychoir.errors import AgentFailed, ConfigError, CrazyChoirError, RoundTimeout
from crazychoir.optimization.history import History
from crazychoir.optimization.rounds.checks import nan_in, require_team
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.team.algorithm_run import Interval, Pace, run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph, GraphSequence
from crazychoir.team.round import Round

A = TypeVar("A", bound=Round)
Run = Callable[[Callable[[Clock], Any]], Any]
MOST_ROUNDS: Final = 1_000_000
"""Of an algorithm that never ends by itself."""
DELAY: Final = 0.001
"""s that a message is on its way: so that time goes on with the rounds."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C has ended a simulation; history: until then, which need not be the same round at all agents."""

    def __init__(self, history: History) -> None:
        super().__init__()
        self.history = history


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
    followed = {
        i: _Followed(i, agents[i], names, rounds, lambda: watch(agents))
        for i in graph.ids
    }
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
        bus = Bus(clock, Impairment(seed, [rule]))
        start = clock.now()
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
        interrupted = True
        simulated_s = max(agent.whole() for agent in followed.values())
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
        results={
            i: end
            for i in graph.ids
            if not callable(end := getattr(agents[i], "result", len))
        },
        violations={
            i: v
            for i in graph.ids
            if (v := _largest(getattr(agents[i], "violation", None))) is not None
        },
    )
    if interrupted:
        raise Interrupted(history)
    return history


def recorded(
    agents: Mapping[int, Any], record: Sequence[str] | None = None
) -> tuple[str, ...]:
    """What is kept of each agent: what is asked for, else x, if all have one."""
    if record is not None:
        return tuple(record)
    return ("x",) if all(hasattr(agent, "x") for agent in agents.values()) else ()


class _Followed:
    """An agent that is followed: what it is after each step, when that was, and how long the step took."""

    def __init__(
        self,
        i: int,
        agent: Any,
        record: Sequence[str],
        rounds: int | None,
        watch: Callable[[], None],
    ) -> None:
        self.i = i
        self.agent = agent
        self.watch = watch
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
        now = (
            time.thread_time if self.heavy else time.perf_counter
        )  # which asks no kernel, but counts its pauses
        began = now()
        self.agent.step(heard)
        self.cpu.append(now() - began)
        self._keep()
        for name, series in self.kept.items():
            self._require_numbers(series[-1], name, len(self.cpu) - 1)
        self.watch()

    def whole(self) -> float:
        """Forget the part of a step in which Ctrl-C came; returns when the last whole one was."""
        steps = min(
            len(self.cpu),
            len(self.times) - 1,
            *(len(series) - 1 for series in self.kept.values()),
        )
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
                do = (
                    "A `result` is kept without it, at the end."
                    if name == "result"
                    else ""
                )
                raise ConfigError("record", name, allowed, do) from None
            except ValueError as error:
                allowed = (
                    f"numbers, or arrays of one shape, of agent {self.i}, a {kind}"
                )
                raise ConfigError("record", name, allowed, "", str(error)) from None

    def values(self) -> dict[str, Any]:
        """Arrays where the shapes allow."""
        return {
            name: np.stack(series)
            if len({x.shape for x in series}) == 1
            else [x.tolist() for x in series]
            for name, series in self.kept.items()
        }


def _numbers(agent: Any) -> list[str]:
    """The attributes that are numbers, or arrays of them."""
    names = {
        *dir(agent),
        *dir(getattr(agent, "algorithm", None)),
    }  # of one that rides on another, also that one's
    found = []
    for name in sorted(name for name in names if not name.startswith("_")):
        with contextlib.suppress(
            Exception
        ):  # a property of something that is not there yet
            value = getattr(agent, name)
            if (
                isinstance(value, float | int | np.ndarray | np.generic)
                and np.asarray(value).dtype.kind in "fiu"
            ):
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
