"""The waits of one drone for the rounds of its neighbours, and for readers that are behind.

Rounds need no acknowledgement. A drone that waits for round k longer than expected (see
expected_wait.py) resends its own message of round k to the neighbours that it misses. A drone that
receives such a repeated message answers with its own message of that round.

If an edge exists in one direction only, the waiting reader asks (WANT), and the reader grants
credit (CREDIT), so that a sender is never further ahead than its history. Therefore the result of a
round algorithm does not depend on message loss.
"""

import asyncio
import contextlib
from collections.abc import Iterable
from math import inf
from typing import Final

from crazychoir.bus.port import Port
from crazychoir.bus.presence import find_heard_ns
from crazychoir.errors import (
    AgentFailed,
    ChannelEnded,
    CodecError,
    ConfigError,
    PeerLost,
    RoundTimeout,
)
from crazychoir.runtime.clock import NS_PER_SECOND, Alarm, wake_waiter
from crazychoir.team.channel import (
    ROUND_WINDOW,
    Channel,
    RoundWait,
    fail_waiter,
    is_waiting,
)
from crazychoir.team.channel_table import FAILURE_CHANNEL, ChannelTable
from crazychoir.team.expected_wait import RESEND_TIMES
from crazychoir.team.message_kind import NO_MESSAGE, MessageKind
from crazychoir.team.round_sender import FIRST_UNASKED_ATTEMPT, RoundSender
from crazychoir.types import Failure

CHECK_GRID: Final = 5_000_000
"""ns: the waiting channels are checked at multiples of this time, and at their deadlines.

So the drones of a process resend at the same instants, and their messages share frames.
"""
LONGEST_UNCHECKED: Final = 50_000_000
"""ns: longest time between two checks of a waiting channel.

A check also finds that a neighbour is lost, has ended the channel, or has said that it stops.
"""
UNHURRIED_CHECK: Final = 30_000_000
"""ns: time from the start of a wait to its first check, where no message was lost for a long time.

A check wakes the process. Of many processes on a host, each would be woken by a check every few
rounds only to find that nothing is late.
"""
EARLIEST_RESEND: Final = int(NS_PER_SECOND * RESEND_TIMES.shortest)
"""ns: shortest time from the start of a wait to a resend."""


class RoundWaits:
    """The waits on all channels of one drone.

    port: port of the drone on the bus
    table: channels of the drone
    sender: sends rounds again
    """

    def __init__(self, port: Port, table: ChannelTable, sender: RoundSender) -> None:
        self._port = port
        self._table = table
        self._sender = sender
        self._id = port.address
        self._clock = port.bus.clock
        self._now_ns = self._clock.now_ns
        self._made_ns = self._now_ns()
        self._waiting: dict[Channel, None] = {}
        """Channels that wait, or have waited since the last check."""
        self._alarm: Alarm | asyncio.TimerHandle | None = None
        self._due_ns = 0

    def require_present(self, drones: Iterable[int]) -> None:
        """Raise PeerLost if any of these drones is lost."""
        lost = self._list_lost(drones)
        if lost:
            raise PeerLost(self._id, lost, self._find_silence(lost))

    def _find_silence(self, lost: Iterable[int]) -> float:
        """Return the seconds since any of these drones was heard.

        For a drone that was never heard the time counts from the creation of this object.
        """
        heard_ns = [find_heard_ns(self._port, j) or self._made_ns for j in lost]
        return (self._now_ns() - max(heard_ns)) / NS_PER_SECOND

    # Waiting for a round --------------------------------------------------------------

    def begin(
        self, ch: Channel, missing: dict[int, None], seconds: float
    ) -> "asyncio.Future[None]":
        """Return a future for the messages of these neighbours; `RoundWait.end` ends the wait.

        Raises ConfigError if another caller already waits on the channel.
        """
        wait = ch.wait
        if wait.waiter is not None:
            where = f"drone {self._id}: channel {ch.name!r}"
            raise ConfigError(
                where,
                "two tasks that wait on it",
                "one",
                "Give each algorithm a channel of its own.",
            )
        waiter = self._clock.future()
        wait.waiter = waiter
        self._waiting[ch] = None
        if self._table.epochs.gaps or ch.peers.kept:
            missing = self._leave_out_silent(ch, missing)
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
        first_ns = now_ns + (
            EARLIEST_RESEND if wait.expected.lost_share else UNHURRIED_CHECK
        )
        first_ns += -first_ns % CHECK_GRID
        if self._alarm is None or self._due_ns > first_ns or self._due_ns > deadline_ns:
            self._check_at(min(first_ns, deadline_ns))
        return waiter

    def _leave_out_silent(
        self, ch: Channel, missing: dict[int, None]
    ) -> dict[int, None]:
        """Return the missing neighbours that will send a message of the awaited round."""
        k = ch.receiving if ch.joinable else inf
        is_silent = self._table.epochs.silent
        kept = ch.peers.kept
        return {j: None for j in missing if not is_silent(j, k) and k >= kept.get(j, 0)}

    def _check_at(self, due_ns: int) -> None:
        """Check the waiting channels at this time, in ns, unless they are checked earlier."""
        if self._alarm is not None:
            if self._due_ns <= due_ns:
                return
            self._alarm.cancel()
        self._due_ns = due_ns
        self._alarm = self._clock.call_about(due_ns, self._check, self._id)

    def _check(self) -> None:
        """Check the waiting channels: fail those with a lost neighbour or
        past their deadline, and resend for the others.
        """
        self._alarm = None
        now_ns = self._now_ns()
        for ch in list(self._waiting):
            wait = ch.wait
            if wait.waiter is None:
                del self._waiting[ch]
                continue
            first_ns = min(wait.since_ns + EARLIEST_RESEND, wait.deadline_ns)
            if now_ns >= first_ns and is_waiting(wait):
                wait.plan_resend()
                self._check_wait(ch, now_ns)
            if is_waiting(wait):
                self._check_at(find_check_ns(wait, now_ns))

    def _check_wait(self, ch: Channel, now_ns: int) -> None:
        """Check one waiting channel."""
        wait = ch.wait
        lost = () if ch.joinable else self._list_lost(wait.missing)
        if lost:
            fail_waiter(ch, PeerLost(self._id, lost, self._find_silence(lost)))
        elif wait.strict and (word := self._find_failure(wait.missing)):
            fail_waiter(ch, AgentFailed(word.agent, word.reason))
        elif now_ns >= wait.deadline_ns:
            seconds = (wait.deadline_ns - wait.since_ns) / NS_PER_SECOND
            fail_waiter(
                ch,
                RoundTimeout(self._id, ch.name, ch.receiving, wait.missing, seconds),
            )
        elif (
            wait.strict
            and now_ns >= wait.since_ns + EARLIEST_RESEND
            and (ended := ch.ended())
        ):
            fail_waiter(ch, ChannelEnded(self._id, ch.name, ch.receiving, ended))
        elif now_ns >= wait.resend_ns:
            wait.note_resend(now_ns)
            self._sender.send_awaited(ch)

    def _list_lost(self, drones: Iterable[int]) -> tuple[int, ...]:
        """Return those of these drones that are lost."""
        is_lost = self._table.membership.is_lost
        return tuple(j for j in drones if is_lost(j))

    def _find_failure(self, missing: Iterable[int]) -> Failure | None:
        """Return the Failure that the first of these drones has sent on FAILURE_CHANNEL, or None."""
        said = self._table.channels[FAILURE_CHANNEL].peers.latest
        if not said:
            return None
        for j in missing:
            if j in said:
                with contextlib.suppress(CodecError):
                    word = said[j][0].open()
                    return word if isinstance(word, Failure) else None
        return None

    # Waiting for readers --------------------------------------------------------------

    async def admit(self, ch: Channel, seconds: float, patient: bool = True) -> None:
        """Wait until the next round may be sent: no reader is a
        history behind, and no new epoch is being formed.

        patient: False to wait only for readers that have asked for rounds
        Raises RoundTimeout after so many seconds, PeerLost, and RosterChanged.
        """
        epochs = self._table.epochs
        ends = self._clock.now() + seconds
        while True:
            if ch.changed is not None:
                error = ch.changed
                ch.changed = None
                raise error
            late = ch.trim(epochs.gone, not patient)
            is_held = ch.joinable and ch.sending >= epochs.held
            if not is_held and ch.sending < ch.oldest + ROUND_WINDOW.kept_rounds:
                break
            if not ch.joinable:
                self.require_present(late)
            if self._clock.now() >= ends:
                awaited = late or (ch.ins if patient else ())
                raise RoundTimeout(self._id, ch.name, ch.oldest, awaited, seconds)
            await self.pause(ch, RESEND_TIMES.longest)
            ch.reminders += 1
            attempt = 2 * FIRST_UNASKED_ATTEMPT + ch.reminders
            for j in ch.behind(ch.oldest, epochs.gone, not patient):
                self._sender.send_again(ch, ch.oldest, j, attempt, MessageKind.REPEAT)
        limit = ch.find_limit(epochs.gone, not patient)
        ch.limit = int(min(limit, epochs.held if ch.joinable else inf))

    async def pause(self, ch: Channel, seconds: float) -> None:
        """Wait for news of a channel, but not longer than `seconds`."""
        gate = ch.gate = asyncio.get_running_loop().create_future()
        due_ns = self._now_ns() + round(seconds * NS_PER_SECOND)
        alarm = self._clock.call_at(due_ns, wake_waiter, gate, drone=self._id)
        try:
            await gate
        finally:
            ch.gate = None
            alarm.cancel()


def find_check_ns(wait: RoundWait, now_ns: int) -> int:
    """Return the time of the next check of a wait, in ns."""
    if wait.resend_ns:
        due_ns = min(wait.resend_ns, now_ns + LONGEST_UNCHECKED)
    elif wait.expected.lost_share:
        due_ns = wait.since_ns + EARLIEST_RESEND
    else:
        due_ns = wait.since_ns + UNHURRIED_CHECK
    return min(wait.deadline_ns, due_ns + -due_ns % CHECK_GRID)
