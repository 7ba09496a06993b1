"""What arrives on the channels of one drone: rounds, questions, and the ends of channels.

A drone that receives a repeated message answers with its own message of that round. Messages for a
channel or an epoch that this drone does not have yet are kept for a while.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any, Final

from crazychoir.bus.message import Message
from crazychoir.bus.port import Port
from crazychoir.errors import CodecError
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team.channel import Channel, wake_if
from crazychoir.team.channel_table import ChannelTable
from crazychoir.team.message_kind import (
    ANSWER_KIND,
    DELAY_MASK,
    DOUBLE_KIND,
    EPOCH_SHIFT,
    KIND_MASK,
    LAST_KIND,
    REPEAT_KIND,
    MessageKind,
    split_contents,
)
from crazychoir.team.round_sender import (
    FIRST_UNASKED_ATTEMPT,
    ROUND_TOPIC,
    RoundSender,
)
from crazychoir.types import Malformed

FIRST_REFUSED_ROUND: Final = 1 << 48
"""First round number that is refused as malformed."""


@dataclass(frozen=True, slots=True)
class EarlyMessageLimits:
    """Limits of the messages for channels and epochs that a drone does not have yet."""

    most_kept: int = 256
    """Messages that are kept; newer ones replace older ones."""
    most_bytes: int = 8192
    """Largest payload that is kept. The sender of a larger one resends it."""


EARLY_LIMITS = EarlyMessageLimits()


class RoundArrivals:
    """Takes the messages of rounds for one drone, and answers its neighbours.

    port: port of the drone on the bus
    table: channels of the drone
    sender: sends the answers
    """

    def __init__(self, port: Port, table: ChannelTable, sender: RoundSender) -> None:
        self._port = port
        self._table = table
        self._channels = table.channels
        self._sender = sender
        self._heard_ns = port.heard_ns
        self._early: deque[tuple[Message, int]] = deque(maxlen=EARLY_LIMITS.most_kept)
        """(message, time of its creation in ns) of the messages that came too early."""

    def take(self, message: Message, age: float) -> None:
        """Take a message of a neighbour: store it, answer it, and wake the waiting verb."""
        table = self._table
        source = message.source
        ch = self._channels.get(message.channel)
        if (
            ch is None
            or message.flags != table.epoch_flags
            or message.number >= FIRST_REFUSED_ROUND
            or source not in table.known
        ):
            ch = self._take_unusual(message, age)
            if ch is None:
                return
        born_ns = self._heard_ns[source]
        if age:
            born_ns -= int(age * NS_PER_SECOND)
        ch.take(message, born_ns)

    def _take_unusual(self, message: Message, age: float) -> Channel | None:
        """Take a message that is unusual by its kind, epoch, sender or channel.

        Returns its channel if it holds a round that is to be stored.
        """
        kind = message.flags & KIND_MASK
        if kind > LAST_KIND:
            self._port.counters.malformed += 1
            return None
        ch = self._find_channel(message, age)
        if ch is None:
            return None
        if kind == DOUBLE_KIND:
            self._take_double(message, age)
        elif kind > DOUBLE_KIND:
            self._take_control(ch, message)
        else:
            if kind == REPEAT_KIND:
                self._answer(ch, message.number, message.source)
            return ch
        return None

    def _find_channel(self, message: Message, age: float) -> Channel | None:
        """Return the channel of an unusual message that is to be handled now.

        If its channel or its epoch may soon exist here, the message is kept for later. A message of
        an earlier epoch is dropped.
        """
        table = self._table
        source = message.source
        if message.number >= FIRST_REFUSED_ROUND or source not in table.known:
            self._port.counters.malformed += 1
            return None
        ch = self._channels.get(message.channel)
        epoch = message.flags >> EPOCH_SHIFT
        present = table.epochs.epoch
        if ch is not None and (ch.joinable or epoch == present):
            return ch
        if epoch >= present and len(message.payload) <= EARLY_LIMITS.most_bytes:
            born_ns = self._heard_ns[source] - int(age * NS_PER_SECOND)
            self._early.append((message, born_ns))
        return None

    def replay(self) -> None:
        """Handle again the early messages: their channel or their epoch may exist now."""
        early = list(self._early)
        self._early.clear()
        for message, born_ns in early:
            age = (self._heard_ns[message.source] - born_ns) / NS_PER_SECOND
            self.take(message, age)

    def _take_double(self, message: Message, age: float) -> None:
        """Take a message of two rounds as two messages."""
        number = message.number
        try:
            own, before = split_contents(message.payload)
            if number == 0:
                raise CodecError("message of two rounds: there is no round before 0.")
        except CodecError:
            self._port.counters.malformed += 1
            return
        source = message.source
        channel = message.channel
        answer = message.flags & ~DELAY_MASK | ANSWER_KIND
        repeat = message.flags ^ DOUBLE_KIND ^ REPEAT_KIND
        earlier = Message(ROUND_TOPIC, source, before, number - 1, channel, answer)
        self.take(earlier, age)
        self.take(Message(ROUND_TOPIC, source, own, number, channel, repeat), age)

    def open_all(
        self,
        messages: dict[int, Message],
        senders: tuple[int, ...],
        takes_malformed: bool,
    ) -> dict[int, Any]:
        """Return the values of the messages of these senders; those without a message are left out.

        takes_malformed: True to return a Malformed for a message that cannot be decoded
        Counts each message that cannot be decoded; raises CodecError without takes_malformed.
        """
        values = {}
        for j in senders:
            if j in messages:
                try:
                    values[j] = messages[j].open()
                except CodecError as error:
                    self._port.counters.malformed += 1
                    if not takes_malformed:
                        raise
                    values[j] = Malformed(str(error))
        return values

    # Answers --------------------------------------------------------------------------

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
            self._sender.send_control(
                ch, MessageKind.CREDIT, (source,), ch.receiving, ch.answers
            )

    def _serve(self, ch: Channel, number: int, source: int) -> None:
        """Send a round again.

        A round that is no longer kept was read by all members of its epoch. The source did not
        count as a member then, and can no longer get that round: answer GONE.
        """
        ch.answers += 1
        if ch.joinable and number < ch.oldest:
            self._sender.send_control(
                ch, MessageKind.GONE, (source,), ch.oldest, ch.answers
            )
        else:
            attempt = 2 * ch.answers + 1
            self._sender.send_again(ch, number, source, attempt, ANSWER_KIND)

    def _farewell(self, ch: Channel, number: int, source: int) -> None:
        """Answer FIN to a drone that asks for a round after our end.

        Such an answer does not prolong the time for which `close` waits.
        """
        if 0 <= ch.closed_at <= number and ch.closed_at >= ch.sending:
            ch.told += 1
            attempt = FIRST_UNASKED_ATTEMPT + ch.told
            self._sender.send_control(
                ch, MessageKind.FIN, (source,), ch.closed_at, attempt
            )

    # Messages without content ---------------------------------------------------------

    def _take_control(self, ch: Channel, message: Message) -> None:
        """Take a message without content: WANT, CREDIT, FIN, FIN_TOO or GONE."""
        kind = message.flags & KIND_MASK
        source = message.source
        number = message.number
        peers = ch.peers
        if kind == MessageKind.GONE:
            self._skip(ch, number, source)
            return
        if kind >= MessageKind.FIN:
            peers.finished[source] = max(number, peers.finished.get(source, -1))
            if kind == MessageKind.FIN_TOO and number <= ch.closed_at:
                ch.answers += 1
                self._sender.send_control(
                    ch, MessageKind.FIN, (source,), ch.closed_at, ch.answers
                )
        else:
            if source not in peers.pacing:
                peers.pacing[source] = None
                ch.limit = min(ch.limit, ch.sending)
        peers.progress[source] = max(
            min(number, ch.sending), peers.progress.get(source, 0)
        )
        if kind == MessageKind.WANT:
            self._farewell(ch, number, source)
            self._serve(ch, number, source)
        wake_if(ch.gate)

    def _skip(self, ch: Channel, number: int, source: int) -> None:
        """Stop waiting for the rounds of source before `number`.

        The source considered us lost in these rounds. Only rounds of earlier epochs are skipped.
        """
        first = ch.peers.kept[source] = max(
            min(number, self._table.epochs.first), ch.peers.kept.get(source, 0)
        )
        if ch.receiving < first and source in ch.wait.missing:
            del ch.wait.missing[source]
            if not ch.wait.missing:
                wake_if(ch.wait.waiter)
