"""The verbs of the ChoiRbot papers as coroutines over lossy links: send, receive,
asynchronous_receive, neighbors_exchange.
"""

import asyncio
from dataclasses import dataclass
from math import inf
from typing import Any, Literal

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import CodecError, PeerLost, RoundTimeout
from crazychoir.runtime.clock import NS_PER_SECOND, wake_waiter
from crazychoir.team.channel import ROUND_WINDOW, Channel
from crazychoir.team.expected_wait import RESEND_TIMES
from crazychoir.team.message_kind import (
    AHEAD_KIND,
    DATA_KIND,
    MessageKind,
    flag_lateness,
)
from crazychoir.team.rounds import (
    CREDIT_EVERY,
    FAILURE_CHANNEL,
    FIRST_UNASKED_ATTEMPT,
    Rounds,
)
from crazychoir.types import Failure, PerNeighbor


@dataclass(frozen=True, slots=True)
class ClosingRules:
    """How a channel ends: how long a drone stays for its neighbours, and how often it sends its
    last messages.
    """

    linger_time: float = 2.0
    """Seconds without a question from unfinished neighbours after which `close` returns."""
    last_messages: int = 32
    """Times that an important message is sent to neighbours that do not ask for it.

    At 50 % loss all copies are lost once in 4e9 cases.
    """
    end_messages: int = 3
    """Times that the end of a channel is sent to neighbours that need not answer."""


CLOSING_RULES = ClosingRules()


Policy = Literal["raise", "partial", "hold"]
"""Action of an exchange at its deadline."""


class Communicator(Rounds):
    """One drone's part in the team's exchanges, on a graph that
    may be directed and may change with the round.

    rounds: rounds sent since the start
    ahead: messages dropped because their round was too far ahead
    """

    # The verbs ------------------------------------------------------------------------

    async def neighbors_exchange(
        self,
        data: Any,
        in_neighbors: tuple[int, ...] | None = None,
        out_neighbors: tuple[int, ...] | None = None,
        *,
        channel: str = "main",
        deadline: float | None = None,
        policy: Policy = "raise",
    ) -> dict[int, Any]:
        """Send `data` to the out-neighbours and wait for the same round of every in-neighbour.

        data: one value for all, or a `PerNeighbor` with one for each neighbour
        in_neighbors: senders to wait for; None: those of the graph
        out_neighbors: receivers; None: those of the graph
        deadline: seconds to wait
        policy: at the deadline "raise" RoundTimeout, return the "partial" set, or "hold" the last
            value of the silent neighbours
        Returns {j: value} in increasing j.

        After a RoundTimeout the next exchange continues with the same round: its message is already
        sent.
        Raises RoundTimeout, PeerLost, RosterChanged and CodecError.
        Raises AgentFailed if a neighbour has said that it stops; the exchange then does not wait
        for the deadline.
        Raises ChannelEnded if a neighbour closed the channel before this round, unless we closed it
        there too: such a round would never come.
        """
        ch = self._channels.get(channel) or self.open(channel)
        k = ch.sending
        if k == ch.receiving:
            if k >= ch.limit or ch.changed is not None:
                await self._admit(
                    ch,
                    self.deadline if deadline is None else deadline,
                    policy == "raise",
                )
                k = ch.sending
            if k >= ch.until:
                self._look(ch, k)
            self._send_round(
                ch, data, ch.outs if out_neighbors is None else out_neighbors, DATA_KIND
            )
        elif ch.receiving >= ch.until:
            self._look(ch, ch.receiving)
        return await self._collect(
            ch, ch.ins if in_neighbors is None else in_neighbors, deadline, policy
        )

    async def send(
        self,
        data: Any,
        neighbors: tuple[int, ...] | None = None,
        *,
        channel: str = "main",
        deadline: float | None = None,
    ) -> None:
        """Send the next message of a channel, for `receive` (one
        each a round) or `asynchronous_receive`.

        Waits only for neighbours that use `receive` and are a whole history behind.
        Raises RoundTimeout, PeerLost or RosterChanged.
        """
        ch = self._channels.get(channel) or self.open(channel)
        if ch.sending >= ch.limit or ch.changed is not None:
            await self._admit(
                ch, self.deadline if deadline is None else deadline, patient=False
            )
        k = ch.sending
        readers = (
            self._epochs.at(ch.joinable, k).out_neighbors(self.id)
            if neighbors is None
            else neighbors
        )
        self._send_round(
            ch, data, readers, DATA_KIND if ch.receiving >= k else AHEAD_KIND
        )

    async def receive(
        self,
        neighbors: tuple[int, ...] | None = None,
        *,
        channel: str = "main",
        deadline: float | None = None,
        policy: Policy = "raise",
    ) -> dict[int, Any]:
        """Wait for the next message of every neighbour."""
        ch = self._channels.get(channel) or self.open(channel)
        k = ch.receiving
        wanted = (
            self._epochs.at(ch.joinable, k).in_neighbors(self.id)
            if neighbors is None
            else neighbors
        )
        return await self._collect(ch, wanted, deadline, policy)

    async def asynchronous_receive(
        self,
        neighbors: tuple[int, ...] | None = None,
        *,
        channel: str = "main",
        max_age: float = inf,
    ) -> dict[int, Any]:
        """Return the latest message of each neighbour, without waiting.

        max_age: seconds; older messages are left out
        Returns {j: value}; a neighbour without a message is left out.
        """
        ch = self._channels.get(channel) or self.open(channel)
        k = ch.sending
        wanted = (
            self._epochs.at(ch.joinable, k).in_neighbors(self.id)
            if neighbors is None
            else neighbors
        )
        oldest_ns = self._clock.now_ns() - max_age * NS_PER_SECOND
        found = {j: ch.peers.latest[j] for j in wanted if j in ch.peers.latest}
        return {
            j: self._decoded(payload)
            for j, (_, payload, born_ns) in found.items()
            if born_ns >= oldest_ns
        }

    async def close(
        self, channel: str = "main", linger: float = CLOSING_RULES.linger_time
    ) -> None:
        """End a channel: send FIN to the neighbours and answer the late
        ones until all have finished or are silent.

        linger: seconds without a question from unfinished neighbours after which the channel is
            closed anyway

        A channel that is used again continues with its next round. For that all drones must have
        closed it in the same round.
        """
        ch = self.open(channel)
        n = ch.closed_at = max(ch.sending, ch.receiving)
        last = self._epochs.at(ch.joinable, max(n - 1, 0)).neighbors(self.id)
        neighbors = tuple(
            dict.fromkeys(
                [*last, *(j for _, readers in ch.sent.values() for j in readers)]
            )
        )
        ends = self._clock.now() + linger
        answers = ch.answers
        attempt = 0
        due_ns = self._clock.now_ns()
        while late := [
            j
            for j in neighbors
            if ch.peers.finished.get(j, -1) < n and not self._absent(j)
        ]:
            if ch.answers != answers:
                ends = self._clock.now() + linger
                answers = ch.answers
            if self._clock.now() >= ends or ch.changed is not None:
                return
            # Wait for the timer even if there is news: otherwise each of n neighbours asks n times.
            if self._clock.now_ns() >= due_ns:
                self._control(ch, MessageKind.FIN_TOO, tuple(late), n, attempt)
                attempt = attempt + 1
                due_ns = self._clock.now_ns() + round(
                    2 * RESEND_TIMES.shortest * NS_PER_SECOND
                )
            await self._pause(ch, (due_ns - self._clock.now_ns()) / NS_PER_SECOND)
        for again in range(attempt, attempt + CLOSING_RULES.end_messages):
            self._control(ch, MessageKind.FIN, neighbors, n, again)
        ch.sent.clear()
        ch.oldest = ch.sending

    async def fail(self, word: Failure) -> None:
        """Tell all neighbours that this agent stops on every channel.

        A neighbour that waits for this agent, now or later, gets AgentFailed with `word` instead of
        RoundTimeout at its deadline.
        """
        payload = encode(word)
        flags = self._flags | AHEAD_KIND
        for k in range(CLOSING_RULES.last_messages):
            readers = self._epochs.at(False, k).out_neighbors(self.id)
            self.port.send(
                MESSAGE_TOPICS.rounds, readers, payload, k, FAILURE_CHANNEL, flags
            )
            await self._clock.sleep(RESEND_TIMES.shortest, drone=self.id)

    # Sending --------------------------------------------------------------------------

    def _send_round(
        self, ch: Channel, data: Any, to: tuple[int, ...], kind: int
    ) -> None:
        """Encode and send the next round, and keep it for late readers."""
        k = ch.sending
        flags = self._flags | kind
        if ch.wait.own_lateness:
            flags |= flag_lateness(ch.wait.own_lateness, ch.wait.own_relays)
        if type(data) is PerNeighbor:
            if lacking := [j for j in to if j not in data]:
                where = f"drone {self.id}: channel {ch.name!r}"
                raise CodecError(
                    f"{where}: a PerNeighbor of {sorted(data)} has nothing for drone(s) {lacking}"
                )
            payloads = {j: encode(data[j]) for j in to}
            ch.sent[k] = (payloads, to)
            for j, payload in payloads.items():
                self.port.send(MESSAGE_TOPICS.rounds, (j,), payload, k, ch.name, flags)
        else:
            payload = encode(data)
            ch.sent[k] = (payload, to)
            self.port.send(MESSAGE_TOPICS.rounds, to, payload, k, ch.name, flags)
        ch.sending = k + 1
        self.rounds += 1

    async def _admit(self, ch: Channel, seconds: float, patient: bool = True) -> None:
        """Wait until the next round may be sent: no reader is a
        history behind, and no new epoch is being formed.

        patient: False to wait only for readers that have asked for rounds
        """
        ends = self._clock.now() + seconds
        while True:
            if ch.changed is not None:
                error = ch.changed
                ch.changed = None
                raise error
            late = ch.trim(self._epochs.gone, not patient)
            held = ch.joinable and ch.sending >= self._epochs.held
            if not held and ch.sending < ch.oldest + ROUND_WINDOW.kept_rounds:
                break
            lost = [j for j in late if self.membership.is_lost(j)]
            if lost and not ch.joinable:
                raise PeerLost(self.id, lost, self.silence(lost))
            if self._clock.now() >= ends:
                raise RoundTimeout(self.id, ch.name, ch.oldest, late or ch.ins, seconds)
            await self._pause(ch, RESEND_TIMES.longest)
            ch.reminders += 1
            attempt = 2 * FIRST_UNASKED_ATTEMPT + ch.reminders
            for j in ch.behind(ch.oldest, self._epochs.gone, not patient):
                self._again(ch, ch.oldest, j, attempt, MessageKind.REPEAT)
        ch.limit = int(
            min(
                ch.oldest + ROUND_WINDOW.kept_rounds,
                self._epochs.held if ch.joinable else inf,
            )
        )

    async def _pause(self, ch: Channel, seconds: float) -> None:
        """Wait for news of a channel, but not longer than `seconds`."""
        gate = ch.gate = asyncio.get_running_loop().create_future()
        due_ns = self._clock.now_ns() + round(seconds * NS_PER_SECOND)
        alarm = self._clock.call_at(due_ns, wake_waiter, gate, drone=self.id)
        try:
            await gate
        finally:
            ch.gate = None
            alarm.cancel()

    # Receiving ------------------------------------------------------------------------

    async def _collect(
        self,
        ch: Channel,
        wanted: tuple[int, ...],
        deadline: float | None,
        policy: Policy,
    ) -> dict[int, Any]:
        """Wait for the messages of the next round to receive, and decode them."""
        k = ch.receiving
        box = ch.inbox.get(k)
        if box is None:
            box = ch.inbox[k] = {}
        missing = dict.fromkeys(wanted)
        for j in box:
            missing.pop(j, None)
        if missing:
            ch.wait.strict = policy == "raise"
            waiter = self._expect(
                ch, missing, self.deadline if deadline is None else deadline
            )
            try:
                await waiter
            except (RoundTimeout, PeerLost):
                if policy == "raise":
                    raise
            finally:
                self._expected(ch)
        else:
            ch.wait.own_lateness = 0.0
            if not wanted:
                await self._clock.sleep(0.0, drone=self.id)
        del ch.inbox[k]
        ch.receiving = k + 1
        ch.wait.attempt = 0
        if not k % CREDIT_EVERY:
            self._grant(ch, k, wanted)
        if policy == "hold":
            box = {
                j: ch.peers.latest[j][1] for j in wanted if j in ch.peers.latest
            } | box
        heard = {}
        try:
            for j in wanted:
                if j in box:
                    heard[j] = decode(box[j])
        except CodecError:
            self.port.counters.malformed += 1
            raise
        return heard

    def _grant(self, ch: Channel, k: int, wanted: tuple[int, ...]) -> None:
        """Send our progress to the senders that do not receive our messages."""
        one_way = tuple(j for j in wanted if not ch.reads(k, j))
        if one_way:
            self._control(ch, MessageKind.CREDIT, one_way, k + 1)

    def _decoded(self, payload: bytes) -> Any:
        try:
            return decode(payload)
        except CodecError:
            self.port.counters.malformed += 1
            raise
