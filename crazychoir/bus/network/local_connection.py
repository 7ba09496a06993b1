"""The socket of one pair of processes: frames leave in the order of their classes, and come together from pieces.

A socket of the kind SEQPACKET keeps packets apart. Each packet is one frame, or a piece of a large
one, and tells when it was sent, by the clock of the machine, so that a frame ages while it waits for
its reader.

Frames for which the socket has no room wait here, in a queue for each class. Between whole frames
the most urgent class goes first, as in Zenoh; the frames of one class stay in order.
"""

import socket
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from crazychoir.bus.frames import FRAME_FORMAT
from crazychoir.bus.topics import MessageClass


@dataclass(frozen=True, slots=True)
class ConnectionSizes:
    """Sizes of the sockets between the processes of a host."""

    buffer_size: int = 1 << 18
    """Bytes that are asked for each direction of a connection.

    Linux grants the double, or less. An urgent frame waits behind what is in the socket already, so
    more is not better.
    """
    piece_size: int = 120 * 1024
    """Bytes of the pieces of a large frame, at most; a socket with a small buffer gets smaller ones.

    A read takes memory for the largest packet: below 128 KiB the system's allocator has it at hand,
    while a megabyte costs each read 15 us.
    """
    most_waiting: int = 2 * FRAME_FORMAT.max_bytes
    """Most bytes of frames of a class that may wait here until the socket has room."""


CONNECTION_SIZES = ConnectionSizes()


PACKET_HEAD: Final = struct.Struct("<BIQ")
"""Start of a packet with a frame, or with a piece of one.

It holds a mark, the place of the piece in the frame in bytes, and the time of sending in ns.
"""
LARGEST_PACKET: Final = PACKET_HEAD.size + CONNECTION_SIZES.piece_size
"""Bytes of the largest packet."""
PIECE_MARK: Final = 0xF0
"""First byte of a packet with a piece of a frame that goes on."""
LAST_PIECE_MARK: Final = 0xF1
"""First byte of a packet with a whole frame, or with the last piece of one."""


@dataclass(slots=True)
class LeavingFrame:
    """A frame on its way into the socket."""

    content: bytes
    """The frame."""
    sent_ns: int
    """ns: time of sending."""
    start: int = 0
    """Bytes that are in the socket."""

    def cut_packet(self, size: int) -> bytes:
        """Return the next packet, with at most `size` bytes of the frame."""
        is_last = self.start + size >= len(self.content)
        mark = LAST_PIECE_MARK if is_last else PIECE_MARK
        head = PACKET_HEAD.pack(mark, self.start, self.sent_ns)
        return head + self.content[self.start : self.start + size]


class WaitingFrames:
    """The frames of one class that wait until the socket has room.

    keeps_newest: True if a frame drops the oldest ones for which there is no room with it; else the
        frame itself is dropped
    """

    def __init__(self, keeps_newest: bool) -> None:
        self._keeps_newest = keeps_newest
        self._frames: deque[LeavingFrame] = deque()
        self._size = 0

    def __bool__(self) -> bool:
        return bool(self._frames)

    def add(self, frame: LeavingFrame) -> int:
        """Add a frame, and return how many frames were dropped."""
        room = CONNECTION_SIZES.most_waiting - len(frame.content)
        dropped = 0
        while self._frames and self._size > room:
            dropped += 1
            if not self._keeps_newest:
                return dropped
            self.take()
        self._frames.append(frame)
        self._size += len(frame.content)
        return dropped

    def take(self) -> LeavingFrame:
        """Remove the oldest frame, and return it."""
        frame = self._frames.popleft()
        self._size -= len(frame.content)
        return frame


class LocalConnection:
    """The socket of one pair of processes.

    made: connected socket
    now_ns: returns the time in ns, by the clock of the machine

    Attributes:
    process: name of the other process; empty until it is known
    path: path of the other process, if this one has connected
    pieces: the pieces of a large frame that have arrived. Only to be read from outside
    leaving: frame that waits until the socket has room; a part of it may have left already. None if no
        frame waits. Only to be read from outside
    """

    def __init__(self, made: socket.socket, now_ns: Callable[[], int]) -> None:
        made.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            made.setsockopt(socket.SOL_SOCKET, option, CONNECTION_SIZES.buffer_size)
        granted = made.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF)
        self.socket = made
        self._now_ns = now_ns
        self.process = ""
        self.path = ""
        # The system counts its own records too: a packet may have at most about half of the buffer.
        self._piece_size = min(CONNECTION_SIZES.piece_size, granted // 4)
        self.leaving: LeavingFrame | None = None
        self._waiting = {
            klass: WaitingFrames(keeps_newest=klass is MessageClass.CONTROL)
            for klass in sorted(MessageClass)
        }
        """The frames behind the leaving one, from the most urgent class on."""
        self.pieces = bytearray()

    # Sending --------------------------------------------------------------------------

    def send_at_once(self, frame: bytes) -> bool:
        """Send a frame as one packet. Return False if it has to go another way.

        Most frames go this way. A frame does not if it is large, if others wait, if the socket has no
        room, or if the connection is broken: `send` finds out.
        """
        if self.leaving is not None or len(frame) > self._piece_size:
            return False
        packet = PACKET_HEAD.pack(LAST_PIECE_MARK, 0, self._now_ns()) + frame
        try:
            self.socket.send(packet, socket.MSG_NOSIGNAL)
        except OSError:
            return False
        return True

    def send(self, klass: MessageClass, frame: bytes) -> int:
        """Send a frame, or let it wait; return how many frames were dropped.

        Raises OSError if the connection is broken.
        """
        leaving = LeavingFrame(frame, self._now_ns())
        if self.leaving is not None:
            return self._waiting[klass].add(leaving)
        self.leaving = leaving
        self.send_waiting()
        return 0

    def send_waiting(self) -> None:
        """Send the frames that wait, as many as have room. Raises OSError if the connection is broken."""
        try:
            while self.leaving is not None:
                frame = self.leaving
                packet = frame.cut_packet(self._piece_size)
                self.socket.send(packet, socket.MSG_NOSIGNAL)
                frame.start += self._piece_size
                if frame.start >= len(frame.content):
                    self.leaving = self._take_most_urgent()
        except (BlockingIOError, InterruptedError):
            return

    def _take_most_urgent(self) -> LeavingFrame | None:
        """Return the next frame to be sent, or None if no frame waits."""
        for waiting in self._waiting.values():
            if waiting:
                return waiting.take()
        return None

    def drop_waiting(self) -> None:
        """Drop all frames that wait."""
        while self.leaving is not None:
            self.leaving = self._take_most_urgent()

    # Receiving ------------------------------------------------------------------------

    def join_piece(self, mark: int, start: int, content: bytes) -> bytes:
        """Take a piece of a frame; return the frame with its last piece, and else nothing.

        mark: PIECE_MARK or LAST_PIECE_MARK
        start: place of the piece in the frame, in bytes
        Raises ValueError for another mark, and for a piece without content.
        """
        if mark not in (PIECE_MARK, LAST_PIECE_MARK) or not content:
            raise ValueError("no packet of a frame")
        pieces = self.pieces
        if start == 0:
            pieces.clear()
        if start != len(pieces) or start > FRAME_FORMAT.max_bytes:
            pieces.clear()  # a piece before this one is lost
            return b""
        pieces += content
        if mark == PIECE_MARK:
            return b""
        frame = bytes(pieces)
        pieces.clear()
        return frame
