"""Frames that leave: the messages for each peer and class are sent once in each pass of the event loop.

A frame to a process of this host goes through a socket, if there is a connection, else through Zenoh.
"""

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from crazychoir.bus.frames import Envelope, Frame, FrameBuffer, encode_frame
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.local_sockets import LocalSockets
from crazychoir.bus.network.peers import Peer
from crazychoir.bus.network.zenoh_session import FramePublisher, ZenohSession
from crazychoir.bus.topics import MessageClass
from crazychoir.errors import CodecError

log = logging.getLogger(__name__)


@dataclass(slots=True, eq=False)
class PeerQueue:
    """The messages of one class on their way to one peer."""

    buffer: FrameBuffer
    """Messages for the next frame."""
    publisher: FramePublisher
    """Publisher of the frames that go through Zenoh."""
    process: str
    """Name of the peer."""
    klass: MessageClass
    """Class of the messages."""
    is_filled: bool = False
    """True if there are messages for the next frame."""


class FrameOutbox:
    """Collects the messages for other processes, and sends their frames.

    session: sends frames through Zenoh
    sockets: sends frames to processes of this host
    incarnation: number of this process, told in each frame
    counters: gets the numbers of frames that are sent, and of messages that are not
    """

    def __init__(
        self,
        session: ZenohSession,
        sockets: LocalSockets,
        incarnation: int,
        counters: LinkCounters,
    ) -> None:
        self._session = session
        self._sockets = sockets
        self._incarnation = incarnation
        self._counters = counters
        self._loop = asyncio.get_running_loop()
        self._is_scheduled = False
        self._filled: list[PeerQueue] = []
        """Queues with messages."""
        self._before: deque[Callable[[], None]] = deque()
        self._after: deque[Callable[[], None]] = deque()

    def add(self, peer: Peer, klass: MessageClass, message: Envelope) -> None:
        """Add a message to the next frame for a peer and a class.

        A message that fits into no frame is counted and logged.
        """
        if not self._session.is_open:
            self._counters.dropped += 1
            return
        queue = peer.queues.get(klass) or self._open_queue(peer, klass)
        try:
            queue.buffer.add(message)
        except CodecError as error:
            self._counters.unsendable += 1
            log.warning("not sent: %s", error)
            return
        if not queue.is_filled:
            queue.is_filled = True
            self._filled.append(queue)
        if not self._is_scheduled:
            self._schedule_flush()

    def _open_queue(self, peer: Peer, klass: MessageClass) -> PeerQueue:
        """Open the queue of a class to a peer."""
        is_here = peer.host == self._session.keys.host
        publisher = self._session.make_publisher(
            peer.process, klass, is_occasional=is_here
        )
        conflate = klass is MessageClass.CONTROL
        name = self._session.keys.process
        buffer = FrameBuffer(name, self._incarnation, klass, conflate)
        queue = peer.queues[klass] = PeerQueue(buffer, publisher, peer.process, klass)
        return queue

    def drop_queues(self, peer: Peer) -> None:
        """Drop what waits for a peer that went away."""
        for queue in peer.queues.values():
            self._counters.dropped += len(queue.buffer)
            queue.buffer.take()
            queue.is_filled = False
            queue.publisher.undeclare()

    def call_before_flush(self, work: Callable[[], None]) -> None:
        """Call `work` at the end of this pass of the event loop; its messages leave in this pass too."""
        self._before.append(work)
        if not self._is_scheduled:
            self._schedule_flush()

    def call_after_flush(self, work: Callable[[], None]) -> None:
        """Call `work` when the frames of this pass of the event loop have left."""
        self._after.append(work)
        if not self._is_scheduled:
            self._schedule_flush()

    def _schedule_flush(self) -> None:
        self._is_scheduled = True
        self._loop.call_soon(self.flush)

    def flush(self) -> None:
        """Send all frames, then run the work that waits for that."""
        while self._before:
            self._before.popleft()()
        self._is_scheduled = False
        counters = self._counters
        sockets = self._sockets
        connections = sockets.connections
        session = self._session
        filled = self._filled
        self._filled = []
        for queue in filled:
            queue.is_filled = False
            for frame in queue.buffer.take():
                connection = connections.get(queue.process)
                if connection is None:
                    is_sent = session.send(queue.publisher.put, frame)
                else:
                    is_sent = connection.send_at_once(frame) or sockets.send(
                        queue.process, queue.klass, frame
                    )
                if is_sent:
                    counters.frames_sent += 1
                    counters.bytes_sent += len(frame)
        for _ in range(len(self._after)):
            self._after.popleft()()

    def send_without_queue(
        self, processes: Iterable[str], klass: MessageClass, message: Envelope
    ) -> None:
        """Send a message through Zenoh to processes that are no peers.

        Raises CodecError for a message that fits into no frame.
        """
        frame = self.encode(klass, message)
        for process in processes:
            if self._session.send_frame(process, klass, frame):
                self._counters.frames_sent += 1
                self._counters.bytes_sent += len(frame)

    def encode(self, klass: MessageClass, message: Envelope) -> bytes:
        """Return a frame of this process with one message; may be called from any thread.

        Raises CodecError for a message that fits into no frame.
        """
        name = self._session.keys.process
        return encode_frame(Frame(name, self._incarnation, klass, [message]))
