"""The connections of this process with the other processes of its host: one socket a pair.

They are AF_UNIX sockets of the kind SEQPACKET: each packet is one frame, or a piece of a large one,
and the event loop reads it without another thread. A packet tells when it was sent, by the clock of
the machine, so that a frame ages while it waits for its reader.

The folder of the sockets is private, and the system tells the user of each process that connects. A
process of another user is a stranger.

Of two processes, that with the lesser name connects. Its first packet tells its name. Frames to a
process that does not read wait for a while. Later ones are dropped and counted, and no other process
is disturbed.
"""

import asyncio
import contextlib
import logging
import os
import socket
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Final

import msgspec

from crazychoir.bus.frames import FRAME_FORMAT
from crazychoir.errors import ConfigError, error_text
from crazychoir.files.private_folder import runtime_folder
from crazychoir.runtime.clock import NS_PER_SECOND

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class LocalSocketLimits:
    """Sizes of the sockets between the processes of a host, and how they are read."""

    buffer_size: int = 1 << 20
    """Bytes that are asked for each direction of a connection; the system may grant less."""
    piece_size: int = 128 * 1024
    """Bytes of the pieces of a large frame, at most; a socket with a small buffer gets smaller ones."""
    slice_ns: int = NS_PER_SECOND // 500
    """ns: most time for reading all connections in one pass of the event loop.

    A frame that is being read is finished, and each connection may read one.
    """
    backlog: int = 128
    """Connections that may wait to be accepted."""
    most_waiting: int = 2 * FRAME_FORMAT.max_bytes
    """Most bytes of frames that may wait here until the socket to a process has room."""
    most_strangers: int = 32
    """Most connections that have not told their process yet."""


SOCKET_LIMITS = LocalSocketLimits()


PACKET_HEAD: Final = struct.Struct("<BIQ")
"""Start of a packet with a frame, or with a piece of one.

It holds a mark, the place of the piece in the frame in bytes, and the time of sending in ns.
"""
PIECE_MARK: Final = 0xF0
"""First byte of a packet with a piece of a frame that goes on."""
LAST_PIECE_MARK: Final = 0xF1
"""First byte of a packet with a whole frame, or with the last piece of one."""
IDENTITY_MARK: Final = 0xF2
"""First byte of the packet with the identity of the process that connects."""
PEER_CREDENTIALS: Final = struct.Struct("3i")
"""Process id, user id and group id of the other end of a connection."""


class LocalAddress(msgspec.Struct, frozen=True):
    """Where the processes of one host find this one; in its HELLO."""

    machine: str = ""
    """Boot and namespaces: equal for processes that may use sockets with each other."""
    path: str = ""
    """Path of the socket; empty if there is none."""


NO_LOCAL_ADDRESS: Final = LocalAddress()
"""Address of a process without a socket."""


class LocalIdentity(msgspec.Struct, frozen=True, array_like=True):
    """The process that connects: the first packet of a connection."""

    swarm: str
    """Name of the swarm."""
    process: str
    """Name of the process."""
    incarnation: int
    """64 random bits, drawn when the process started."""


def find_machine() -> str:
    """Return the boot, and the namespaces of the network and of the clock, of this process.

    Two network namespaces with one folder are two hosts, because between hosts other rules hold. The
    result is empty where the system does not tell.
    """
    try:
        boot = (
            Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        )
        network = os.stat("/proc/self/ns/net").st_ino
        clock = os.stat("/proc/self/ns/time").st_ino
    except OSError:
        return ""
    return f"{boot}/{network}/{clock}"


def find_socket_path(identity: LocalIdentity) -> Path:
    """Return the path of the socket of a process. Raises OSError without a private folder."""
    name = blake2b(repr(identity).encode(), digest_size=12).hexdigest()
    return runtime_folder() / f"{name}.sock"


@dataclass(eq=False, slots=True)
class LocalConnection:
    """The socket of one pair of processes, and the piece of a frame that has arrived."""

    socket: socket.socket
    """The socket, which never blocks."""
    piece_size: int
    """Bytes of the pieces of a large frame."""
    process: str = ""
    """Name of the other process; empty until it is known."""
    pieces: bytearray = field(default_factory=bytearray)
    """The pieces of a large frame that have arrived."""
    waiting: deque[bytes] = field(default_factory=deque)
    """Packets that wait until the socket has room."""
    waiting_size: int = 0
    """Bytes of the packets that wait."""
    path: str = ""
    """Path of the other process, if this one has connected."""


@dataclass(slots=True)
class SocketCounters:
    """Counts of what did not go or come."""

    broken: int = 0
    """Connections that ended with an error."""
    strangers: int = 0
    """Connections of another user, another swarm, or an unknown process."""
    malformed: int = 0
    """Packets that are neither a frame nor a piece of a frame."""


ReceiveFrame = Callable[[str, bytes, int], None]
"""Callable that gets (name of the sending process, frame, time of sending in ns)."""
IsKnown = Callable[[LocalIdentity], bool]
"""Callable that says if a process that connects is one of the peers."""


class LocalSockets:
    """The connections of one process; without any if it could not make its socket.

    identity: name and number of this process
    is_known: says which processes may connect
    now_ns: returns the time in ns, by the clock of the machine
    """

    def __init__(
        self, identity: LocalIdentity, is_known: IsKnown, now_ns: Callable[[], int]
    ) -> None:
        self.identity = identity
        self.address = NO_LOCAL_ADDRESS
        self.counters = SocketCounters()
        self._is_known = is_known
        self._now_ns = now_ns
        self._loop = asyncio.get_running_loop()
        self._receive: ReceiveFrame
        """Gets the frames, from `open` on: nothing arrives before."""
        self._listening: socket.socket | None = None
        self._strangers: dict[LocalConnection, None] = {}
        self._connections: dict[str, LocalConnection] = {}
        self._ending: dict[LocalConnection, None] = {}
        self._slice_ends_ns = 0

    # Opening and closing --------------------------------------------------------------

    def open(self, receive: ReceiveFrame) -> None:
        """Listen at a path of this process; without a socket, say why.

        receive: gets each frame
        """
        self._receive = receive
        machine = find_machine()
        try:
            if not machine:
                raise OSError("the system does not tell its boot and network namespace")
            path = find_socket_path(self.identity)
            remove_stale_sockets(path.parent)
            listening = listen_at(path)
        except (OSError, ConfigError) as error:
            log.info(
                "no local socket (%s): the processes of this host are reached over the network",
                error_text(error),
            )
            return
        self._listening = listening
        self.address = LocalAddress(machine, str(path))
        self._loop.add_reader(listening.fileno(), self._accept, listening)

    def close(self) -> None:
        """End all connections, and remove the path."""
        for connection in [
            *self._connections.values(),
            *self._strangers,
            *self._ending,
        ]:
            self._end(connection)
        self._stop_listening()

    def _stop_listening(self) -> None:
        """Take no further connection."""
        if self._listening is not None:
            self._loop.remove_reader(self._listening.fileno())
            self._listening.close()
            self._listening = None
            with contextlib.suppress(OSError):
                os.unlink(self.address.path)

    # Connecting -----------------------------------------------------------------------

    def reach(self, process: str, address: LocalAddress) -> None:
        """Connect to a process of this host, unless it is the other one's turn to connect.

        Call it again for another try: a process that does not listen is no error.
        """
        if not self._may_connect(process, address):
            return
        known = self._connections.get(process)
        if known is not None:
            if known.path == address.path:
                return
            self._end(known)  # a process of the same name has taken its place
        try:
            made = connect_to(Path(address.path), self.identity)
        except OSError as error:
            log.debug("no local connection to %s: %s", process, error_text(error))
            return
        connection = self._adopt(made)
        connection.process = process
        connection.path = address.path
        self._connections[process] = connection

    def _may_connect(self, process: str, address: LocalAddress) -> bool:
        """Return True if it is on us to connect to this process, at an address of our folder."""
        return (
            self._listening is not None
            and bool(address.path)
            and address.machine == self.address.machine
            and os.path.dirname(address.path) == os.path.dirname(self.address.path)
            and self.identity.process < process
        )

    def forget(self, process: str) -> None:
        """End the connection to a process that is no peer any more."""
        connection = self._connections.get(process)
        if connection is not None:
            self._end(connection)

    def _accept(self, listening: socket.socket) -> None:
        """Take a new connection of a process of this user."""
        try:
            made, _ = listening.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return
        except OSError as error:
            # For example too many open files: the connection would ask again and again.
            log.warning(
                "no further local sockets (%s): other processes of this host are reached over the network",
                error_text(error),
            )
            self._stop_listening()
            return
        made.setblocking(False)
        if read_user(made) != os.getuid():
            self.counters.strangers += 1
            made.close()
            return
        if len(self._strangers) >= SOCKET_LIMITS.most_strangers:
            self.counters.strangers += 1
            self._end(next(iter(self._strangers)))
        self._strangers[self._adopt(made)] = None

    def _adopt(self, made: socket.socket) -> LocalConnection:
        """Set up the buffers of a connection, and read it from now on."""
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            made.setsockopt(socket.SOL_SOCKET, option, SOCKET_LIMITS.buffer_size)
        granted = made.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF)
        # The system counts its own records too: a packet may have at most about half of the buffer.
        piece_size = min(SOCKET_LIMITS.piece_size, granted // 4)
        connection = LocalConnection(made, piece_size)
        self._loop.add_reader(made.fileno(), self._read, connection)
        return connection

    def _end(self, connection: LocalConnection) -> None:
        """Close a connection."""
        self._strangers.pop(connection, None)
        self._ending.pop(connection, None)
        if self._connections.get(connection.process) is connection:
            del self._connections[connection.process]
        self._loop.remove_reader(connection.socket.fileno())
        self._loop.remove_writer(connection.socket.fileno())
        connection.socket.close()

    # Sending --------------------------------------------------------------------------

    def is_connected(self, process: str) -> bool:
        """Return True if frames to this process may go through a socket."""
        return process in self._connections

    def send(self, process: str, frame: bytes) -> bool:
        """Send a frame to a connected process, a large one in pieces.

        What does not fit into the socket waits here. If too much waits already, because the process
        does not read fast enough, the frame is dropped.
        Returns True unless it was dropped.
        """
        connection = self._connections[process]
        size = connection.piece_size
        now_ns = self._now_ns()
        is_idle = not connection.waiting
        if (
            connection.waiting_size
            and connection.waiting_size + len(frame) > SOCKET_LIMITS.most_waiting
        ):
            return False
        for start in range(0, len(frame), size):
            is_last = start + size >= len(frame)
            mark = LAST_PIECE_MARK if is_last else PIECE_MARK
            packet = PACKET_HEAD.pack(mark, start, now_ns) + frame[start : start + size]
            connection.waiting.append(packet)
            connection.waiting_size += len(packet)
        if is_idle:
            self._write(connection)
            if connection.waiting:
                self._loop.add_writer(
                    connection.socket.fileno(), self._write, connection
                )
        return True

    def _write(self, connection: LocalConnection) -> None:
        """Send the packets that wait, as many as have room."""
        waiting = connection.waiting
        try:
            while waiting:
                connection.socket.send(waiting[0], socket.MSG_NOSIGNAL)
                connection.waiting_size -= len(waiting.popleft())
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self.counters.broken += 1
            self._give_up(connection)
        self._loop.remove_writer(connection.socket.fileno())

    def _give_up(self, connection: LocalConnection) -> None:
        """Send no more; read what has arrived, until the end of the connection."""
        connection.waiting.clear()
        connection.waiting_size = 0
        if self._connections.get(connection.process) is connection:
            del self._connections[connection.process]
        self._ending[connection] = None
        with contextlib.suppress(OSError):
            connection.socket.shutdown(socket.SHUT_WR)

    # Receiving ------------------------------------------------------------------------

    def _read(self, connection: LocalConnection) -> None:
        """Read some packets of a connection; the next pass reads on."""
        if not self._slice_ends_ns:
            self._slice_ends_ns = self._now_ns() + SOCKET_LIMITS.slice_ns
            self._loop.call_soon(self._end_slice)
        ends_ns = self._slice_ends_ns
        while True:
            try:
                packet = connection.socket.recv(SOCKET_LIMITS.buffer_size)
            except (BlockingIOError, InterruptedError):
                return
            except ConnectionResetError:
                # The other process ended, and has not read all frames. Its own still wait here.
                self.counters.broken += 1
                continue
            except OSError:
                self.counters.broken += 1
                packet = b""
            if not packet:
                self._end(connection)
                return
            self._take(connection, packet)
            if connection.socket.fileno() < 0 or self._now_ns() > ends_ns:
                return

    def _end_slice(self) -> None:
        """Let the next pass of the event loop read for a whole slice again."""
        self._slice_ends_ns = 0

    def _take(self, connection: LocalConnection, packet: bytes) -> None:
        """Take a packet: a frame, a piece of a frame, or an identity."""
        if not connection.process:
            self._introduce(connection, packet)
        elif packet[0] in (PIECE_MARK, LAST_PIECE_MARK):
            self._take_piece(connection, packet)
        else:
            self.counters.malformed += 1

    def _introduce(self, connection: LocalConnection, packet: bytes) -> None:
        """Learn which process has connected; close the connection of a stranger."""
        self._strangers.pop(connection, None)
        try:
            if packet[0] != IDENTITY_MARK:
                raise msgspec.DecodeError("no identity")
            identity = msgspec.msgpack.decode(packet[1:], type=LocalIdentity)
        except msgspec.MsgspecError:
            self.counters.malformed += 1
            self._end(connection)
            return
        if identity.swarm != self.identity.swarm or not self._is_known(identity):
            self.counters.strangers += 1
            self._end(connection)
            return
        self.forget(identity.process)
        connection.process = identity.process
        self._connections[identity.process] = connection

    def _take_piece(self, connection: LocalConnection, packet: bytes) -> None:
        """Take a whole frame, or a piece of one; take the frame with its last piece."""
        if len(packet) <= PACKET_HEAD.size:
            self.counters.malformed += 1
            return
        mark, start, sent_ns = PACKET_HEAD.unpack_from(packet)
        content = packet[PACKET_HEAD.size :]
        if mark == LAST_PIECE_MARK and start == 0:
            connection.pieces.clear()
            self._receive(connection.process, content, sent_ns)
            return
        pieces = connection.pieces
        if start == 0:
            pieces.clear()
        if start != len(pieces) or start > FRAME_FORMAT.max_bytes:
            pieces.clear()  # a piece before this one is lost
            return
        pieces += content
        if mark == LAST_PIECE_MARK:
            frame = bytes(pieces)
            pieces.clear()
            self._receive(connection.process, frame, sent_ns)


def listen_at(path: Path) -> socket.socket:
    """Return a socket that listens at a path. Raises OSError if it cannot be made.

    The path appears when the socket listens already, so that `remove_stale_sockets` spares it.
    """
    hidden = path.with_suffix(".new")
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        listening.setblocking(False)
        listening.bind(str(hidden))
        listening.listen(SOCKET_LIMITS.backlog)
        os.rename(hidden, path)
    except OSError:
        listening.close()
        hidden.unlink(missing_ok=True)
        raise
    return listening


def connect_to(path: Path, identity: LocalIdentity) -> socket.socket:
    """Return a socket that is connected to the process at a path, and has told the identity of this one.

    Raises OSError if no process listens there, or a process of another user.
    """
    made = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        made.setblocking(False)
        made.connect(str(path))
        if read_user(made) != os.getuid():
            raise PermissionError("the socket belongs to another user")
        made.send(bytes([IDENTITY_MARK]) + msgspec.msgpack.encode(identity))
    except OSError:
        made.close()
        raise
    return made


def remove_stale_sockets(folder: Path) -> None:
    """Remove the sockets of processes that ended without removing them."""
    for path in folder.glob("*.sock"):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as asking:
            asking.setblocking(False)
            try:
                asking.connect(str(path))
            except ConnectionRefusedError:
                path.unlink(missing_ok=True)
            except OSError:
                continue  # a process listens there, or it is no socket of ours


def read_user(connected: socket.socket) -> int:
    """Return the user id of the process at the other end of a connection."""
    raw = connected.getsockopt(
        socket.SOL_SOCKET, socket.SO_PEERCRED, PEER_CREDENTIALS.size
    )
    _, user, _ = PEER_CREDENTIALS.unpack(raw)
    return int(user)
