"""Sends the messages of the rounds of one drone, for the first time and again."""

from typing import Any, Final

from crazychoir.bus.codec import encode
from crazychoir.bus.message import Message
from crazychoir.bus.port import Port
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import CodecError
from crazychoir.team.channel import Channel
from crazychoir.team.channel_table import ChannelTable
from crazychoir.team.message_kind import (
    ANSWER_KIND,
    DOUBLE_KIND,
    REPEAT_KIND,
    MessageKind,
    flag_lateness,
    join_contents,
)
from crazychoir.types import PerNeighbor

FIRST_UNASKED_ATTEMPT: Final = 1 << 20
"""Attempt numbers from here on mark messages that no neighbour asked for."""
MOST_DOUBLE_BYTES: Final = 1024
"""Most bytes of two rounds that are sent again in one message."""
ROUND_TOPIC: Final = MESSAGE_TOPICS.rounds
"""Topic of all messages of rounds."""


def encode_each(data: PerNeighbor, to: tuple[int, ...], where: str) -> dict[int, bytes]:
    """Return the payload of the value for each of these neighbours.

    where: drone and channel, for the text of the error
    Raises CodecError if there is no value for a neighbour.
    """
    if lacking := [j for j in to if j not in data]:
        raise CodecError(
            f"{where}: a PerNeighbor of {sorted(data)} has nothing for drone(s) {lacking}"
        )
    return {j: encode(data[j]) for j in to}


class RoundSender:
    """Sends the rounds of all channels of one drone.

    port: port of the drone on the bus
    table: channels of the drone
    """

    def __init__(self, port: Port, table: ChannelTable) -> None:
        self._port = port
        self._table = table
        self._id = port.address

    def send_round(
        self, ch: Channel, data: Any, to: tuple[int, ...], kind: int
    ) -> None:
        """Encode and send the next round, and keep it for late readers."""
        k = ch.sending
        flags = self._table.epoch_flags | kind
        wait = ch.wait
        if wait.own_lateness:
            flags |= flag_lateness(wait.own_lateness, wait.own_relays)
        if type(data) is PerNeighbor:
            self._send_to_each(ch, data, to, flags)
        else:
            payload = encode(data)
            ch.sent[k] = (payload, to)
            message = Message(ROUND_TOPIC, self._id, payload, k, ch.name, flags)
            self._port.send(message, to)
        ch.sending = k + 1
        ch.counters.sent += 1

    def _send_to_each(
        self, ch: Channel, data: PerNeighbor, to: tuple[int, ...], flags: int
    ) -> None:
        """Send a value of its own to each neighbour."""
        k = ch.sending
        payloads = encode_each(data, to, f"drone {self._id}: channel {ch.name!r}")
        ch.sent[k] = (payloads, to)
        for j, payload in payloads.items():
            message = Message(ROUND_TOPIC, self._id, payload, k, ch.name, flags)
            self._port.send(message, (j,))

    def send_again(self, ch: Channel, k: int, j: int, attempt: int, kind: int) -> None:
        """Resend our message of round k to j, if it is kept."""
        payload = ch.stored(k, j)
        if payload is not None:
            self._send_content(ch, k, j, payload, attempt, kind)

    def send_awaited(self, ch: Channel) -> None:
        """Resend our message of this round and of the one before to every missing neighbour.

        A missing neighbour may have sent its message of this round and lost it, or may lack ours of
        the round before. If both are small, they go in one message.
        """
        wait = ch.wait
        k = ch.receiving
        for j in list(wait.missing):
            own = ch.stored(k, j) if ch.reads(k, j) else None
            before = ch.stored(k - 1, j) if ch.reads(k - 1, j) else None
            if (
                own is not None
                and before is not None
                and len(own) + len(before) <= MOST_DOUBLE_BYTES
            ):
                both = join_contents(own, before)
                self._send_content(ch, k, j, both, 2 * wait.attempt, DOUBLE_KIND)
                continue
            if before is not None:
                attempt = FIRST_UNASKED_ATTEMPT + wait.attempt
                self._send_content(ch, k - 1, j, before, attempt, ANSWER_KIND)
            if own is not None:
                self._send_content(ch, k, j, own, 2 * wait.attempt, REPEAT_KIND)
            else:
                self.send_control(ch, MessageKind.WANT, (j,), k, wait.attempt)

    def _send_content(
        self, ch: Channel, k: int, j: int, payload: bytes, attempt: int, kind: int
    ) -> None:
        """Resend this content, which is our message of round k, to j."""
        self._port.counters.resent += 1
        flags = self._table.epoch_flags | kind
        message = Message(ROUND_TOPIC, self._id, payload, k, ch.name, flags)
        self._port.send(message, (j,), attempt)

    def send_control(
        self, ch: Channel, kind: int, to: tuple[int, ...], k: int, attempt: int = 0
    ) -> None:
        """Send a message without content."""
        flags = self._table.epoch_flags | kind
        message = Message(ROUND_TOPIC, self._id, b"", k, ch.name, flags)
        self._port.send(message, to, attempt)

    def send_credit(self, ch: Channel, k: int, senders: tuple[int, ...]) -> None:
        """Send our progress to the senders that do not receive our messages of round k."""
        one_way = tuple(j for j in senders if not ch.reads(k, j))
        if one_way:
            self.send_control(ch, MessageKind.CREDIT, one_way, k + 1)
