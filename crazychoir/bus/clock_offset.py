"""Estimates the offset between the monotonic clocks of two hosts from messages of their processes.

    question = [t1],   answer = [t1, t2, t3]

The offset is shown and recorded. No decision depends on it: messages carry ages.
"""

from collections import deque
from typing import Annotated, Final, NamedTuple

import msgspec
from msgspec import Meta

from crazychoir.bus.codec import decode, encode
from crazychoir.errors import CodecError
from crazychoir.runtime.clock import NS_PER_SECOND

OFFSET_SAMPLES: Final = 128
"""Newest answers that are kept, one a second."""
CLOCK_DRIFT: Final = 30e-6
"""Seconds a second that two clocks of 15 ppm each can drift apart."""

_Times = Annotated[
    list[Annotated[int, Meta(ge=0, lt=1 << 62)]], Meta(min_length=1, max_length=3)
]
"""ns."""


class OffsetEstimate(NamedTuple):
    """An estimate of the offset of another clock."""

    offset: float
    """Seconds that the other clock is ahead of ours."""
    error: float
    """Largest error, in seconds."""

    def contradicts(self, other: "OffsetEstimate") -> bool:
        """Return True if no offset fits both estimates."""
        return abs(self.offset - other.offset) > self.error + other.error


class ClockOffset:
    """The offset of the clock of another process to ours, from our questions and its answers.

        theta = ((t2 - t1) + (t3 - t4)) / 2,   error <= ((t4 - t1) - (t3 - t2)) / 2 + CLOCK_DRIFT age

    t1: ns, our clock: the question leaves
    t2: ns, other clock: the question arrives
    t3: ns, other clock: the answer leaves
    t4: ns, our clock: the answer arrives
    age: seconds since t4

    The answer with the smallest error counts, among the last OFFSET_SAMPLES. It mostly has the shortest
    way. An answer that contradicts it comes from another clock, because the host was restarted or
    has slept: all older answers are forgotten.
    Source: RFC 5905, sections 8 and 10.
    """

    def __init__(self) -> None:
        self._asked_ns: int | None = None
        self._samples: deque[tuple[int, OffsetEstimate]] = deque(maxlen=OFFSET_SAMPLES)

    def ask(self, now_ns: int) -> bytes:
        """Return a question; an answer to an earlier question no longer counts."""
        self._asked_ns = now_ns
        return encode([now_ns])

    def hear(self, payload: bytes, arrived_ns: int, now_ns: int) -> bytes | None:
        """Handle a received message and return the answer if it is a question, else None.

        Raises CodecError for a message that is neither a question nor an answer.
        """
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
        """Take the four times of an answer; raise CodecError if they are contradictory."""
        away = t4 - t1
        held = t3 - t2
        if not 0 <= held <= away:
            raise CodecError(f"clock: held for {held} ns of {away}")
        if t1 != self._asked_ns:
            return  # the answer is late, or a duplicate
        self._asked_ns = None
        sample = OffsetEstimate(
            ((t2 - t1) + (t3 - t4)) / 2 / NS_PER_SECOND,
            (away - held) / 2 / NS_PER_SECOND,
        )
        known = self.estimate(t4)
        if known is not None and sample.contradicts(known):
            self._samples.clear()
        self._samples.append((t4, sample))

    def estimate(self, now_ns: int) -> OffsetEstimate | None:
        """Return the best estimate now, or None."""
        aged = [
            OffsetEstimate(theta, error + CLOCK_DRIFT * (now_ns - t4) / NS_PER_SECOND)
            for t4, (theta, error) in self._samples
        ]
        return min(aged, key=lambda one: one.error, default=None)
