"""How far the monotonic clocks of two hosts are apart, as what their processes tell each other shows.

    question = [t1],   answer = [t1, t2, t3]

It is shown and recorded. Nothing is decided by it: messages carry ages.
"""

from collections import deque
from typing import Annotated, Final, NamedTuple

import msgspec
from msgspec import Meta

from crazychoir.bus.codec import decode, encode
from crazychoir.errors import CodecError
from crazychoir.runtime.clock import SECOND

SAMPLES: Final = 128
"""The newest, one a second."""
DRIFT: Final = 30e-6
"""s a second, between two clocks of 15 ppm each."""

_Times = Annotated[
    list[Annotated[int, Meta(ge=0, lt=1 << 62)]], Meta(min_length=1, max_length=3)
]


class Estimate(NamedTuple):
    """offset: s that a clock is ahead of ours;  error: s, at most."""

    offset: float
    error: float

    def contradicts(self, other: "Estimate") -> bool:
        """Whether no offset fits both."""
        return abs(self.offset - other.offset) > self.error + other.error


class Offset:
    """How far the clock of another process is ahead of ours, by questions of ours and its answers.

        theta = ((t2 - t1) + (t3 - t4)) / 2,   error <= ((t4 - t1) - (t3 - t2)) / 2 + DRIFT age

    t1: the question leaves us;  t2, t3: it arrives there, the answer leaves;  t4: that arrives here; each in ns of the
    clock of its place;  age: s since t4. Of the last SAMPLES answers the one with the least error counts: mostly that
    of the shortest way. One that contradicts it tells of another clock, of a host that was started anew or has slept:
    what was known is forgotten.
    Source: RFC 5905, sections 8 and 10.
    """

    def __init__(self) -> None:
        self._asked_ns: int | None = None
        self._samples: deque[tuple[int, Estimate]] = deque(maxlen=SAMPLES)

    def ask(self, now_ns: int) -> bytes:
        """A question; an answer to an earlier one no longer counts."""
        self._asked_ns = now_ns
        return encode([now_ns])

    def hear(self, payload: bytes, arrived_ns: int, now_ns: int) -> bytes | None:
        """A question, to which it returns the answer, or an answer; raises CodecError for what is neither."""
        try:
            times = msgspec.convert(decode(payload), _Times)
        except msgspec.ValidationError as error:
            raise CodecError(f"clock: {error}") from error
        if len(times) == 1:
            return encode([times[0], arrived_ns, now_ns])
        if len(times) == 2:
            raise CodecError("clock: 2 times; allowed: 1 or 3")
        t1, t2, t3 = times
        self._answered(t1, t2, t3, arrived_ns)
        return None

    def _answered(self, t1: int, t2: int, t3: int, t4: int) -> None:
        away = t4 - t1
        held = t3 - t2
        if not 0 <= held <= away:
            raise CodecError(f"clock: held for {held} ns of {away}")
        if t1 != self._asked_ns:
            return  # late, or the second of two
        self._asked_ns = None
        sample = Estimate(
            ((t2 - t1) + (t3 - t4)) / 2 / SECOND, (away - held) / 2 / SECOND
        )
        known = self.estimate(t4)
        if known is not None and sample.contradicts(known):
            self._samples.clear()
        self._samples.append((t4, sample))

    def estimate(self, now_ns: int) -> Estimate | None:
        """The best that is known now."""
        aged = [
            Estimate(theta, error + DRIFT * (now_ns - t4) / SECOND)
            for t4, (theta, error) in self._samples
        ]
        return min(aged, key=lambda one: one.error, default=None)
