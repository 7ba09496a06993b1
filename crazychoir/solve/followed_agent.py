"""One agent of a simulation, with the record of its values."""

import contextlib
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from crazychoir.bus.port import Counters
from crazychoir.errors import AgentFailed, ConfigError
from crazychoir.optimization.rounds.checks import find_nan

MOST_ROUNDS: Final = 1_000_000
"""Largest number of rounds of an algorithm that never ends by itself."""


class FollowedAgent:
    """An agent with a record of its values, their times, its messages, and the computing time of each step.

    i: id
    agent: a Round
    record: names of the attributes to keep
    rounds: largest number of rounds; None for MOST_ROUNDS
    watch: called after each step, or None
    """

    def __init__(
        self,
        i: int,
        agent: Any,
        record: Sequence[str],
        rounds: int | None,
        watch: Callable[[], None] | None,
    ) -> None:
        self.i = i
        self.agent = agent
        self.watch = watch
        self.most = MOST_ROUNDS if rounds is None else rounds
        self.asynchronous = bool(getattr(agent, "asynchronous", False))
        self.heavy = bool(getattr(agent, "heavy", False))
        self.takes_malformed = bool(getattr(agent, "takes_malformed", False))
        # perf_counter needs no system call, but it counts pauses of the thread as well.
        self._seconds = time.thread_time if self.heavy else time.perf_counter
        self.kept: dict[str, list[Any]] = {name: [] for name in record}
        self.times: list[float] = []
        self.traffic: list[tuple[int, int]] = []
        self.cpu: list[float] = []

    def begin(self, now: Callable[[], float], counters: Counters) -> None:
        """Keep the values at the start.

        now: returns the time of the simulation, s
        counters: counts of the messages of this agent
        """
        self._now = now
        self._counters = counters
        self._began = now()
        self._keep()

    @property
    def done(self) -> bool:
        """True when the agent is done, or has made all of its rounds."""
        return bool(self.agent.done) or len(self.cpu) >= self.most

    def message(self) -> Any:
        """Return the agent's message; raise AgentFailed if it has a NaN."""
        message = self.agent.message()
        place = find_nan(message)
        if place is not None:
            raise self._describe_nan(place, "message()", len(self.cpu))
        return message

    def step(self, heard: dict[int, Any]) -> None:
        """Let the agent make a step, and keep its values; raise AgentFailed if one is a NaN."""
        now = self._seconds
        began = now()
        self.agent.step(heard)
        self.cpu.append(now() - began)
        self._keep()
        for name, series in self.kept.items():
            place = find_nan(series[-1])
            if place is not None:
                raise self._describe_nan(place, name, len(self.cpu) - 1)
        if self.watch is not None:
            self.watch()

    def whole(self) -> float:
        """Remove a step that Ctrl-C interrupted; return the time of the last whole step."""
        steps = min(
            len(self.cpu),
            len(self.times) - 1,
            *(len(series) - 1 for series in self.kept.values()),
        )
        del self.cpu[steps:], self.times[steps + 1 :], self.traffic[steps + 1 :]
        for series in self.kept.values():
            del series[steps + 1 :]
        return self.times[-1]

    def _describe_nan(self, place: str, name: str, k: int) -> AgentFailed:
        do = "Look at its data, at divisions by zero, and at its step size: too large a one overflows."
        return AgentFailed(self.i, f"round {k}: nan in {name}{place}. {do}")

    def _keep(self) -> None:
        self.times.append(self._now() - self._began)
        self.traffic.append((self._counters.sent, self._counters.bytes))
        for name, series in self.kept.items():
            try:
                series.append(np.array(getattr(self.agent, name)))
            except AttributeError:
                kind = type(self.agent).__name__
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
                kind = type(self.agent).__name__
                allowed = (
                    f"numbers, or arrays of one shape, of agent {self.i}, a {kind}"
                )
                raise ConfigError("record", name, allowed, "", str(error)) from None

    def values(self) -> dict[str, Any]:
        """Return the series as arrays, or as lists if their shape changes."""
        return {
            name: np.concatenate(series, axis=None).reshape(
                len(series), *series[0].shape
            )
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
