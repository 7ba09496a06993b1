"""Work of a whole team that may fail at some robots, and that all end alike, to go on another way together."""

from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from crazychoir.errors import CodecError, CrazyChoirError, Hung, error_text, raised_at
from crazychoir.optimization.rounds.program import Exchange

T = TypeVar("T")


class Word(NamedTuple):
    """Where and why it has failed: in which round of the work, at which robot. The least one counts."""

    k: int
    robot: int
    why: str


def attempt(
    robot: int, work: Exchange[T], diameter: int
) -> Exchange[tuple[T | None, str]]:
    """What the work returns, and no word; if it raises anywhere, None and why, at all robots the same.

    All begin it in one round and end it in one: `diameter` rounds after that in which the work was done, or had raised
    first. What has been raised travels in place of the messages of the work; diameter: of the graph, connected.
    """
    message: list[Any] = []
    heard: Mapping[int, Any] | None = None
    word: Word | None = None
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
            except Exception as error:  # noqa: BLE001 - whatever it is, this robot flies, and so do the others
                word = Word(k, robot, _told(error))
        if word is not None:
            found = None
            message = list(word)
            ends = word.k + diameter
        if ends is not None and k >= ends:
            break
        arrived = yield message
        try:
            words = [Word(*said) for j, said in arrived.items() if _is_word(j, said, k)]
        except CodecError as error:
            words = [Word(k + 1, robot, _told(error))]
        word = min([*words, *([word] if word else [])], default=None)
        heard = None if words else {j: said[0] for j, said in arrived.items()}
    return found, f"robot {word.robot}: {word.why}" if word else ""


def _is_word(j: int, said: Any, k: int) -> bool:
    """Whether robot j says in round k that the work has failed; raises CodecError for what is no message of it."""
    match said:
        case [_]:
            return False
        case [int(failed), int(), str()] if 0 <= failed <= k:
            return True
    raise CodecError(
        f"from robot {j}, round {k}: neither a message nor a word of a failure"
    )


def _told(error: Exception) -> str:
    """The error; one that nobody has foreseen with where it was raised."""
    text = error_text(error)
    if isinstance(error, CrazyChoirError):
        return text
    place = raised_at(error)
    return f"{text} ({Path(place.filename).name}:{place.lineno})"
