"""The rounds of one algorithm instance: sent and received messages, and each neighbour's progress.

No I/O and no clock.

A message carries its round. Therefore nothing depends on the order of arrival, and duplicates have
no effect.
"""

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

from crazychoir.bus.message import Message
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team.expected_wait import (
    NEGLIGIBLE_WAIT,
    RESEND_TIMES,
    ExpectedWait,
)
from crazychoir.team.message_kind import (
    DELAY_MASK,
    KIND_MASK,
    MOST_RELAYS,
    NO_MESSAGE,
    REPEAT_KIND,
    is_sent_again,
    read_lateness,
)


@dataclass(frozen=True, slots=True)
class RoundWindow:
    """How many rounds a channel keeps."""

    kept_rounds: int = 64
    """Own rounds that are kept for late neighbours.

    Also the most rounds of a neighbour that are buffered ahead.
    """
    forgotten_at_once: int = 16
    """Own rounds that are kept in addition where no reader holds up the sender, so that these rounds
    are forgotten together.
    """


ROUND_WINDOW = RoundWindow()
_KEPT_ROUNDS: Final = ROUND_WINDOW.kept_rounds


@dataclass(eq=False, slots=True)
class RoundCounters:
    """Counts of the rounds of one drone, on all its channels."""

    sent: int = 0
    """Rounds sent."""
    ahead: int = 0
    """Messages dropped because their round was too far ahead."""


Content = bytes | dict[int, bytes]
"""One payload for all readers, or one for each reader."""
Sent = tuple[Content, tuple[int, ...]]
"""Payload of a sent round, and its readers."""
Latest = tuple[Message, int]
"""A message, and the time of its creation on our clock, in ns."""
NOT_SENT: Final[Sent] = (b"", ())
"""Stands for a round that is not kept: no payload and no readers."""


@dataclass(eq=False, slots=True)
class NeighborProgress:
    """The messages and the progress of the neighbours on one channel."""

    latest: dict[int, Latest] = field(default_factory=dict)
    """{sender: its newest message}."""
    progress: dict[int, int] = field(default_factory=dict)
    """{neighbour: first round that it may not have finished}."""
    pacing: dict[int, None] = field(default_factory=dict)
    """Neighbours that ask for rounds that they lack (a dict, to keep their order)."""
    finished: dict[int, int] = field(default_factory=dict)
    """{neighbour that has ended the channel: first round in which it did not take part}."""
    kept: dict[int, int] = field(default_factory=dict)
    """{neighbour that was without us for a while: first round that it still has}."""
    takes_malformed: bool = False
    """True if a reader gets a Malformed for a message that cannot be decoded, and no error."""

    def forget(self, peers: Iterable[int]) -> None:
        """Forget the state of neighbours that have left or were restarted."""
        tables: list[dict[int, Any]] = [
            self.latest,
            self.progress,
            self.pacing,
            self.finished,
            self.kept,
        ]
        gone = frozenset(peers)
        for table in tables:
            for j in [j for j in table if j in gone]:
                del table[j]


@dataclass(eq=False, slots=True)
class RoundWait:
    """The present wait for a round on one channel, and its resends."""

    missing: dict[int, None] = field(default_factory=dict)
    """Neighbours that we wait for."""
    strict: bool = True
    """True if the wait fails without all of them."""
    waiter: "asyncio.Future[None] | None" = None
    """Resolved when the awaited round is complete."""
    since_ns: int = 0
    """ns: start of the present wait."""
    resend_ns: int = 0
    """ns: time of the next resend; 0 while it is not known, in a wait that was not checked yet."""
    deadline_ns: int = 0
    """ns: time at which the wait fails."""
    attempt: int = 0
    """Resends of the present round, in this wait and in earlier ones, which have failed."""
    attempts_before: int = 0
    """Resends of the present round before this wait."""
    ended_by: int = NO_MESSAGE
    """Flags of the message that has ended the wait."""
    had_repeat: bool = False
    """True if a message of a neighbour arrived only when it was sent again."""
    repeated: dict[int, int] = field(default_factory=dict)
    """{neighbour: round of its last message that arrived only when it was sent again}."""
    own_lateness: float = 0.0
    """Seconds by which lost messages have delayed our next message."""
    own_relays: int = 0
    """Drones that may pass this lateness on."""
    expected: ExpectedWait = field(default_factory=ExpectedWait)
    """What the past waits tell about the next one."""

    def plan_resend(self) -> None:
        """Find the time of the first resend, if it is not known yet.

        It is early enough that an answer may arrive before the deadline.
        """
        if not self.resend_ns:
            half_time = (self.deadline_ns - self.since_ns) / (2 * NS_PER_SECOND)
            latest = max(RESEND_TIMES.shortest, half_time)
            first = min(latest, self.expected.find_first_resend())
            self.resend_ns = self.since_ns + int(NS_PER_SECOND * first)

    def end(self, now_ns: int) -> None:
        """Learn from a wait that has ended."""
        self.waiter = None
        expected = self.expected
        if self.had_repeat or expected.lost_share:
            expected.note_repeat(self.had_repeat)
            self.had_repeat = False
        if not self.ended_by & DELAY_MASK:
            self.own_lateness = 0.0
            # Most waits are short, and where the mean is short too they say nothing new.
            if self.resend_ns or expected.mean > NEGLIGIBLE_WAIT:
                expected.learn((now_ns - self.since_ns) / NS_PER_SECOND)
            return
        seconds = (now_ns - self.since_ns) / NS_PER_SECOND
        excess = max(0.0, seconds - expected.mean)
        if not is_sent_again(self.ended_by):
            lateness, relays = read_lateness(self.ended_by)
            self.own_lateness = min(lateness, excess)
            self.own_relays = relays - 1
            expected.learn(seconds - self.own_lateness)
        elif now_ns < self.deadline_ns:
            self.own_lateness = excess
            self.own_relays = MOST_RELAYS
        else:
            self.own_lateness = 0.0  # no message was awaited any longer

    def take_repeat(self, source: int, k: int) -> None:
        """Note that a neighbour's message of round k arrived when it was sent again."""
        self.had_repeat = True
        self.repeated[source] = k

    def take_original(self, source: int, k: int) -> None:
        """Note that a message of round k arrived that we have: a repeat may have overtaken it."""
        if self.repeated.get(source) != k:
            return
        del self.repeated[source]
        if self.had_repeat:
            self.had_repeat = False
        else:
            self.expected.undo_repeat()

    def note_resend(self, now_ns: int) -> None:
        """Count a resend, and find the time of the next one."""
        self.attempt += 1
        following = self.expected.find_next_resend(self.attempt - self.attempts_before)
        self.resend_ns = now_ns + int(NS_PER_SECOND * following)


@dataclass(eq=False, slots=True)
class Channel:
    """The rounds of one drone in one algorithm instance."""

    name: str
    """Name of the channel, unique at this drone."""
    counters: RoundCounters
    """Counts of the drone's rounds."""
    joinable: bool = False
    """True if the channel continues across epochs."""
    sending: int = 0
    """Next round to send."""
    receiving: int = 0
    """Next round to receive."""
    oldest: int = 0
    """First round that a reader may still lack."""
    limit: int = 0
    """First round that may only be sent after a check of the readers' progress."""
    same_graph: range = range(0)
    """Rounds in which `ins` and `outs` are the neighbours."""
    ins: tuple[int, ...] = ()
    """In-neighbours in these rounds."""
    outs: tuple[int, ...] = ()
    """Out-neighbours in these rounds."""
    sent: dict[int, Sent] = field(default_factory=dict)
    """{round: payload and readers} of the own rounds that are kept."""
    inbox: dict[int, dict[int, Message]] = field(default_factory=dict)
    """{round: {sender: message}} of received rounds that are not read yet."""
    peers: NeighborProgress = field(default_factory=NeighborProgress)
    """Messages and progress of the neighbours."""
    wait: RoundWait = field(default_factory=RoundWait)
    """The present wait for a round."""
    closed_at: int = -1
    """Number of rounds when we closed the channel; -1 while it is open."""
    told: int = 0
    """FINs that we sent to neighbours that asked for a round after our last."""
    answers: int = 0
    """Answers to repeated rounds and questions."""
    reminders: int = 0
    """Times that our oldest kept round was sent again to readers that may lack it."""
    changed: Exception | None = None
    """Error that the next verb raises because the channel was restarted."""
    gate: "asyncio.Future[None] | None" = None
    """Resolved when there is news of the readers' progress."""

    @classmethod
    def beginning(
        cls, name: str, counters: RoundCounters, joinable: bool, first: int
    ) -> "Channel":
        """Return a new channel that begins with the round `first`."""
        return cls(
            name,
            counters,
            joinable,
            sending=first,
            receiving=first,
            oldest=first,
            limit=first,
        )

    @property
    def used(self) -> bool:
        """True while an algorithm is between its first round and the end of the channel, or waits."""
        if self.wait.waiter is not None:
            return True
        return self.closed_at < self.sending and bool(self.sending or self.receiving)

    def take(self, message: Message, born_ns: int) -> None:
        """Take a neighbour's message of a round; wake the caller if it completes the awaited round.

        born_ns: ns, time of its creation on our clock
        """
        source = message.source
        number = message.number
        flags = message.flags
        peers = self.peers
        latest = peers.latest.get(source)
        if latest is None or number >= latest[0].number:
            peers.latest[source] = (message, born_ns)
            if flags & KIND_MASK <= REPEAT_KIND:
                peers.progress[source] = number
        k = self.receiving
        wait = self.wait
        if k <= number < k + _KEPT_ROUNDS:
            box = self.inbox.get(number)
            if box is None:
                box = self.inbox[number] = {}
            if source not in box:
                box[source] = message
                if flags & KIND_MASK and is_sent_again(flags):
                    wait.take_repeat(source, number)
                missing = wait.missing
                if number == k and source in missing:
                    del missing[source]
                    if not missing:
                        wait.ended_by = flags
                        waiter = wait.waiter
                        if waiter is not None and not waiter.done():
                            waiter.set_result(None)
                return
        elif number >= k:
            self.counters.ahead += 1
            return
        if wait.repeated and not is_sent_again(flags):
            wait.take_original(source, number)

    def stored(self, k: int, j: int) -> bytes | None:
        """Return our message of round k for j, or None if it is not kept or j does not read it.

        On a joinable channel j gets any kept round: after a change of epoch j may know before us
        that it is a reader.
        """
        content, readers = self.sent.get(k, (None, ()))
        if j not in readers and not self.joinable:
            return None
        return content.get(j) if isinstance(content, dict) else content

    def reads(self, k: int, j: int) -> bool:
        """Return True if j is a reader of our round k."""
        return j in self.sent.get(k, NOT_SENT)[1]

    def behind(
        self, k: int, gone: dict[int, None], pacing_only: bool = False
    ) -> list[int]:
        """Return the readers of our round k that may lack it.

        pacing_only: True to return only readers that ask for rounds that they lack
        """
        readers = self.sent.get(k, NOT_SENT)[1]
        late = [
            j for j in readers if self.peers.progress.get(j, 0) <= k and j not in gone
        ]
        return [j for j in late if j in self.peers.pacing] if pacing_only else late

    def ended(self) -> dict[int, int]:
        """Return {j: its rounds} of the awaited neighbours that
        ended the channel before the awaited round.

        Their message will never come. A neighbour is left out if we closed the channel at the same
        round or later and continued, because it may continue too.
        """
        if not self.peers.finished:
            return {}
        found = {
            j: self.peers.finished[j]
            for j in self.wait.missing
            if j in self.peers.finished
        }
        return {j: n for j, n in found.items() if self.closed_at < n <= self.receiving}

    def trim(self, gone: dict[int, None], pacing_only: bool = False) -> list[int]:
        """Forget the rounds that all readers have.

        Returns the readers that may lack the oldest kept round.
        """
        end = self.sending
        if pacing_only:
            end -= ROUND_WINDOW.kept_rounds - 1  # the next one is kept too
        while self.oldest < end and not self.behind(self.oldest, gone, pacing_only):
            readers = self.sent.pop(self.oldest, NOT_SENT)[1]
            self.oldest += 1
            awaited = [j for j in readers if j not in gone]
            if pacing_only:
                awaited = [j for j in awaited if j in self.peers.pacing]
            progress = min(
                (self.peers.progress.get(j, 0) for j in awaited), default=end
            )
            self._forget_until(min(progress, end), readers)
        return self.behind(self.oldest, gone, pacing_only)

    def find_limit(self, gone: dict[int, None], pacing_only: bool) -> int:
        """Return the first round that may only be sent after another check of the readers' progress.

        No round goes to a reader that is a history behind, if that reader asks for rounds that it
        lacks or `pacing_only` is False.
        """
        peers = self.peers
        if not pacing_only:
            return self.oldest + ROUND_WINDOW.kept_rounds
        paced = [peers.progress.get(j, 0) for j in peers.pacing if j not in gone]
        first = min(paced, default=self.sending) + ROUND_WINDOW.kept_rounds
        together = ROUND_WINDOW.kept_rounds + ROUND_WINDOW.forgotten_at_once
        return max(self.sending + 1, min(first, self.oldest + together))

    def _forget_until(self, end: int, readers: tuple[int, ...]) -> None:
        """Forget the oldest kept rounds before round `end` that have these readers."""
        while self.oldest < end and self.sent.get(self.oldest, NOT_SENT)[1] is readers:
            del self.sent[self.oldest]
            self.oldest += 1


def wake_if(waiter: "asyncio.Future[None] | None") -> None:
    """Resolve a waiter, if there is one."""
    if waiter is not None and not waiter.done():
        waiter.set_result(None)


def is_waiting(wait: RoundWait) -> bool:
    """Return True if a caller waits for a round."""
    return wait.waiter is not None and not wait.waiter.done()


def fail_waiter(ch: Channel, error: Exception) -> None:
    """End the wait of a channel with an error."""
    if ch.wait.waiter is not None and not ch.wait.waiter.done():
        ch.wait.waiter.set_exception(error)
