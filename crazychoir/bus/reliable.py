"""Reliable messages between two ports over lossy links: sequence
numbers, acknowledgements and retransmission.

The memory is bounded in messages and in age. A message without an acknowledgement within `RELIABLE_LIMITS.max_age`
is given up and counted, and the sequence continues after it. Messages are delivered once and in
order. A restarted sender begins a new sequence with its new incarnation.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from crazychoir.bus.message import Message
from crazychoir.bus.port import Port
from crazychoir.bus.topics import MESSAGE_TOPICS, Topic
from crazychoir.runtime.clock import NS_PER_SECOND, Alarm


@dataclass(frozen=True, slots=True)
class ReliableLimits:
    """When a reliable message is sent again or given up, and what is remembered of each port."""

    first_timeout: float = 0.03
    """s until the first retransmission. It doubles up to longest_timeout."""
    longest_timeout: float = 0.5
    """s: longest time until a retransmission."""
    max_age: float = 15.0
    """s: age at which a message without an acknowledgement is given up."""
    max_pending: int = 256
    """Most messages to one port without an acknowledgement."""
    former_incarnations: int = 16
    """Former incarnations of a sender that are remembered, the newest."""


RELIABLE_LIMITS = ReliableLimits()


Receive = Callable[[int, bytes], None]
"""Callable that gets (source, payload), in the sender's order."""


@dataclass
class _Pending:
    """A message that is not acknowledged yet."""

    topic: Topic
    """Topic of the message."""
    payload: bytes
    """Payload of the codec."""
    sent_ns: int
    """ns: time of the first transmission."""
    due_ns: int
    """ns: time of the next transmission."""
    rto: float = RELIABLE_LIMITS.first_timeout
    """s until the next transmission."""


@dataclass
class _Outgoing:
    """The messages to one port."""

    number: int = 0
    """Number of the next message."""
    resent: int = 0
    """Retransmissions of all messages so far."""
    pending: dict[int, _Pending] = field(default_factory=dict)
    """{number: message} without an acknowledgement."""


@dataclass
class _Incoming:
    """The messages from one port."""

    incarnation: str
    """Label of the sender's incarnation."""
    expected: int = 0
    """Number of the next message to deliver."""
    early: dict[int, tuple[int, bytes]] = field(default_factory=dict)
    """{number: (topic, payload)} of messages that wait for earlier ones."""
    acks: int = 0
    """Acknowledgements sent."""
    former: dict[str, None] = field(default_factory=dict)
    """Incarnations before this one; their messages arrive too late."""

    def skip(self, oldest: int) -> None:
        """Skip the messages before `oldest`.

        The sender will not repeat them: it has our acknowledgement, or has given up.
        """
        if oldest > self.expected:
            self.expected = oldest
            self.early = {
                k: message for k, message in self.early.items() if k >= oldest
            }


class Reliable:
    """The reliable messages of one port.

    given_up: messages that were not acknowledged, or did not fit
    """

    def __init__(self, port: Port) -> None:
        self.port = port
        self.clock = port.bus.clock
        self.given_up = 0
        self._label = f"{port.incarnation:x}"
        self._outgoing: dict[int, _Outgoing] = {}
        self._incoming: dict[int, _Incoming] = {}
        self._receivers: dict[int, Receive] = {}
        self._alarm: Alarm | None = None
        port.handlers[MESSAGE_TOPICS.acknowledgement.number] = self._acknowledged

    def listen(self, topic: Topic, receive: Receive) -> None:
        """Pass the messages of a reliable topic to `receive`."""
        self._receivers[topic.number] = receive
        self.port.handlers[topic.number] = self._arrived

    def send(self, topic: Topic, j: int, payload: bytes) -> None:
        """Send to port j.

        The message arrives once, after all earlier messages, or is counted in `given_up`.
        """
        outgoing = self._outgoing.setdefault(j, _Outgoing())
        if len(outgoing.pending) >= RELIABLE_LIMITS.max_pending:
            self.given_up += 1
            return
        now_ns = self.clock.now_ns()
        message = _Pending(
            topic,
            payload,
            now_ns,
            now_ns + round(RELIABLE_LIMITS.first_timeout * NS_PER_SECOND),
        )
        outgoing.pending[outgoing.number] = message
        self._transmit(j, outgoing.number, message)
        outgoing.number += 1
        self._schedule()

    def is_sending(self, topic: Topic, j: int) -> bool:
        """Return whether a message of a topic to port j has no acknowledgement yet."""
        outgoing = self._outgoing.get(j)
        return outgoing is not None and any(
            message.topic is topic for message in outgoing.pending.values()
        )

    def forget(self, j: int) -> None:
        """Stop retransmission to port j because it is gone.

        If it comes back, the sequence continues.
        """
        if j in self._outgoing:
            self._outgoing[j].pending.clear()

    def _transmit(self, j: int, number: int, message: _Pending) -> None:
        # A receiver that is new or restarted must know where its sequence begins: at the oldest
        # pending number.
        outgoing = self._outgoing[j]
        oldest = min(outgoing.pending)
        numbered = Message(
            message.topic,
            self.port.address,
            message.payload,
            number,
            self._label,
            number - oldest,
        )
        # With all retransmissions as the attempt, each transmission is one step further in a
        # burst of losses, also after a message was given up.
        self.port.send(numbered, (j,), outgoing.resent)

    def _arrived(self, message: Message, age: float) -> None:
        """Take a message: deliver it and its successors in order, and acknowledge.

        Its flags are its number minus the oldest pending number of the sender.
        """
        source = message.source
        number = message.number
        label = message.channel
        incoming = self._incoming.get(source)
        if incoming is None:
            incoming = self._incoming[source] = _Incoming(label)
        elif incoming.incarnation != label:
            if label in incoming.former:
                return
            former = dict(
                list({**incoming.former, incoming.incarnation: None}.items())[
                    -RELIABLE_LIMITS.former_incarnations :
                ]
            )
            incoming = self._incoming[source] = _Incoming(label, former=former)
        incoming.skip(number - message.flags)
        if (
            number >= incoming.expected
            and len(incoming.early) < RELIABLE_LIMITS.max_pending
        ):
            incoming.early[number] = (message.topic.number, message.payload)
        while incoming.expected in incoming.early:
            kind, content = incoming.early.pop(incoming.expected)
            incoming.expected += 1
            self._receivers[kind](source, content)
        incoming.acks += 1
        acknowledgement = Message(
            MESSAGE_TOPICS.acknowledgement,
            self.port.address,
            b"",
            incoming.expected,
            label,
        )
        self.port.send(acknowledgement, (source,), incoming.acks)

    def _acknowledged(self, message: Message, age: float) -> None:
        outgoing = self._outgoing.get(message.source)
        if outgoing is not None and message.channel == self._label:
            for done in [k for k in outgoing.pending if k < message.number]:
                del outgoing.pending[done]

    def _schedule(self) -> None:
        if self._alarm is None:
            due = self.clock.now_ns() + round(
                RELIABLE_LIMITS.first_timeout / 2 * NS_PER_SECOND
            )
            self._alarm = self.clock.call_at(due, self._sweep, drone=self.port.address)

    def _sweep(self) -> None:
        """Resend the messages that are due, and give up the old ones."""
        # Ports of this process answer within `_transmit`: the pending messages may change
        # during this loop.
        self._alarm = None
        now_ns = self.clock.now_ns()
        for j, outgoing in list(self._outgoing.items()):
            for number, message in list(outgoing.pending.items()):
                if number not in outgoing.pending:
                    continue
                if now_ns - message.sent_ns > RELIABLE_LIMITS.max_age * NS_PER_SECOND:
                    del outgoing.pending[number]
                    self.given_up += 1
                elif now_ns >= message.due_ns:
                    self._resend(j, number, message, now_ns)
        if any(outgoing.pending for outgoing in self._outgoing.values()):
            self._schedule()

    def _resend(self, j: int, number: int, message: _Pending, now_ns: int) -> None:
        self._outgoing[j].resent += 1
        message.rto = min(2.0 * message.rto, RELIABLE_LIMITS.longest_timeout)
        message.due_ns = now_ns + round(message.rto * NS_PER_SECOND)
        self.port.counters.resent += 1
        self._transmit(j, number, message)
