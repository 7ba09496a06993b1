"""Frames that arrive: from which process each comes, and which ports get its messages.

A process is believed what it says in its own name. What a host sends beyond its budget is not read.
"""

import logging
from functools import partial

from crazychoir.bus.frames import Envelope, Frame, FrameVersionError, decode_frame
from crazychoir.bus.message import Message
from crazychoir.bus.network.arrival_queue import ArrivalQueue
from crazychoir.bus.network.flood_limit import FrameBudget, FrameBudgets
from crazychoir.bus.network.greeter import Greeter
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.link_keys import read_sender, read_token
from crazychoir.bus.network.peers import Peer, Peers
from crazychoir.bus.network.zenoh_session import FrameSample
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import MESSAGE_TOPICS, TOPIC_BY_NUMBER, MessageClass
from crazychoir.errors import CodecError
from crazychoir.runtime.clock import NS_PER_SECOND

log = logging.getLogger(__name__)


class FrameInbox:
    """Takes the frames of other processes, and delivers their messages to the ports of this one.

    bus: bus of this process
    table: the other processes
    greeter: gets HELLO, questions for the clock, tokens, and frames of processes without a token
    counters: gets the numbers of frames that are received and refused
    """

    def __init__(
        self, bus: Bus, table: Peers, greeter: Greeter, counters: LinkCounters
    ) -> None:
        self._bus = bus
        self._table = table
        self._peers = table.by_name
        self._greeter = greeter
        self._counters = counters
        self._now_ns = bus.clock.now_ns
        self._arrivals = ArrivalQueue(counters, bus.clock.now_ns)
        self._budgets = FrameBudgets()
        self._token_budgets = FrameBudgets()

    # In Zenoh's threads ---------------------------------------------------------------

    def receive(self, sample: FrameSample) -> None:
        """Take a frame in Zenoh's thread: add it to the queue, without blocking."""
        key = str(sample.key_expr)
        host, _ = read_sender(key)
        budget = self._budgets.of(host, now := self._now_ns())
        if budget.take(now, len(sample.payload)):
            self._arrivals.add(self._frame, key, sample.payload.to_bytes())
        else:
            self._flooded(budget, host)

    def receive_token(self, key: str, is_there: bool) -> None:
        """Take a change of a token in Zenoh's other thread.

        is_there: True if the token has appeared, False if it has disappeared
        """
        host, _ = read_token(key)
        budget = self._token_budgets.of(host, now := self._now_ns())
        if budget.take(now):
            greeter = self._greeter
            handler = greeter.token_came if is_there else greeter.token_went
            self._arrivals.add(handler, key, b"")
        else:
            self._flooded(budget, host)

    def _flooded(self, budget: FrameBudget, host: str) -> None:
        """Count a frame that is not read, and log the host once."""
        self._counters.flooded += 1
        if not budget.said:
            budget.said = True
            self._arrivals.call_on_loop(
                partial(
                    log.warning,
                    "host %s floods us: of what it says beyond that nothing is read",
                    host,
                )
            )

    # In the event loop ----------------------------------------------------------------

    def _frame(self, key: str, data: bytes, arrived_ns: int) -> None:
        """Decode a frame, find its peer, and deliver its messages."""
        counters = self._counters
        try:
            frame = decode_frame(data)
        except FrameVersionError:
            counters.other_version += 1
            return
        except CodecError:
            counters.malformed += 1
            return
        peer = self._sender(key, frame)
        if peer is None:
            counters.strangers += 1
            self._greeter.meet_stranger(key, frame)
            return
        counters.frames_received += 1
        messages = frame.envelopes
        if frame.kind == MessageClass.CONTROL:
            messages = peer.control.drop_overtaken(messages)
            counters.overtaken += len(frame.envelopes) - len(messages)
        self._distribute(peer, messages, arrived_ns, self._now_ns())

    def receive_local(self, process: str, data: bytes, sent_ns: int) -> None:
        """Take a frame that came through a socket; an error of a receiver does not stop the next one.

        sent_ns: ns, time of sending by the clock of this machine
        """
        peer = self._peers.get(process)
        if peer is None:
            self._counters.strangers += 1
            return
        now_ns = self._now_ns()
        if not peer.budget.take(now_ns, len(data)):
            self._flooded(peer.budget, f"{peer.host} (process {process})")
            return
        try:
            frame = decode_frame(data)
        except FrameVersionError:
            self._counters.other_version += 1
            return
        except CodecError:
            self._counters.malformed += 1
            return
        if frame.process != process:
            self._counters.strangers += 1
            return
        self._counters.frames_received += 1
        if frame.kind == MessageClass.CONTROL:
            peer.control.note(frame.envelopes)
        try:
            self._distribute(peer, frame.envelopes, min(sent_ns, now_ns), now_ns)
        except Exception as error:  # noqa: BLE001 - the next frame is read all the same
            self._arrivals.note_failure(process, error)

    def _sender(self, key: str, frame: Frame) -> Peer | None:
        """Return the peer that sent a frame.

        Its key, its token and its content must agree, since certificates protect only keys.
        """
        host, process = read_sender(key)
        peer = self._peers.get(process)
        return (
            peer
            if peer is not None and peer.host == host and frame.process == process
            else None
        )

    def _distribute(
        self, peer: Peer, messages: list[Envelope], arrived_ns: int, now_ns: int
    ) -> None:
        """Deliver the messages of a peer that it may send to the ports of this process.

        arrived_ns: ns, time of their arrival, or of their sending on this host
        now_ns: ns, the present time
        """
        directory = self._table.directory
        access = self._table.access
        ports = self._bus.ports
        waited = (now_ns - arrived_ns) / NS_PER_SECOND
        for envelope in messages:
            topic = TOPIC_BY_NUMBER.get(envelope.topic)
            age = envelope.age + waited
            if topic is MESSAGE_TOPICS.hello:
                self._greeter.take_hello(peer, envelope.payload, age)
                continue
            if topic is MESSAGE_TOPICS.clock:
                self._greeter.take_clock_message(peer, envelope.payload, arrived_ns)
                continue
            if directory.get(envelope.source) is not peer:
                self._counters.strangers += 1
                continue
            if access is not None and not access.may_say(peer.host, envelope):
                self._forbid(peer)
                continue
            if topic is None:
                self._counters.malformed += 1
                continue
            message = Message(
                topic,
                envelope.source,
                envelope.payload,
                envelope.number,
                envelope.channel,
                envelope.flags,
            )
            # A comprehension is a call in Python 3.11.
            here: dict[int, None] = {}
            for j in envelope.to:
                if j in ports:
                    here[j] = None
            self._bus.deliver(message, here, age)

    def _forbid(self, peer: Peer) -> None:
        """Count a command that is not executed, and log the process once."""
        self._counters.forbidden += 1
        if not peer.forbidden:
            peer.forbidden = True
            log.warning(
                "host %s (process %s) commands and is no operator: not obeyed",
                peer.host,
                peer.process,
            )
