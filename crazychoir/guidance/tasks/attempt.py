"""Work of a whole team that may fail at some robots.

All robots end it in the same way, so that they can continue together.
"""

from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from crazychoir.errors import CodecError, CrazyChoirError, Hung, error_text, raised_at
from crazychoir.optimization.rounds.program import Exchange

T = TypeVar("T")
"""The result of the work."""


class FailureWord(NamedTuple):
    """A message that the work has failed. The smallest of several counts."""

    k: int
    """Round of the work in which it failed."""
    robot: int
    """Robot at which it failed."""
    why: str
    """The reason."""


def attempt_work(
    robot: int, work: Exchange[T], diameter: int
) -> Exchange[tuple[T | None, str]]:
    """Run the work, and return its result and "", or None and the reason if it fails at any robot.

    All robots return the same outcome. All begin the work in the same round and end it in the same
    round: `diameter` rounds after the round in which the work was done or first failed. The reason
    of a failure travels in place of the messages of the work.

    robot: id of this robot.
    work: the rounds of the work.
    diameter: of the graph, which is connected.
    """
    message: list[Any] = []
    heard: Mapping[int, Any] | None = None
    word: FailureWord | None = None
    found: T | None = None
    ends: int | None = None
    for k in count():
        if word is None and ends is None:
            try:
                message = [work.send(heard)]  # type: ignore[arg-type]  # None starts it
            except StopIteration as end:
                found = end.value
                message = [None]
                ends = k + diameter
            except Hung:
                raise
            except Exception as error:  # noqa: BLE001 - all robots fly: none may fail alone
                word = FailureWord(k, robot, _explain_error(error))
        if word is not None:
            found = None
            message = list(word)
            ends = word.k + diameter
        if ends is not None and k >= ends:
            break
        arrived = yield message
        try:
            words = [
                FailureWord(*said)
                for j, said in arrived.items()
                if _is_failure_word(j, said, k)
            ]
        except CodecError as error:
            words = [FailureWord(k + 1, robot, _explain_error(error))]
        word = min([*words, *([word] if word else [])], default=None)
        heard = None if words else {j: said[0] for j, said in arrived.items()}
    return found, f"robot {word.robot}: {word.why}" if word else ""


def _is_failure_word(j: int, said: Any, k: int) -> bool:
    """Return whether the message of robot j in round k says that the work has failed.

    Raises CodecError for a message that is neither a failure nor a message of the work.
    """
    match said:
        case [_]:
            return False
        case [int(failed), int(), str()] if 0 <= failed <= k:
            return True
    raise CodecError(
        f"from robot {j}, round {k}: neither a message nor a failure report"
    )


def _explain_error(error: Exception) -> str:
    """Return the text of an error; unexpected errors include file and line."""
    text = error_text(error)
    if isinstance(error, CrazyChoirError):
        return text
    place = raised_at(error)
    return f"{text} ({Path(place.filename).name}:{place.lineno})"
