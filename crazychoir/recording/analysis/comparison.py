"""Find the first difference between two recordings of what should be the same flight."""

from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from crazychoir.recording.mcap.sequence import RecordedMessage, read_messages
from crazychoir.runtime.clock import NS_PER_SECOND


@dataclass(frozen=True, slots=True)
class DifferenceTexts:
    """Texts that describe a difference between two recordings."""

    no_message: str = "no message"
    """A recording has ended."""
    next_message: str = "the message"
    """The other recording goes on."""
    message_time: str = "the time of the message"
    """The messages are equal, but came at different times."""


DIFFERENCE_TEXTS = DifferenceTexts()


@dataclass(frozen=True)
class Difference:
    """The first message that differs between two recordings."""

    t: float
    """Seconds after the recordings' zero."""
    topic: str
    """Topic of the message, such as `/drone3/state`."""
    field: str
    """The field of the message that differs, or another property, such as the time."""
    first: Any
    """Value in the first recording."""
    second: Any
    """Value in the second recording."""

    def __str__(self) -> str:
        return f"at {self.t:.3f} s in {self.topic}: {self.field}: {self.first} first, {self.second} then"


def first_difference(one: Path, other: Path) -> Difference | None:
    """Return the first difference of two recordings; None if there is none.

    If the first recording is truncated or damaged, further messages of the second are no
    difference. Raises ConfigError if a file is no recording.
    """
    firsts = read_messages(one)
    for first, second in zip_longest(firsts, read_messages(other)):
        if first is None and firsts.fault:
            return None
        if first is None:
            return _end_difference(
                second, DIFFERENCE_TEXTS.no_message, DIFFERENCE_TEXTS.next_message
            )
        if second is None:
            return _end_difference(
                first, DIFFERENCE_TEXTS.next_message, DIFFERENCE_TEXTS.no_message
            )
        if not _is_same(first, second):
            return _message_difference(first, second)
    return None


def _is_same(a: RecordedMessage, b: RecordedMessage) -> bool:
    return (a.came_ns, a.born_ns, a.data) == (
        b.came_ns,
        b.born_ns,
        b.data,
    ) and a.source == b.source


def _end_difference(there: RecordedMessage, first: str, second: str) -> Difference:
    """Return the difference that one of the recordings ends before the other."""
    return Difference(
        there.came_ns / NS_PER_SECOND, there.source.name, "end", first, second
    )


def _message_difference(a: RecordedMessage, b: RecordedMessage) -> Difference:
    """Return the difference of two messages at the same place."""
    t = min(a.came_ns, b.came_ns) / NS_PER_SECOND
    if a.source != b.source:
        return Difference(
            t, a.source.name, "order of messages", a.source.name, b.source.name
        )
    if a.data == b.data:
        return Difference(
            t,
            a.source.name,
            DIFFERENCE_TEXTS.message_time,
            *(f"{x.came_ns / NS_PER_SECOND:.9f} s" for x in (a, b)),
        )
    first = a.values()
    second = b.values()
    for path, value in first.items():
        if str(value) != str(second[path]):  # as texts, in which NaN equals NaN
            return Difference(t, a.source.name, path, value, second[path])
    return Difference(t, a.source.name, "bytes", a.data.hex(), b.data.hex())
