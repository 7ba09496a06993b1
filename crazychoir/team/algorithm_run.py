"""Running one agent's part of a distributed algorithm to its end, over a communicator; a failure ends it at all."""

import contextlib
import random
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crazychoir.errors import (
    AgentFailed,
    ChannelEnded,
    CodecError,
    ConfigError,
    CrazyChoirError,
    PeerLost,
    error_text,
    raised_at,
    without_exit,
)
from crazychoir.team.communicator import LAST_WORDS, Communicator, Policy
from crazychoir.team.graph import GraphSequence
from crazychoir.team.round import Round
from crazychoir.types import Failure

Interval = tuple[float, float]
KINDS, SENDERS = 4, 4
"""Of messages that are told of when a step has failed, the rarest first, and of their senders."""


@dataclass(frozen=True)
class Pace:
    """When an asynchronous agent wakes, and how long it computes: uniform draws from these intervals.

    sleep: s between two steps;  compute: s that a step is pretended to take, beside what it takes;  seed: of the draws.
    """

    sleep: Interval = (0.0, 0.02)
    compute: Interval = (0.0, 0.0)
    seed: int = 0

    def __post_init__(self) -> None:
        for name, interval in (("sleep", self.sleep), ("compute", self.compute)):
            if not 0.0 <= interval[0] <= interval[1] < float("inf"):
                raise ConfigError(
                    f"pace: {name}",
                    interval,
                    "(shortest, longest) s, 0 or more, increasing",
                )
        if self.sleep[1] == 0.0:
            raise ConfigError("pace: sleep", self.sleep, "a longest sleep above 0 s")


async def run_algorithm(
    communicator: Communicator,
    algorithm: Round,
    *,
    channel: str = "main",
    deadline: float | None = None,
    policy: Policy = "raise",
    pace: Pace | None = None,
) -> None:
    """Run a pure algorithm to its end: in rounds, or, with `asynchronous = True` in it, whenever it wakes.

    `heavy = True` in an algorithm steps away from the event loop.  Where `message` or `step` raises at one agent, or a
    neighbour is lost to it or has ended the channel, it tells its neighbours, they theirs, and all end within as many
    rounds as the graph's diameter: that one with its error, the others, and it too where the error is none of ours,
    with AgentFailed, which names who failed, is lost, or has ended. The channel is then of no more use.
    After a RoundTimeout, which each gets by itself, the same algorithm may go on.
    """
    asynchronous = getattr(algorithm, "asynchronous", False)
    try:
        if asynchronous:
            await _wake_and_sleep(communicator, algorithm, channel, pace or Pace())
        else:
            await _in_rounds(
                communicator,
                algorithm,
                channel=channel,
                deadline=deadline,
                policy=policy,
            )
    except _Ended as ended:
        failed = ended.failed
        with contextlib.suppress(
            CrazyChoirError
        ):  # why it cannot be told is not what went wrong
            if asynchronous:
                async for _ in _repeat(
                    communicator, _word(failed), channel, pace or Pace()
                ):
                    pass
            else:
                await _tell(communicator, _word(failed), channel)
        raise ended.error from ended.error.__cause__


async def _in_rounds(
    communicator: Communicator,
    algorithm: Round,
    *,
    channel: str,
    deadline: float | None,
    policy: Policy,
) -> None:
    """The rounds; their number must be the same at all agents. `joinable = True` goes on across epochs."""
    i = communicator.id
    heavy = getattr(algorithm, "heavy", False)
    communicator.open(channel, getattr(algorithm, "joinable", False))
    compute = communicator.port.bus.clock.compute
    while not algorithm.done:
        try:
            with without_exit(f"message() of agent {i}"):
                message = algorithm.message()
        except Exception as error:
            raise _Ended.at(i, error) from error
        try:
            heard = await communicator.neighbors_exchange(
                message, channel=channel, deadline=deadline, policy=policy
            )
        except CodecError as error:
            raise _Ended.at(i, _unsent(communicator, channel, error)) from error
        except (PeerLost, ChannelEnded) as error:
            raise _Ended.by(error) from error
        except AgentFailed as error:
            raise _Ended(error, error) from error
        _require_alive(heard)
        try:
            with without_exit(f"step() of agent {i}"):
                if heavy:
                    await compute(algorithm.step, heard)
                else:
                    algorithm.step(heard)
        except Exception as error:
            raise _Ended.at(i, error, heard) from error


async def _wake_and_sleep(
    communicator: Communicator, algorithm: Round, channel: str, pace: Pace
) -> None:
    """Sleep, take the latest of each neighbour, compute, step, send; nothing is resent, nobody waited for.

    An algorithm that itself `waits` for all its neighbours ends with PeerLost where one is lost.
    """
    i = communicator.id
    clock = communicator.port.bus.clock
    chance = random.Random(f"{pace.seed} {i}")  # noqa: S311 - when to wake, not secrets
    heavy = getattr(algorithm, "heavy", False)
    message = None
    while not algorithm.done:
        await clock.sleep(chance.uniform(*pace.sleep), drone=i)
        heard = await communicator.asynchronous_receive(channel=channel)
        _require_alive(heard)
        if getattr(algorithm, "waits", False):
            _require_all(communicator)
        if pace.compute[1] > 0.0:
            await clock.sleep(chance.uniform(*pace.compute), drone=i)
        try:
            with without_exit(f"step() of agent {i}"):
                if heavy:
                    await clock.compute(algorithm.step, heard)
                else:
                    algorithm.step(heard)
        except Exception as error:
            raise _Ended.at(i, error, heard) from error
        try:
            with without_exit(f"message() of agent {i}"):
                message = algorithm.message()
        except Exception as error:
            raise _Ended.at(i, error) from error
        try:
            await communicator.send(message, channel=channel)
        except CodecError as error:
            raise _Ended.at(i, _unsent(communicator, channel, error)) from error
    async for _ in _repeat(communicator, message, channel, pace):
        _require_alive(await communicator.asynchronous_receive(channel=channel))


async def _repeat(
    communicator: Communicator, message: Any, channel: str, pace: Pace
) -> AsyncIterator[None]:
    """The last message, until all have it who are not cut off."""
    pause = max(sum(pace.sleep) / 2, 1e-3)
    for _ in range(LAST_WORDS):
        await communicator.send(message, channel=channel)
        await communicator.port.bus.clock.sleep(pause, drone=communicator.id)
        yield


async def _tell(communicator: Communicator, word: Failure, channel: str) -> None:
    """In place of the next message, and of those after it where another round has other readers."""
    graph = communicator.graph
    for _ in range(len(graph.graphs) if isinstance(graph, GraphSequence) else 1):
        await communicator.send(word, channel=channel)
    await communicator.close(channel)


def _require_alive(heard: Mapping[int, Any]) -> None:
    """Raise what a neighbour says in place of its message, if one has failed or has heard of who did."""
    for word in heard.values():
        if type(word) is Failure:
            failed = AgentFailed(word.agent, word.reason)
            raise _Ended(failed, failed)


def _unsent(communicator: Communicator, channel: str, error: CodecError) -> CodecError:
    """What cannot be sent, with whose it is and in which round."""
    return CodecError(
        f"agent {communicator.id}: message(), round {communicator.open(channel).sending}: {error}"
    )


def _require_all(communicator: Communicator) -> None:
    """Raise PeerLost, for all, if a neighbour is gone for good."""
    lost = [
        j
        for j in communicator.graph.at(0).in_neighbors(communicator.id)
        if communicator.membership.lost(j)
    ]
    if lost:
        error = PeerLost(communicator.id, lost, communicator.silence(lost))
        raise _Ended.by(error) from error


def _word(failed: AgentFailed) -> Failure:
    return Failure(failed.agent, failed.reason)


def _heard(heard: Mapping[int, Any] | None) -> str:
    """Of what kind it was, by sender: an agent may fail by what another has sent."""
    if not heard:
        return ""
    senders: dict[str, list[int]] = {}
    for j, message in heard.items():
        senders.setdefault(_kind(message), []).append(j)
    rarest = sorted(
        senders.items(), key=lambda kind: (len(kind[1]), kind[0] != "None")
    )[:KINDS]
    return "; it had heard " + ", ".join(
        f"{kind} from {_some(ids)}" for kind, ids in rarest
    )


def _some(ids: list[int]) -> str:
    return ", ".join(map(str, ids[:SENDERS])) + (
        f" and {len(ids) - SENDERS} more" if len(ids) > SENDERS else ""
    )


def _kind(message: Any) -> str:
    """The type, with shape or length."""
    if message is None:
        return "None"
    if hasattr(message, "dtype"):
        return f"{message.dtype} {message.shape}"
    name = type(message).__name__
    return (
        f"{name} of {len(message)}"
        if isinstance(message, list | tuple | dict)
        else name
    )


class _Ended(Exception):
    """An algorithm has ended here by a failure, which the neighbours are to hear of: what they get, what we raise."""

    def __init__(self, failed: AgentFailed, error: Exception) -> None:
        self.failed = failed
        self.error = error

    @classmethod
    def at(
        cls, i: int, error: Exception, heard: Mapping[int, Any] | None = None
    ) -> "_Ended":
        """Our own algorithm has raised this, or is told by this that it has failed, in a step that had heard this."""
        if isinstance(error, AgentFailed):
            return cls(error, error)
        reason = error_text(error)
        if isinstance(error, CrazyChoirError):
            return cls(AgentFailed(i, reason), error)
        place = raised_at(error)
        failed = AgentFailed(
            i, f"{reason} ({Path(place.filename).name}:{place.lineno}){_heard(heard)}"
        )
        failed.__cause__ = error
        return cls(failed, failed)

    @classmethod
    def by(cls, error: PeerLost | ChannelEnded) -> "_Ended":
        """A neighbour will not come: it is the one who has failed."""
        who = error.lost[0] if isinstance(error, PeerLost) else next(iter(error.ended))
        return cls(AgentFailed(who, error_text(error)), error)
