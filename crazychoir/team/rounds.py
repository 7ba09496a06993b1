"""The engine below the communicator: channels, arrivals,
answers and resends, across the epochs of a team.

Rounds need no acknowledgement. A drone that waits for round k longer than expected (see
expected_wait.py) resends its own message of round k to the neighbours that it misses. A drone that
receives such a repeated message answers with its own message of that round.

If an edge exists in one direction only, the waiting reader asks (WANT), and the reader grants
credit (CREDIT), so that a sender is never further ahead than its history. Therefore the result of a
round algorithm does not depend on message loss.
"""

import asyncio
import contextlib
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from math import inf
from typing import Final, Protocol

from crazychoir.bus.codec import decode
from crazychoir.bus.port import Port
from crazychoir.bus.presence import find_heard_ns
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import (
    AgentFailed,
    ChannelEnded,
    CodecError,
    ConfigError,
    PeerLost,
    RosterChanged,
    RoundTimeout,
)
from crazychoir.runtime.clock import NS_PER_SECOND, Alarm, wake_waiter
from crazychoir.team.barrier import Barrier
from crazychoir.team.channel import ROUND_WINDOW, Channel, RoundWait
from crazychoir.team.epochs import AnyGraph, Epochs
from crazychoir.team.expected_wait import RESEND_TIMES
from crazychoir.team.graph import Graph
from crazychoir.team.message_kind import (
    ANSWER_KIND,
    DATA_KIND,
    DELAY_MASK,
    DOUBLE_KIND,
    EPOCH_SHIFT,
    KIND_MASK,
    LAST_KIND,
    NO_MESSAGE,
    REPEAT_KIND,
    MessageKind,
    is_sent_again,
    join_contents,
    split_contents,
)
from crazychoir.team.messages import Roster
from crazychoir.types import Failure

CREDIT_EVERY: Final = 16
"""Rounds between two credits."""


@dataclass(frozen=True, slots=True)
class RoundLimits:
    """Limits of the channels of a drone, and of the messages that it takes or keeps."""

    max_channels: int = 256
    """Most channels that are open at once."""
    max_early_messages: int = 256
    """Messages that are kept for channels and epochs that this drone does not have yet.

    Newer messages replace older ones.
    """
    max_early_bytes: int = 8192
    """Largest payload of a message for a channel or an epoch that this drone does not have yet; a
    larger one is not kept, and its sender resends it.
    """
    max_double_bytes: int = 1024
    """Most bytes of two rounds that are sent again in one message."""
    first_refused_round: int = 1 << 48
    """First round number that is refused as malformed."""


ROUND_LIMITS = RoundLimits()


FIRST_UNASKED_ATTEMPT: Final = 1 << 20
"""Attempt numbers from here on mark messages that no neighbour asked for."""
FAILURE_CHANNEL: Final = "failed"
"""Channel on which an agent says that it stops on all channels."""
CHECK_GRID: Final = 5_000_000
"""ns: the waiting channels are checked at multiples of this time, and at their deadlines.

So the drones of a process resend at the same instants, and their messages share frames.
"""
LONGEST_UNCHECKED: Final = 50_000_000
"""ns: longest time between two checks of a waiting channel.

A check also finds that a neighbour is lost, has ended the channel, or has said that it stops.
"""

EARLIEST_RESEND: Final = int(NS_PER_SECOND * RESEND_TIMES.shortest)
"""ns: shortest time from the start of a wait to a resend."""


class Membership(Protocol):
    """Says which neighbours are lost, so that waiting for them is useless."""

    def is_lost(self, j: int) -> bool:
        """Return True if j is LOST."""
        ...


class _FullMembership:
    """A membership without lost drones."""

    def is_lost(self, j: int) -> bool:
        return False


class Rounds:
    """One drone's channels.

    port: port of the drone on the bus
    graph: communication graph, or a periodic sequence of graphs
    membership: says which drones are lost; None if no drone is
    deadline: default seconds to wait for a round

    Attributes:
    rounds: rounds sent since the start
    ahead: messages dropped because their round was too far ahead
    """

    def __init__(
        self,
        port: Port,
        graph: AnyGraph,
        membership: Membership | None = None,
        deadline: float = 60.0,
    ) -> None:
        self.port = port
        self.deadline = deadline
        self.id = port.address
        self.membership: Membership = membership or _FullMembership()
        self.rounds = 0
        self.ahead = 0
        self._epochs = Epochs(graph)
        self._flags = 0
        self._known = self._epochs.known
        self._clock = port.bus.clock
        self._now_ns = self._clock.now_ns
        self._heard_ns = port.heard_ns
        self._made_ns = self._now_ns()
        self._channels: dict[str, Channel] = {}
        self._waiting: list[Channel] = []
        self._early: deque[tuple[int, bytes, int, str, int, int]] = deque(
            maxlen=ROUND_LIMITS.max_early_messages
        )
        self._alarm: Alarm | None = None
        self._due_ns = 0
        port.handlers[MESSAGE_TOPICS.rounds.number] = self._arrived
        self.open(FAILURE_CHANNEL, joinable=True)  # a failed agent stops in every epoch

    @property
    def graph(self) -> AnyGraph:
        """Communication graph of the newest epoch."""
        return self._epochs.graph

    @graph.setter
    def graph(self, graph: AnyGraph) -> None:
        self._epochs.replace(graph)
        self._known = self._epochs.known
        for ch in self._channels.values():
            ch.until = 0

    @property
    def epoch(self) -> int:
        """Number of the team's present composition."""
        return self._epochs.epoch

    def silence(self, lost: Iterable[int]) -> float:
        """Return the seconds since any of these drones was heard.

        For a drone that was never heard the time counts from the creation of these rounds.
        """
        heard_ns = [find_heard_ns(self.port, j) or self._made_ns for j in lost]
        return (self._now_ns() - max(heard_ns)) / NS_PER_SECOND

    # Channels and epochs --------------------------------------------------------------

    def open(self, channel: str, joinable: bool = False) -> Channel:
        """Return a channel, which is an algorithm instance with its own rounds.

        Create it if needed.

        A `joinable` channel continues across epochs; a new member begins with the first round of
        its epoch.
        Raises ConfigError if the channel is already in use and not joinable, or if there are too
        many channels.
        """
        ch = self._channels.get(channel)
        if ch is None:
            self._make_room(channel)
            ch = self._begin(channel, joinable)
            self._replay()
        elif joinable and not ch.joinable:
            if ch.used:
                raise ConfigError(
                    f"drone {self.id}: channel {channel!r}",
                    "joinable",
                    "open it as joinable before its first round",
                )
            ch = self._begin(channel, joinable)
        return ch

    def follow(self, barrier: Barrier) -> None:
        """Take part in all epochs of this barrier's rosters."""
        self.membership = barrier.presence
        barrier.attach(self)

    def hold(self) -> int:
        """Send no further round of a joinable channel until the next epoch.

        Returns the first held round.
        """
        held = self._epochs.hold(
            [ch.sending for ch in self._channels.values() if ch.joinable]
        )
        for ch in self._channels.values():
            ch.limit = min(ch.limit, held) if ch.joinable else ch.limit
        return held

    def adopt(self, roster: Roster) -> None:
        """Put a roster in force: joinable channels change to its graph at its first round."""
        before = self._epochs.members
        if self.id not in before:
            self._epochs.since = roster.first_round
        joined = roster.list_joined(before)
        self._epochs.renew(roster.members, roster.first_round)
        absent = roster.list_absent(self._epochs.ids)
        self.leave(
            absent,
            roster.epoch,
            joined,
            graph=roster.graph,
            first_round=roster.first_round,
        )

    def leave(
        self,
        gone: tuple[int, ...],
        epoch: int,
        joined: tuple[int, ...] = (),
        graph: Graph | None = None,
        first_round: int = 0,
    ) -> None:
        """Begin a new epoch: `joinable` channels continue with the
        remaining members, others raise RosterChanged.
        """
        self._epochs.begin(epoch, gone, joined, graph, first_round)
        self._known = self._epochs.known
        self._flags = epoch << EPOCH_SHIFT
        for ch in list(self._channels.values()):
            if ch.joinable:
                self._go_on(ch, gone, joined)
            else:
                self._restart(ch, RosterChanged(self.id, epoch, joined, gone))
        self._replay()

    def _go_on(
        self, ch: Channel, gone: tuple[int, ...], joined: tuple[int, ...]
    ) -> None:
        """Continue a joinable channel in a new epoch."""
        ch.until = 0
        ch.limit = ch.oldest
        ch.peers.forget((*gone, *joined))
        for j in [j for j in ch.wait.missing if self._epochs.silent(j, ch.receiving)]:
            del ch.wait.missing[j]
        if not ch.wait.missing:
            wake_if(ch.wait.waiter)
        wake_if(ch.gate)

    def _restart(self, ch: Channel, error: RosterChanged) -> None:
        """Replace the channel by a new one.

        A verb that is waiting on the old channel gets the error now; otherwise the next verb raises
        it.
        """
        new = self._begin(ch.name, False)
        if ch.wait.waiter is not None and not ch.wait.waiter.done():
            fail_waiter(ch, error)
        elif ch.gate is not None:
            ch.changed = error
            wake_if(ch.gate)
        elif ch.used:
            new.changed = error

    def _begin(self, name: str, joinable: bool) -> Channel:
        ch = self._channels[name] = Channel.beginning(
            name, joinable, self._epochs.since if joinable else 0
        )
        return ch

    def _make_room(self, channel: str) -> None:
        """Remove a closed channel if there are too many; raise ConfigError if all are in use."""
        used = len(self._channels) - (FAILURE_CHANNEL in self._channels)
        if used >= ROUND_LIMITS.max_channels:
            closed = next(
                (
                    name
                    for name, ch in self._channels.items()
                    if ch.closed_at >= 0 and not ch.used
                ),
                None,
            )
            if closed is None:
                where = f"drone {self.id}: channel {channel!r}"
                raise ConfigError(
                    where,
                    used,
                    f"{ROUND_LIMITS.max_channels} channels at once",
                    "Close some.",
                )
            del self._channels[closed]

    def _absent(self, j: int) -> bool:
        """Return True if j has left or is lost."""
        return j in self._epochs.gone or self.membership.is_lost(j)

    # Sending --------------------------------------------------------------------------

    def _look(self, ch: Channel, k: int) -> None:
        """Compute the neighbours in round k, and the round until which they are valid."""
        graph = self._epochs.at(ch.joinable, k)
        ch.ins, ch.outs = graph.in_neighbors(self.id), graph.out_neighbors(self.id)
        ch.until = self._epochs.until(ch.joinable, k)

    def _again(self, ch: Channel, k: int, j: int, attempt: int, kind: int) -> None:
        """Resend our message of round k to j, if it is kept."""
        payload = ch.stored(k, j)
        if payload is not None:
            self._resend_content(ch, k, j, payload, attempt, kind)

    def _resend_content(
        self, ch: Channel, k: int, j: int, payload: bytes, attempt: int, kind: int
    ) -> None:
        """Resend this content, which is our message of round k, to j."""
        self.port.counters.resent += 1
        self.port.send(
            MESSAGE_TOPICS.rounds,
            (j,),
            payload,
            k,
            ch.name,
            self._flags | kind,
            attempt,
        )

    def _control(
        self, ch: Channel, kind: int, to: tuple[int, ...], k: int, attempt: int = 0
    ) -> None:
        """Send a message without content."""
        self.port.send(
            MESSAGE_TOPICS.rounds, to, b"", k, ch.name, self._flags | kind, attempt
        )

    # Arriving -------------------------------------------------------------------------

    def _arrived(
        self,
        source: int,
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        """Take a message of a neighbour: store it, answer it, and wake the waiting verb."""
        ch = self._channels.get(channel)
        kind = DATA_KIND
        if (
            ch is None
            or flags != self._flags
            or number >= ROUND_LIMITS.first_refused_round
            or source not in self._known
        ):
            kind = flags & KIND_MASK
            if kind > LAST_KIND:
                self.port.counters.malformed += 1
                return
            if not self._counts(ch, source, payload, number, channel, flags, age):
                return
            ch = self._channels[channel]
            if kind == DOUBLE_KIND:
                self._take_double(source, payload, number, channel, flags, age)
                return
            if kind > DOUBLE_KIND:
                self._controlled(ch, kind, source, number)
                return
        peers = ch.peers
        latest = peers.latest.get(source)
        if latest is None or number >= latest[0]:
            heard_ns = self._heard_ns[source]
            peers.latest[source] = (
                number,
                payload,
                heard_ns - int(age * NS_PER_SECOND) if age else heard_ns,
            )
            if kind <= REPEAT_KIND:
                peers.progress[source] = number
        if kind == REPEAT_KIND:
            self._answer(ch, number, source)
        k = ch.receiving
        inbox = ch.inbox
        if k <= number < k + ROUND_WINDOW.kept_rounds:
            box = inbox.get(number)
            if box is None:
                box = inbox[number] = {}
            if source not in box:
                box[source] = payload
                wait = ch.wait
                if kind != DATA_KIND and is_sent_again(flags):
                    wait.take_repeat(source, number)
                missing = wait.missing
                if number == k and source in missing:
                    del missing[source]
                    if not missing:
                        wait.ended_by = flags
                        wake_if(wait.waiter)
            elif ch.wait.repeated and not is_sent_again(flags):
                ch.wait.take_original(source, number)
        elif number >= k:
            self.ahead += 1
        elif ch.wait.repeated and not is_sent_again(flags):
            ch.wait.take_original(source, number)

    def _take_double(
        self,
        source: int,
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        """Take a message of two rounds as two messages."""
        try:
            own, before = split_contents(payload)
            if number == 0:
                raise CodecError("message of two rounds: there is no round before 0.")
        except CodecError:
            self.port.counters.malformed += 1
            return
        epoch = flags & ~DELAY_MASK
        answer = epoch | ANSWER_KIND
        repeat = flags ^ DOUBLE_KIND ^ REPEAT_KIND
        self._arrived(source, before, number - 1, channel, answer, age)
        self._arrived(source, own, number, channel, repeat, age)

    def _counts(
        self,
        ch: Channel | None,
        source: int,
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> bool:
        """Return True if an unusual message is to be handled now.

        It is unusual by its epoch, its sender or its channel. If the channel or the epoch may soon
        exist here, the message is kept for later. A message of an earlier epoch is dropped.
        """
        if number >= ROUND_LIMITS.first_refused_round or source not in self._known:
            self.port.counters.malformed += 1
            return False
        epoch = flags >> EPOCH_SHIFT
        if ch is not None and (ch.joinable or epoch == self._epochs.epoch):
            return True
        if epoch >= self._epochs.epoch and len(payload) <= ROUND_LIMITS.max_early_bytes:
            born_ns = self.port.heard_ns[source] - int(age * NS_PER_SECOND)
            self._early.append((source, payload, number, channel, flags, born_ns))
        return False

    def _replay(self) -> None:
        """Handle again the early messages: their channel or their epoch may exist now."""
        early = list(self._early)
        self._early.clear()
        for source, payload, number, channel, flags, born_ns in early:
            age = (self.port.heard_ns[source] - born_ns) / NS_PER_SECOND
            self._arrived(source, payload, number, channel, flags, age)

    def _answer(self, ch: Channel, number: int, source: int) -> None:
        """Answer a repeated round.

        The source lacks our message of that round, or it does not know that we have read its own.
        If the round comes after our end of the channel, answer that we have ended.
        """
        if number >= ch.sending:
            self._farewell(ch, number, source)
            return
        self._serve(ch, number, source)
        if number + 1 < ch.receiving or not ch.reads(number, source):
            self._control(ch, MessageKind.CREDIT, (source,), ch.receiving, ch.answers)

    def _serve(self, ch: Channel, number: int, source: int) -> None:
        """Send a round again.

        A round that is no longer kept was read by all members of its epoch. The source did not
        count as a member then, and can no longer get that round: answer GONE.
        """
        ch.answers += 1
        if ch.joinable and number < ch.oldest:
            self._control(ch, MessageKind.GONE, (source,), ch.oldest, ch.answers)
        else:
            self._again(ch, number, source, 2 * ch.answers + 1, MessageKind.ANSWER)

    def _skip(self, ch: Channel, number: int, source: int) -> None:
        """Stop waiting for the rounds of source before `number`.

        The source considered us lost in these rounds. Only rounds of earlier epochs are skipped.
        """
        first = ch.peers.kept[source] = max(
            min(number, self._epochs.first), ch.peers.kept.get(source, 0)
        )
        if ch.receiving < first and source in ch.wait.missing:
            del ch.wait.missing[source]
            if not ch.wait.missing:
                wake_if(ch.wait.waiter)

    def _farewell(self, ch: Channel, number: int, source: int) -> None:
        """Answer FIN to a drone that asks for a round after our end.

        Such an answer does not prolong the time for which `close` waits.
        """
        if 0 <= ch.closed_at <= number and ch.closed_at >= ch.sending:
            ch.told += 1
            self._control(
                ch,
                MessageKind.FIN,
                (source,),
                ch.closed_at,
                FIRST_UNASKED_ATTEMPT + ch.told,
            )

    def _controlled(self, ch: Channel, kind: int, source: int, number: int) -> None:
        """Take a message without content: WANT, CREDIT, FIN, FIN_TOO or GONE."""
        if kind == MessageKind.GONE:
            self._skip(ch, number, source)
            return
        if kind >= MessageKind.FIN:
            ch.peers.finished[source] = max(number, ch.peers.finished.get(source, -1))
            if kind == MessageKind.FIN_TOO and number <= ch.closed_at:
                ch.answers += 1
                self._control(ch, MessageKind.FIN, (source,), ch.closed_at, ch.answers)
        else:
            ch.peers.pacing[source] = None
        ch.peers.progress[source] = max(
            min(number, ch.sending), ch.peers.progress.get(source, 0)
        )
        if kind == MessageKind.WANT:
            self._farewell(ch, number, source)
            self._serve(ch, number, source)
        wake_if(ch.gate)

    # Waiting channels ----------------------------------------------------------------

    def _expect(
        self, ch: Channel, missing: dict[int, None], seconds: float
    ) -> "asyncio.Future[None]":
        """Return a future for the messages of these neighbours; `_expected` ends the wait.

        Raises ConfigError if another caller already waits on the channel.
        """
        wait = ch.wait
        if wait.waiter is not None:
            where = f"drone {self.id}: channel {ch.name!r}"
            raise ConfigError(
                where,
                "two tasks that wait on it",
                "one",
                "Give each algorithm a channel of its own.",
            )
        waiter = self._clock.future()
        wait.waiter = waiter
        self._waiting.append(ch)
        epochs = self._epochs
        if epochs.gaps or ch.peers.kept:
            k = ch.receiving if ch.joinable else inf
            missing = {
                j: None
                for j in missing
                if not epochs.silent(j, k) and k >= ch.peers.kept.get(j, 0)
            }
            if not missing:
                waiter.set_result(None)
        wait.missing = missing
        now_ns = self._now_ns()
        deadline_ns = now_ns + int(NS_PER_SECOND * seconds)
        wait.since_ns = now_ns
        wait.deadline_ns = deadline_ns
        wait.attempts_before = wait.attempt
        wait.resend_ns = 0
        wait.ended_by = NO_MESSAGE
        latest_ns = min(deadline_ns, now_ns + EARLIEST_RESEND)
        if self._alarm is None or self._due_ns > latest_ns:
            wait.plan_resend()
            self._check_at(find_check_ns(wait, now_ns))
        return waiter

    def _expected(self, ch: Channel) -> None:
        """Learn from the end of a wait."""
        self._waiting.remove(ch)
        ch.wait.end(self._now_ns())

    def _check_at(self, due_ns: int) -> None:
        """Check the waiting channels at this time, in ns, unless they are checked earlier."""
        if self._alarm is not None:
            if self._due_ns <= due_ns:
                return
            self._alarm.cancel()
        self._due_ns = due_ns
        self._alarm = self._clock.call_at(due_ns, self._check, drone=self.id)

    def _check(self) -> None:
        """Check the waiting channels: fail those with a lost neighbour or
        past their deadline, and resend for the others.
        """
        self._alarm = None
        now_ns = self._now_ns()
        for ch in self._waiting:
            if is_waiting(ch.wait):
                ch.wait.plan_resend()
                self._check_wait(ch, now_ns)
            if is_waiting(ch.wait):
                self._check_at(find_check_ns(ch.wait, now_ns))

    def _check_wait(self, ch: Channel, now_ns: int) -> None:
        """Check one waiting channel."""
        wait = ch.wait
        lost = (
            ()
            if ch.joinable
            else tuple(j for j in wait.missing if self.membership.is_lost(j))
        )
        if lost:
            fail_waiter(ch, PeerLost(self.id, lost, self.silence(lost)))
        elif wait.strict and (word := self._failure(wait.missing)):
            fail_waiter(ch, AgentFailed(word.agent, word.reason))
        elif now_ns >= wait.deadline_ns:
            seconds = (wait.deadline_ns - wait.since_ns) / NS_PER_SECOND
            fail_waiter(
                ch,
                RoundTimeout(self.id, ch.name, ch.receiving, wait.missing, seconds),
            )
        elif (
            wait.strict
            and now_ns >= wait.since_ns + EARLIEST_RESEND
            and (ended := ch.ended())
        ):
            fail_waiter(ch, ChannelEnded(self.id, ch.name, ch.receiving, ended))
        elif now_ns >= wait.resend_ns:
            self._resend(ch, now_ns)

    def _failure(self, missing: Iterable[int]) -> Failure | None:
        """Return the Failure that the first of these drones has sent on FAILURE_CHANNEL, or None."""
        said = self._channels[FAILURE_CHANNEL].peers.latest
        if not said:
            return None
        for j in missing:
            if j in said:
                with contextlib.suppress(CodecError):
                    word = decode(said[j][1])
                    return word if isinstance(word, Failure) else None
        return None

    def _resend(self, ch: Channel, now_ns: int) -> None:
        """Resend our message of this round and of the one before to every missing neighbour.

        A missing neighbour may have sent its message of this round and lost it, or may lack ours of
        the round before. If both are small, they go in one message.
        """
        wait = ch.wait
        wait.note_resend(now_ns)
        k = ch.receiving
        for j in list(wait.missing):
            own = ch.stored(k, j) if ch.reads(k, j) else None
            before = ch.stored(k - 1, j) if ch.reads(k - 1, j) else None
            if (
                own is not None
                and before is not None
                and len(own) + len(before) <= ROUND_LIMITS.max_double_bytes
            ):
                both = join_contents(own, before)
                self._resend_content(ch, k, j, both, 2 * wait.attempt, DOUBLE_KIND)
                continue
            if before is not None:
                attempt = FIRST_UNASKED_ATTEMPT + wait.attempt
                self._resend_content(ch, k - 1, j, before, attempt, ANSWER_KIND)
            if own is not None:
                self._resend_content(ch, k, j, own, 2 * wait.attempt, REPEAT_KIND)
            else:
                self._control(ch, MessageKind.WANT, (j,), k, wait.attempt)


def is_waiting(wait: RoundWait) -> bool:
    """Return True if a caller waits for a round."""
    return wait.waiter is not None and not wait.waiter.done()


def find_check_ns(wait: RoundWait, now_ns: int) -> int:
    """Return the time of the next check of a wait, in ns."""
    due_ns = min(wait.resend_ns, now_ns + LONGEST_UNCHECKED)
    return min(wait.deadline_ns, due_ns + -due_ns % CHECK_GRID)


def wake_if(waiter: "asyncio.Future[None] | None") -> None:
    """Resolve a waiter, if there is one."""
    if waiter is not None:
        wake_waiter(waiter)


def fail_waiter(ch: Channel, error: Exception) -> None:
    """End the wait of a channel with an error."""
    if ch.wait.waiter is not None and not ch.wait.waiter.done():
        ch.wait.waiter.set_exception(error)
