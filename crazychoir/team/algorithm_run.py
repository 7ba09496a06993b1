"""Runs one agent's part of a distributed algorithm to its end.

A failure at one agent ends it at all agents.
"""

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
    refuse_exit,
)
from crazychoir.team.communicator import CLOSING_RULES, Communicator, Policy
from crazychoir.team.graph import GraphSequence
from crazychoir.team.round import Round
from crazychoir.types import Failure

Interval = tuple[float, float]
"""(shortest, longest), in seconds."""
LISTED_KINDS = 4
"""Kinds of messages that the error of a failed step lists, the rarest first."""
LISTED_SENDERS = 4
"""Senders that it lists for each kind."""


@dataclass(frozen=True)
class WakingTimes:
    """The times at which an asynchronous agent wakes and
    computes: uniform draws from two intervals.

    Raises ConfigError for an interval that is not increasing, or a longest sleep of 0.
    """

    sleep: Interval = (0.0, 0.02)
    """Seconds between two steps."""
    compute: Interval = (0.0, 0.0)
    """Seconds added to the real duration of a step, to simulate a slower computer."""
    seed: int = 0
    """Seed of the draws."""

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
    pace: WakingTimes | None = None,
) -> None:
    """Run a pure algorithm to its end: in rounds, or, if its
    `asynchronous` is True, whenever it wakes.

    A step of an algorithm with `heavy = True` runs outside the event loop.

    A failure is: `message` or `step` raises, or a neighbour is lost or has ended the channel. The
    agent then tells its neighbours, and they tell theirs. All agents end within as many rounds as
    the diameter of the graph.
    The failed agent raises its own error if it is a CrazyChoirError, else AgentFailed. All others
    raise AgentFailed, which names the agent that failed, is lost, or has ended the channel. The
    channel cannot be used afterwards.

    Each agent gets RoundTimeout by itself; the same algorithm may continue afterwards.
    """
    asynchronous = getattr(algorithm, "asynchronous", False)
    try:
        if asynchronous:
            await _wake_and_sleep(
                communicator, algorithm, channel, pace or WakingTimes()
            )
        else:
            await _run_in_rounds(
                communicator,
                algorithm,
                channel=channel,
                deadline=deadline,
                policy=policy,
            )
    except AlgorithmEnded as ended:
        failed = ended.failed
        # The reason why the neighbours cannot be told is not the error to report.
        with contextlib.suppress(CrazyChoirError):
            if asynchronous:
                async for _ in _repeat_message(
                    communicator, _word_of_kind(failed), channel, pace or WakingTimes()
                ):
                    pass
            else:
                await _send_failure(communicator, _word_of_kind(failed), channel)
        raise ended.error from ended.error.__cause__


async def _run_in_rounds(
    communicator: Communicator,
    algorithm: Round,
    *,
    channel: str,
    deadline: float | None,
    policy: Policy,
) -> None:
    """Run the rounds; all agents must run the same number.

    An algorithm with `joinable = True` continues across epochs.
    """
    i = communicator.id
    heavy = getattr(algorithm, "heavy", False)
    opened = communicator.open(channel, getattr(algorithm, "joinable", False))
    opened.peers.takes_malformed = getattr(algorithm, "takes_malformed", False)
    compute = communicator.port.bus.clock.compute
    saying = refuse_exit(f"message() of agent {i}")
    stepping = refuse_exit(f"step() of agent {i}")
    while not algorithm.done:
        try:
            with saying:
                message = algorithm.message()
        except Exception as error:
            raise AlgorithmEnded.at(i, error) from error
        try:
            heard = await communicator.neighbors_exchange(
                message, channel=channel, deadline=deadline, policy=policy
            )
        except CodecError as error:
            raise AlgorithmEnded.at(
                i, describe_encoding(i, communicator.open(channel).sending, error)
            ) from error
        except (PeerLost, ChannelEnded) as error:
            raise AlgorithmEnded.by(error) from error
        except AgentFailed as error:
            raise AlgorithmEnded(error, error) from error
        require_alive(heard)
        try:
            with stepping:
                if heavy:
                    await compute(algorithm.step, heard)
                else:
                    algorithm.step(heard)
        except Exception as error:
            raise AlgorithmEnded.at(i, error, heard) from error


async def _wake_and_sleep(
    communicator: Communicator, algorithm: Round, channel: str, pace: WakingTimes
) -> None:
    """Repeat: sleep, take the latest message of each neighbour, compute, step, send.

    Nothing is resent, and no neighbour is waited for.
    Raises PeerLost if a neighbour is lost and the algorithm `waits` for all of them.
    """
    i = communicator.id
    clock = communicator.port.bus.clock
    chance = random.Random(f"{pace.seed} {i}")  # noqa: S311 - when to wake, not secrets
    heavy = getattr(algorithm, "heavy", False)
    message = None
    while not algorithm.done:
        await clock.sleep(chance.uniform(*pace.sleep), drone=i)
        heard = await communicator.asynchronous_receive(channel=channel)
        require_alive(heard)
        if getattr(algorithm, "waits", False):
            _require_all(communicator)
        if pace.compute[1] > 0.0:
            await clock.sleep(chance.uniform(*pace.compute), drone=i)
        try:
            with refuse_exit(f"step() of agent {i}"):
                if heavy:
                    await clock.compute(algorithm.step, heard)
                else:
                    algorithm.step(heard)
        except Exception as error:
            raise AlgorithmEnded.at(i, error, heard) from error
        try:
            with refuse_exit(f"message() of agent {i}"):
                message = algorithm.message()
        except Exception as error:
            raise AlgorithmEnded.at(i, error) from error
        try:
            await communicator.send(message, channel=channel)
        except CodecError as error:
            raise AlgorithmEnded.at(
                i, describe_encoding(i, communicator.open(channel).sending, error)
            ) from error
    async for _ in _repeat_message(communicator, message, channel, pace):
        require_alive(await communicator.asynchronous_receive(channel=channel))


async def _repeat_message(
    communicator: Communicator, message: Any, channel: str, pace: WakingTimes
) -> AsyncIterator[None]:
    """Send the last message again and again, until all connected neighbours have it."""
    pause = max(sum(pace.sleep) / 2, 1e-3)
    for _ in range(CLOSING_RULES.last_messages):
        await communicator.send(message, channel=channel)
        await communicator.port.bus.clock.sleep(pause, drone=communicator.id)
        yield


async def _send_failure(
    communicator: Communicator, word: Failure, channel: str
) -> None:
    """Send the failure in place of the next message.

    If the graph changes with the round, send it once for each graph of the period, to reach all
    readers.
    """
    graph = communicator.graph
    for _ in range(len(graph.graphs) if isinstance(graph, GraphSequence) else 1):
        await communicator.send(word, channel=channel)
    await communicator.close(channel)


def require_alive(heard: Mapping[int, Any]) -> None:
    """Raise AgentFailed if a neighbour has sent a Failure in place of its message.

    The neighbour has failed itself, or reports another agent's failure.
    """
    for word in heard.values():
        if type(word) is Failure:
            failed = AgentFailed(word.agent, word.reason)
            raise AlgorithmEnded(failed, failed)


def describe_encoding(i: int, k: int, error: CodecError) -> CodecError:
    """Return the error for a message of agent i in round k that cannot be encoded."""
    return CodecError(f"agent {i}: message(), round {k}: {error}")


def _require_all(communicator: Communicator) -> None:
    """Raise PeerLost, and end the algorithm for all agents, if a neighbour is gone for good."""
    neighbors = communicator.graph.at(0).in_neighbors(communicator.id)
    try:
        communicator.exchange.waits.require_present(neighbors)
    except PeerLost as error:
        raise AlgorithmEnded.by(error) from error


def _word_of_kind(failed: AgentFailed) -> Failure:
    return Failure(failed.agent, failed.reason)


def _describe_messages(heard: Mapping[int, Any] | None) -> str:
    """Return a text with the kinds of received messages and their
    senders: they may have caused the failure.
    """
    if not heard:
        return ""
    senders: dict[str, list[int]] = {}
    for j, message in heard.items():
        senders.setdefault(_message_kind(message), []).append(j)
    rarest = sorted(
        senders.items(), key=lambda kind: (len(kind[1]), kind[0] != "None")
    )[:LISTED_KINDS]
    return "; it had heard " + ", ".join(
        f"{kind} from {_list_senders(ids)}" for kind, ids in rarest
    )


def _list_senders(ids: list[int]) -> str:
    return ", ".join(map(str, ids[:LISTED_SENDERS])) + (
        f" and {len(ids) - LISTED_SENDERS} more" if len(ids) > LISTED_SENDERS else ""
    )


def _message_kind(message: Any) -> str:
    """Return the type of a message, with its shape or length."""
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


class AlgorithmEnded(Exception):
    """The algorithm has ended at this agent by a failure that the neighbours must receive.

    failed: the error that the neighbours get
    error: the error that this agent raises
    """

    def __init__(self, failed: AgentFailed, error: CrazyChoirError) -> None:
        self.failed = failed
        self.error = error

    @classmethod
    def at(
        cls, i: int, error: Exception, heard: Mapping[int, Any] | None = None
    ) -> "AlgorithmEnded":
        """Return the end by an error of this agent.

        error: raised by the algorithm, or AgentFailed received from a neighbour
        heard: the messages that the failed step had received
        """
        if isinstance(error, AgentFailed):
            return cls(error, error)
        reason = error_text(error)
        if isinstance(error, CrazyChoirError):
            return cls(AgentFailed(i, reason), error)
        place = raised_at(error)
        failed = AgentFailed(
            i,
            f"{reason} ({Path(place.filename).name}:{place.lineno}){_describe_messages(heard)}",
        )
        failed.__cause__ = error
        return cls(failed, failed)

    @classmethod
    def by(cls, error: PeerLost | ChannelEnded) -> "AlgorithmEnded":
        """Return the end by a neighbour that will not answer: it counts as the failed agent."""
        failed = (
            error.lost[0] if isinstance(error, PeerLost) else next(iter(error.ended))
        )
        return cls(AgentFailed(failed, error_text(error)), error)
