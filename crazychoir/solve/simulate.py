"""Run any distributed algorithm on simulated agents in this process.

The agents exchange messages over the communicator and a simulated network.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

import numpy as np

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.port import Bus
from crazychoir.config.network import network_rules
from crazychoir.config.tables import NetworkTable
from crazychoir.errors import AgentFailed, ConfigError, CrazyChoirError, RoundTimeout
from crazychoir.optimization.history import History
from crazychoir.optimization.rounds.checks import find_nan, require_team
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.team.algorithm_run import Interval, WakingTimes, run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph, GraphSequence
from crazychoir.team.round import Round

A = TypeVar("A", bound=Round)
Run = Callable[[Callable[[Clock], Any]], Any]
MOST_ROUNDS: Final = 1_000_000
"""Largest number of rounds of an algorithm that never ends by itself."""
MESSAGE_DELAY: Final = 0.001
"""s that each message takes, so that time advances with the rounds."""


class SimulationInterrupted(KeyboardInterrupt):
    """Ctrl-C has ended a simulation.

    history: the history until then; agents may have stopped in different rounds
    """

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
    """Run the agents of a team together until all are done, or have made `rounds` rounds.

    Synchronous algorithms get the same messages, whatever is lost. Asynchronous algorithms
    (`asynchronous = True`) wake after a random `sleep`, take the messages that have arrived, and
    compute for a random time `compute`.

    agents: {id: agent}, one for each node of the graph
    graph: communication graph, or a sequence of graphs
    loss: share of messages that are lost
    network: more effects of the network, with the names of EdgeEffects, such as {"delay": 0.01}, or
        {"burst": 4}: with `loss`, mean number of messages that are lost in a row
    seed: seed of the losses and of the random times
    rounds: largest number of rounds; None for no limit but MOST_ROUNDS
    record: attributes of each agent to keep after each step; None for x, if all agents have one
    sleep: (shortest, longest) s
    compute: (shortest, longest) s
    watch: called with the agents after each step
    run: run_virtual, or run_wall for real time
    channel: name of the channel of the messages

    A NaN in a message, or in a recorded value after a step, is a failure of the agent. The error
    names the agent and the round. An infinity is accepted, because some algorithms use it (the
    maximum of nothing, the price of an impossible task). An infinity from an overflow becomes a NaN
    in the next difference.
    Raises ConfigError if the agents do not fit each other or the graph.
    Raises the error of an agent, or AgentFailed.
    Raises SimulationInterrupted, a KeyboardInterrupt with the history until then, on Ctrl-C.
    """
    began = time.perf_counter()
    require_team(agents, graph)
    names = list_recorded_names(agents, record)
    followed = {
        i: _FollowedAgent(i, agents[i], names, rounds, lambda: watch(agents))
        for i in graph.ids
    }
    rules = network_rules(NetworkTable(loss=loss, delay=MESSAGE_DELAY), network)
    pace = WakingTimes(sleep, compute, seed)
    errors: dict[int, CrazyChoirError] = {}
    buses: list[Bus] = []

    async def part(communicator: Communicator, agent: _FollowedAgent) -> None:
        try:
            await run_algorithm(communicator, agent, channel=channel, pace=pace)
            if not agent.asynchronous:
                await communicator.close(channel)
        except RoundTimeout as late:
            errors[communicator.id] = late.simulated()
        except CrazyChoirError as error:  # the other agents are informed, and end too
            errors[communicator.id] = error

    async def main(clock: Clock) -> float:
        bus = Bus(clock, Impairment(seed, rules))
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
        simulated_s = _run_unwrapped(run, main)
    except KeyboardInterrupt:
        if not buses:
            raise
        interrupted = True
        simulated_s = max(agent.whole() for agent in followed.values())
    if errors:
        raise _find_original_error(errors)
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
            if (v := _find_largest(getattr(agents[i], "violation", None))) is not None
        },
    )
    if interrupted:
        raise SimulationInterrupted(history)
    return history


def list_recorded_names(
    agents: Mapping[int, Any], record: Sequence[str] | None = None
) -> tuple[str, ...]:
    """Return the names of the attributes to record: `record`, or "x" if all agents have it."""
    if record is not None:
        return tuple(record)
    return ("x",) if all(hasattr(agent, "x") for agent in agents.values()) else ()


class _FollowedAgent:
    """An agent with a record of its values, their times, and the computing time of each step."""

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
        """Keep the values at the start."""
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
        # perf_counter needs no system call, but it counts pauses of the thread as well.
        now = time.thread_time if self.heavy else time.perf_counter
        began = now()
        self.agent.step(heard)
        self.cpu.append(now() - began)
        self._keep()
        for name, series in self.kept.items():
            self._require_numbers(series[-1], name, len(self.cpu) - 1)
        self.watch()

    def whole(self) -> float:
        """Remove a step that Ctrl-C interrupted; return the time of the last whole step."""
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
        place = find_nan(value)
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
                allowed = (
                    f"attributes of agent {self.i}, a {kind}, as "
                    f"{', '.join(_list_number_names(self.agent)) or 'x'}"
                )
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
        """Return the series as arrays, or as lists if their shape changes."""
        return {
            name: np.stack(series)
            if len({x.shape for x in series}) == 1
            else [x.tolist() for x in series]
            for name, series in self.kept.items()
        }


def _list_number_names(agent: Any) -> list[str]:
    """Return the names of the attributes that are numbers or arrays of numbers."""
    # A wrapper such as `Until` also has the attributes of its algorithm.
    names = {*dir(agent), *dir(getattr(agent, "algorithm", None))}
    found = []
    for name in sorted(name for name in names if not name.startswith("_")):
        with contextlib.suppress(Exception):  # a property without a value yet
            value = getattr(agent, name)
            if (
                isinstance(value, float | int | np.ndarray | np.generic)
                and np.asarray(value).dtype.kind in "fiu"
            ):
                found.append(name)
    return found


def _find_largest(violation: Any) -> float | None:
    """Return the largest entry of a violation, or None if it is not numbers."""
    if not isinstance(violation, float | int | np.ndarray | np.generic):
        return None
    entries = np.asarray(violation)
    return float(entries.max(initial=0.0)) if entries.dtype.kind in "fiu" else None


def _run_unwrapped(run: Run, main: Callable[[Clock], Any]) -> Any:
    """Run the simulation; raise the first error of a group of errors.

    Such a group contains errors of several agents that are not CrazyChoirErrors.
    """
    try:
        return run(main)
    except BaseExceptionGroup as errors:
        raise errors.exceptions[0] from errors


def _find_original_error(errors: Mapping[int, CrazyChoirError]) -> CrazyChoirError:
    """Return the error of the agent that failed by itself; of several, the lowest id."""
    own = [errors[i] for i in sorted(errors) if not isinstance(errors[i], AgentFailed)]
    return own[0] if own else errors[min(errors)]
