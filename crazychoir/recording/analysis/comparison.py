"""Where two recordings of what should be one flight first differ."""

from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from crazychoir.recording.mcap.sequence import Told, told
from crazychoir.runtime.clock import SECOND

NOTHING = "no message"
MESSAGE = "the message"
TIME = "the time of the message"


@dataclass(frozen=True)
class Difference:
    """The first message that is not the same, t s after the recordings' zero.

    topic: as `/drone3/state`;  field: of the message, or what else is another;  first, second: the values.
    """

    t: float
    topic: str
    field: str
    first: Any
    second: Any

    def __str__(self) -> str:
        return f"at {self.t:.3f} s in {self.topic}: {self.field}: {self.first} first, {self.second} then"


def first_difference(one: Path, other: Path) -> Difference | None:
    """The first difference of two recordings, None if there is none.

    If the first one was cut off, or is spoilt, what the second one has beyond that is no difference.
    Raises ConfigError for files that are no recordings.
    """
    firsts = told(one)
    for first, second in zip_longest(firsts, told(other)):
        if first is None and firsts.fault:
            return None
        if first is None:
            return _alone(second, NOTHING, MESSAGE)
        if second is None:
            return _alone(first, MESSAGE, NOTHING)
        if not _same(first, second):
            return _difference(first, second)
    return None


def _same(a: Told, b: Told) -> bool:
    return (a.came_ns, a.born_ns, a.data) == (
        b.came_ns,
        b.born_ns,
        b.data,
    ) and a.source == b.source


def _alone(there: Told, first: str, second: str) -> Difference:
    """One of the recordings ends before the other."""
    return Difference(there.came_ns / SECOND, there.source.name, "end", first, second)


def _difference(a: Told, b: Told) -> Difference:
    """What is another in two messages that stand at the same place."""
    t = min(a.came_ns, b.came_ns) / SECOND
    if a.source != b.source:
        return Difference(
            t, a.source.name, "order of messages", a.source.name, b.source.name
        )
    if a.data == b.data:
        return Difference(
            t, a.source.name, TIME, *(f"{x.came_ns / SECOND:.9f} s" for x in (a, b))
        )
    first = a.values()
    second = b.values()
    for path, value in first.items():
        if str(value) != str(second[path]):  # as texts: NaN is NaN
            return Difference(t, a.source.name, path, value, second[path])
    return Difference(t, a.source.name, "bytes", a.data.hex(), b.data.hex())
