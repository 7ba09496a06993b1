"""The rounds of one algorithm instance: what was sent, what has come, who is how far. No I/O and no clock.

A message carries its round, so nothing relies on the order of arrival, and duplicates do nothing.
"""

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

HISTORY: Final = 64
"""Own rounds that are kept for late neighbours; also how far ahead a neighbour's rounds are buffered."""
MIN_RTO: Final = 0.010
MAX_RTO: Final = 0.100
"""s: resend after 1.5 smoothed round times within these, doubling with every fourth attempt up to MAX_RTO."""

Content = bytes | dict[int, bytes]
"""One payload for all readers, or one for each."""
Sent = tuple[Content, tuple[int, ...]]
Latest = tuple[int, bytes, int]
"""Round, payload, and when it was born by our clock, in ns."""
NOT_SENT: Final[Sent] = (b"", ())


@dataclass(eq=False, slots=True)
class Channel:
    """One drone's rounds in one algorithm instance.

    sending, receiving: the round that comes next;  limit: the first round that may not be sent unless it is looked
    whether the readers have come along;  oldest: the first round that a reader may still lack;  progress: of each
    neighbour, the first round that it may not have finished;  pacing: those who ask for rounds that they lack;
    ins, outs: neighbours, the same until round `until`;  missing: who is waited for;  strict: whether who waits wants
    all of them;  finished: of each neighbour that has ended the channel, the first round that it did not take part in;
    kept: of each neighbour that was without us for a while, the first round that it still has;  told: how often we told
    of our own end to who asked for a round after it.
    """

    name: str
    joinable: bool = False
    sending: int = 0
    receiving: int = 0
    oldest: int = 0
    limit: int = 0
    until: float = 0
    ins: tuple[int, ...] = ()
    outs: tuple[int, ...] = ()
    sent: dict[int, Sent] = field(default_factory=dict)
    inbox: dict[int, dict[int, bytes]] = field(default_factory=dict)
    latest: dict[int, Latest] = field(default_factory=dict)
    progress: dict[int, int] = field(default_factory=dict)
    pacing: dict[int, None] = field(default_factory=dict)
    finished: dict[int, int] = field(default_factory=dict)
    kept: dict[int, int] = field(default_factory=dict)
    closed_at: int = -1
    told: int = 0
    changed: Exception | None = None
    missing: dict[int, None] = field(default_factory=dict)
    strict: bool = True
    waiter: "asyncio.Future[None] | None" = None
    gate: "asyncio.Future[None] | None" = None
    since_ns: int = 0
    resend_ns: int = 0
    deadline_ns: int = 0
    attempt: int = 0
    answers: int = 0
    round_time: float = 0.0

    @classmethod
    def beginning(cls, name: str, joinable: bool, first: int) -> "Channel":
        """A channel whose first round is `first`."""
        return cls(
            name, joinable, sending=first, receiving=first, oldest=first, limit=first
        )

    @property
    def used(self) -> bool:
        """Whether an algorithm is in the middle of it."""
        return self.closed_at < self.sending and bool(
            self.sending or self.receiving or self.waiter
        )

    def stored(self, k: int, j: int) -> bytes | None:
        """Our message of round k for j, if j is one of its readers and it is still kept.

        Across epochs j may know better than we whether it is a reader.
        """
        content, readers = self.sent.get(k, (None, ()))
        if j not in readers and not self.joinable:
            return None
        return content.get(j) if isinstance(content, dict) else content

    def reads(self, k: int, j: int) -> bool:
        """Whether j is a reader of our round k."""
        return j in self.sent.get(k, NOT_SENT)[1]

    def behind(
        self, k: int, gone: dict[int, None], pacing_only: bool = False
    ) -> list[int]:
        """Readers of our round k that may lack it."""
        readers = self.sent.get(k, NOT_SENT)[1]
        late = [j for j in readers if self.progress.get(j, 0) <= k and j not in gone]
        return [j for j in late if j in self.pacing] if pacing_only else late

    def ended(self) -> dict[int, int]:
        """{j: its rounds} of those waited for who have ended the channel before the awaited round: it never comes.

        Not of those with whom we have ended it ourselves and gone on, as they may too.
        """
        found = {j: self.finished[j] for j in self.missing if j in self.finished}
        return {j: n for j, n in found.items() if self.closed_at < n <= self.receiving}

    def trim(self, gone: dict[int, None], pacing_only: bool = False) -> list[int]:
        """Forget the rounds that all readers have; returns who may lack the oldest that is left."""
        late: list[int] = []
        while self.oldest < self.sending and not (
            late := self.behind(self.oldest, gone, pacing_only)
        ):
            if pacing_only and self.sending - self.oldest < HISTORY:
                break
            readers = self.sent.pop(self.oldest, NOT_SENT)[1]
            self.oldest += 1
            if not pacing_only:
                self._trim_on(readers, gone)
        return late

    def _trim_on(self, readers: tuple[int, ...], gone: dict[int, None]) -> None:
        """The rounds that follow with the same readers, together."""
        done = min(
            (self.progress.get(j, 0) for j in readers if j not in gone),
            default=self.sending,
        )
        while self.oldest < done and self.sent.get(self.oldest, NOT_SENT)[1] is readers:
            del self.sent[self.oldest]
            self.oldest += 1

    def forget(self, peers: Iterable[int]) -> None:
        """These are gone, or begin anew."""
        for j in peers:
            for known in (
                self.latest,
                self.progress,
                self.pacing,
                self.finished,
                self.kept,
            ):
                known.pop(j, None)

    def rto(self, attempt: int) -> float:
        """s until the next resend."""
        return min(
            MAX_RTO, max(MIN_RTO, 1.5 * self.round_time) * 2.0 ** min(attempt // 4, 8)
        )
