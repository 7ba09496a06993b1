"""The exception tree.

CrazyChoirError
├── ConfigError(ValueError)        a swarm file, option or mission is wrong: where, found, allowed
│   └── InstanceError              a pickup-and-delivery instance is wrong or infeasible
├── CodecError(ValueError)         a value cannot be encoded, or bytes cannot be decoded
├── RoundTimeout(TimeoutError)     a round of an exchange is not complete at its deadline
├── ChannelEnded(RuntimeError)     a neighbour has ended the exchange before the awaited round
├── PeerLost(ConnectionError)      a member of the swarm is gone for longer than `lost_after`
├── RosterChanged(RuntimeError)    the team has changed, and this algorithm cannot continue
├── LinkFailed(ConnectionError)    the link to a drone cannot be opened, or refuses a request
├── Refused(RuntimeError)          a command, a swarm or a start check was refused
├── SolverError(RuntimeError)      an optimisation problem could not be solved: agent, status
├── AgentFailed(RuntimeError)      an agent of a distributed algorithm failed, and with it the team
├── ProcessFailed(RuntimeError)    a process that solves or measures has failed, or is silent
├── Hung(RuntimeError)             the watchdog interrupted code that blocked the event loop
├── Deadlock(RuntimeError)         virtual time: all tasks wait and no timer is set
└── Livelock(RuntimeError)         virtual time: the clock stands still
"""

import sysconfig
import traceback
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path


@dataclass(frozen=True, slots=True)
class ErrorTexts:
    """Texts of errors: the reason where none was given, and the advice for a round that timed out."""

    no_reason: str = "no reason was given"
    """Reason to show when an error was raised without a reason."""
    flying_advice: str = (
        "Lower the loss, or give it a longer deadline or another policy; "
        "`crazychoir status` shows which drones fly."
    )
    """Advice for a round that timed out in a team that flies."""
    simulated_advice: str = (
        "Lower the loss of the simulated network: nothing else keeps "
        "simulated agents from each other."
    )
    """Advice for a round that timed out in a team that does not fly."""


ERROR_TEXTS = ErrorTexts()


class CrazyChoirError(Exception):
    """Root of all errors of this package.

    Its text is never empty, and never ends in a colon without the reason.
    """

    def __init__(self, *args: object) -> None:
        text, *rest = args or ("",)
        super().__init__(
            reason_or(text, ERROR_TEXTS.no_reason) if isinstance(text, str) else text,
            *rest,
        )


class ConfigError(CrazyChoirError, ValueError):
    """Something that the user wrote is wrong.

    Without `problem` the text reads "where: found ...; allowed: ... do".
    With `problem` it reads "where = found: problem; allowed. do".

    where: the file and key, or the call, where the error is.
    found: the value that was found.
    allowed: the values that are allowed.
    do: what the user should do, a sentence.
    problem: what is wrong with `found`, a sentence.
    """

    def __init__(
        self, where: str, found: object, allowed: str, do: str = "", problem: str = ""
    ) -> None:
        self.where = where
        self.found = found
        self.allowed = allowed
        self.do = do
        self.problem = problem
        shown = found if isinstance(found, str) else repr(found)
        said = (
            f"{where} = {shown}: {problem}; {allowed}"
            if problem
            else f"{where}: found {shown}; allowed: {allowed}"
        )
        super().__init__(f"{said}. {do}".rstrip())


class InstanceError(ConfigError):
    """A pickup-and-delivery instance is malformed, or no plan can serve it."""


class CodecError(CrazyChoirError, ValueError):
    """A value cannot be encoded, or received bytes cannot be decoded."""


class RoundTimeout(CrazyChoirError, TimeoutError):
    """A round is incomplete at its deadline.

    drone: id of the drone that waited.
    channel: name of the channel.
    k: number of the round.
    missing: ids of the silent neighbours.
    seconds: s from the begin of the wait to the deadline.
    do: what the user should do, a sentence.
    """

    def __init__(
        self,
        drone: int,
        channel: str,
        k: int,
        missing: Iterable[int],
        seconds: float,
        do: str = ERROR_TEXTS.flying_advice,
    ) -> None:
        self.drone = drone
        self.channel = channel
        self.k = k
        self.missing = tuple(missing)
        self.seconds = seconds
        names = ", ".join(str(j) for j in self.missing)
        super().__init__(
            f"drone {drone}: channel {channel!r}, round {k}: nothing from neighbour(s) {names} within {seconds:g} s. "
            f"{do}"
        )

    def simulated(self) -> "RoundTimeout":
        """Return this error with the advice for a team that does not fly."""
        return RoundTimeout(
            self.drone,
            self.channel,
            self.k,
            self.missing,
            self.seconds,
            ERROR_TEXTS.simulated_advice,
        )


class ChannelEnded(CrazyChoirError, RuntimeError):
    """The awaited round will never come: neighbours have ended the channel before it.

    drone: id of the drone that waited.
    channel: name of the channel.
    k: number of the awaited round.
    ended: {j: number of rounds that neighbour j took part in}.
    """

    def __init__(
        self, drone: int, channel: str, k: int, ended: Mapping[int, int]
    ) -> None:
        self.drone = drone
        self.channel = channel
        self.k = k
        self.ended = dict(ended)
        endings = ", ".join(
            f"drone {j} has ended it after {n} round(s), 0 to {n - 1}"
            for j, n in self.ended.items()
        )
        super().__init__(
            f"drone {drone}: channel {channel!r}, round {k}: {endings}; all must end in the same round. "
            "Let `done` follow from what all know alike, such as the number of rounds or an agreed value."
        )


class PeerLost(CrazyChoirError, ConnectionError):
    """Members of the swarm are gone for longer than `lost_after`.

    drone: id of the drone that reports the loss.
    lost: ids of the members that are gone.
    seconds: s since the last message from any of them.
    """

    def __init__(self, drone: int, lost: Iterable[int], seconds: float) -> None:
        self.drone = drone
        self.lost = tuple(lost)
        self.seconds = seconds
        names = ", ".join(str(j) for j in self.lost)
        super().__init__(
            f"drone {drone}: lost drone(s) {names}: silent for {seconds:.3g} s. "
            "Restart their agents, or start again without them."
        )


class RosterChanged(CrazyChoirError, RuntimeError):
    """The team has changed in the middle of an algorithm that is not `joinable`.

    drone: id of the drone that reports the change.
    epoch: number of the new epoch.
    joined: ids of the members that came.
    left: ids of the members that went.
    """

    def __init__(
        self, drone: int, epoch: int, joined: Iterable[int], left: Iterable[int]
    ) -> None:
        self.drone = drone
        self.epoch = epoch
        self.joined = tuple(joined)
        self.left = tuple(left)
        super().__init__(
            f"drone {drone}: epoch {epoch}: joined {list(self.joined)}, left {list(self.left)}. "
            "Start the algorithm again from round 0 with the new team."
        )


class LinkFailed(CrazyChoirError, ConnectionError):
    """The link to a drone fails.

    uri: the link.
    reason: why it fails, in words.
    """

    def __init__(self, uri: str, reason: str) -> None:
        self.uri = uri
        self.reason = reason
        super().__init__(f"{uri}: {reason}")


class Refused(CrazyChoirError, RuntimeError):
    """A command, a swarm or a start was refused.

    by: the drone or part of the program that refused.
    reason: why, in words.
    """

    def __init__(self, by: str, reason: str) -> None:
        self.by, self.reason = by, reason_or(reason, ERROR_TEXTS.no_reason)
        super().__init__(f"{by}: refused: {self.reason}")


class SolverError(CrazyChoirError, RuntimeError):
    """An optimisation problem could not be solved.

    where: the agent and its problem.
    status: the status that the solver returned.
    """

    def __init__(self, where: str, status: str) -> None:
        self.where = where
        self.status = status
        super().__init__(f"{where}: the solver ended with status {status}")


class AgentFailed(CrazyChoirError, RuntimeError):
    """A distributed algorithm has ended at all agents because it failed at one agent.

    agent: the agent at which it failed.
    reason: why, in words.
    """

    def __init__(self, agent: int, reason: str) -> None:
        self.agent, self.reason = agent, reason_or(reason, ERROR_TEXTS.no_reason)
        super().__init__(
            f"agent {agent} has failed, and with it the team: {self.reason}"
        )


class ProcessFailed(CrazyChoirError, RuntimeError):
    """A process that was started to solve or to measure has failed.

    process: the process, in words.
    reason: why it failed, in words.
    """

    def __init__(self, process: str, reason: str) -> None:
        self.process = process
        self.reason = reason
        super().__init__(f"{process}: {reason}")


class Hung(CrazyChoirError, RuntimeError):
    """Raised by the watchdog inside code that blocked the event loop for too long."""

    def __init__(self, text: str = "did not return, and was interrupted") -> None:
        super().__init__(text)


class Deadlock(CrazyChoirError, RuntimeError):
    """Virtual time: nothing is ready and no timer is set.

    The text names the tasks and what each waits for.
    """


class Livelock(CrazyChoirError, RuntimeError):
    """Virtual time: the event loop has made very many passes without the clock moving."""


_PACKAGE_FOLDER = Path(__file__).parent
"""Folder of this package."""
_LIBRARY_FOLDERS = tuple(
    {sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")}
)
"""Folders of Python's standard library and of installed packages."""


def is_library(file: str | PathLike[str]) -> bool:
    """Return whether a file belongs to Python itself or to an installed package, or is no real file."""
    return str(file).startswith((*_LIBRARY_FOLDERS, "<"))


def is_package(file: str | PathLike[str]) -> bool:
    """Return whether a file belongs to this package, without its missions."""
    path = Path(file)
    return path.is_relative_to(_PACKAGE_FOLDER) and not path.is_relative_to(
        _PACKAGE_FOLDER / "agents"
    )


def raised_at(error: BaseException) -> traceback.FrameSummary:
    """Return the last line of an error's traceback that a user has written.

    If there is none, it is the last line of this package; without one, the last line.
    """
    places = traceback.extract_tb(error.__traceback__)
    own = [place for place in places if not is_library(place.filename)]
    users = [place for place in own if not is_package(place.filename)]
    return (users or own or places)[-1]


def exit_call(end: SystemExit) -> str:
    """Return the call with which a user's code has ended the process, such as "sys.exit(1)"."""
    return f"sys.exit({'' if end.code is None else repr(end.code)})"


def describe_exit(end: SystemExit, what: str) -> ConfigError:
    """Return the error for a user's code that has called sys.exit, exit or quit.

    It names the file and the line of the call.

    end: the exception that the call raised.
    what: the code that called it, in words, such as "the mission".
    """
    place = raised_at(end)
    allowed = "code that returns, or raises an exception"
    do = "Remove the call: the process belongs to crazychoir, and drones may fly in it."
    return ConfigError(
        f"{place.filename}:{place.lineno}",
        f"{what} called {exit_call(end)}",
        allowed,
        do,
    )


class refuse_exit:
    """Run a user's code that must not end the process; one object may be used again and again.

    what: that code, in words.
    Raises the ConfigError of `describe_exit` if the code calls sys.exit.
    """

    __slots__ = ("what",)

    def __init__(self, what: str) -> None:
        self.what = what

    def __enter__(self) -> None:
        """Begin the user's code."""

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Raise the ConfigError if the code has called sys.exit."""
        if isinstance(error, SystemExit):
            raise describe_exit(error, self.what) from error


ERROR_MEANINGS: dict[str, str] = {
    "TimeoutError": "a time limit has passed, as of asyncio.timeout or asyncio.wait_for",
    "CancelledError": "it was cancelled",
    "AssertionError": "an assert does not hold",
    "NotImplementedError": "this is not implemented",
    "MemoryError": "no memory is left",
    "RecursionError": "functions call each other too deeply",
    "KeyboardInterrupt": "it was interrupted by Ctrl-C",
    "StopIteration": "an iterator has no next value",
    "StopAsyncIteration": "an iterator has no next value",
    "EOFError": "the input has ended",
}
"""{name of an error's type: its meaning}, for errors without a text."""


def error_text(error: BaseException) -> str:
    """Return the type of an error with its text, or with the meaning of the type if it has no text."""
    kinds = [kind.__name__ for kind in type(error).__mro__]
    meanings = (ERROR_MEANINGS[name] for name in kinds if name in ERROR_MEANINGS)
    meaning = next(meanings, "raised without a text")
    return f"{type(error).__name__}: {reason_or(error, meaning)}"


def reason_or(reason: object, otherwise: str) -> str:
    """Return the reason in words, never empty.

    If the reason ends in a colon, its last part is missing, for example because a note was empty.
    Then `otherwise` is added there.

    reason: the reason, or None.
    otherwise: text to use in place of a missing reason.
    """
    try:
        words = "" if reason is None else str(reason).strip()
    except Exception:  # noqa: BLE001 - it comes from a class of a user
        words = "its text cannot be written"
    if not words:
        return otherwise
    return f"{words} {otherwise}" if words.endswith(":") else words
