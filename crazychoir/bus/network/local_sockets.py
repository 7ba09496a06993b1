"""The connections of this process with the other processes of its host: one socket a pair.

They are AF_UNIX sockets of the kind SEQPACKET, and the event loop reads them without another thread.

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
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.local_address import (
    NO_LOCAL_ADDRESS,
    LocalAddress,
    LocalIdentity,
    connect_to,
    decode_identity,
    find_machine,
    find_socket_path,
    listen_at,
    read_user,
    remove_stale_sockets,
)
from crazychoir.bus.network.local_connection import (
    LARGEST_PACKET,
    LAST_PIECE_MARK,
    PACKET_HEAD,
    LocalConnection,
)
from crazychoir.bus.topics import MessageClass
from crazychoir.errors import ConfigError, error_text

log = logging.getLogger(__name__)


MOST_STRANGERS: Final = 32
"""Most connections that have not told their process yet."""


ReceiveFrame = Callable[[str, bytes, int], None]
"""Callable that gets (name of the sending process, frame, time of sending in ns)."""
IsKnown = Callable[[LocalIdentity], bool]
"""Callable that says if a process that connects is one of the peers."""


class LocalSockets:
    """The connections of one process; without any if it could not make its socket.

    identity: name and number of this process
    is_known: says which processes may connect
    counters: gets the numbers of strangers, and of what did not go or come
    now_ns: returns the time in ns, by the clock of the machine

    Attributes:
    connections: {process: connection} of the processes that frames may go to. Only to be read from
        outside
    """

    def __init__(
        self,
        identity: LocalIdentity,
        is_known: IsKnown,
        counters: LinkCounters,
        now_ns: Callable[[], int],
    ) -> None:
        self.identity = identity
        self.address = NO_LOCAL_ADDRESS
        self._is_known = is_known
        self._counters = counters
        self._now_ns = now_ns
        self._loop = asyncio.get_running_loop()
        self._receive: ReceiveFrame
        """Gets the frames, from `open` on: nothing arrives before."""
        self._listening: socket.socket | None = None
        self._strangers: dict[LocalConnection, None] = {}
        self.connections: dict[str, LocalConnection] = {}
        self._ending: dict[LocalConnection, None] = {}

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
            *self.connections.values(),
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
        known = self.connections.get(process)
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
        self.connections[process] = connection

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
        connection = self.connections.get(process)
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
        if read_user(made) != os.getuid():
            self._counters.strangers += 1
            made.close()
            return
        if len(self._strangers) >= MOST_STRANGERS:
            self._counters.strangers += 1
            self._end(next(iter(self._strangers)))
        self._strangers[self._adopt(made)] = None

    def _adopt(self, made: socket.socket) -> LocalConnection:
        """Read a connected socket from now on."""
        connection = LocalConnection(made, self._now_ns)
        self._loop.add_reader(made.fileno(), self._read, connection)
        return connection

    def _end(self, connection: LocalConnection) -> None:
        """Close a connection."""
        self._strangers.pop(connection, None)
        self._ending.pop(connection, None)
        if self.connections.get(connection.process) is connection:
            del self.connections[connection.process]
        self._loop.remove_reader(connection.socket.fileno())
        self._loop.remove_writer(connection.socket.fileno())
        connection.socket.close()

    # Sending --------------------------------------------------------------------------

    def send(self, process: str, klass: MessageClass, frame: bytes) -> bool:
        """Send a frame that did not go at once to a connected process, a large one in pieces.

        What does not fit into the socket waits. If too much waits already, because the process does
        not read fast enough, the frame is dropped, or older ones of the class CONTROL.
        Returns True unless the frame was dropped.
        """
        connection = self.connections[process]
        was_full = connection.leaving is not None
        try:
            dropped = connection.send(klass, frame)
        except OSError:
            self._give_up(connection)
            return False
        if dropped:
            self._counters.full += dropped
            return klass is MessageClass.CONTROL
        if connection.leaving is not None and not was_full:
            self._loop.add_writer(connection.socket.fileno(), self._write, connection)
        return True

    def _write(self, connection: LocalConnection) -> None:
        """Send the frames that wait, as many as have room."""
        try:
            connection.send_waiting()
        except OSError:
            self._give_up(connection)
        if connection.leaving is None:
            self._loop.remove_writer(connection.socket.fileno())

    def _give_up(self, connection: LocalConnection) -> None:
        """Send no more; read what has arrived, until the end of the connection."""
        self._counters.broken += 1
        connection.drop_waiting()
        if self.connections.get(connection.process) is connection:
            del self.connections[connection.process]
        self._ending[connection] = None
        with contextlib.suppress(OSError):
            connection.socket.shutdown(socket.SHUT_WR)

    # Receiving ------------------------------------------------------------------------

    def _read(self, connection: LocalConnection) -> None:
        """Read one packet of a connection; the next pass of the event loop reads on.

        So no process delays the others, however much it sends.
        """
        try:
            packet = connection.socket.recv(LARGEST_PACKET)
        except (BlockingIOError, InterruptedError):
            return
        except ConnectionResetError:
            # The other process ended, and has not read all frames. Its own still wait here.
            if connection not in self._ending:
                self._give_up(connection)
            # uvloop no longer watches a socket that had an error.
            self._loop.remove_reader(connection.socket.fileno())
            self._loop.add_reader(connection.socket.fileno(), self._read, connection)
            return
        except OSError:
            self._counters.broken += 1
            packet = b""
        if not packet:
            self._end(connection)
            return
        if not connection.process:
            self._introduce(connection, packet)
            return
        try:
            mark, start, sent_ns = PACKET_HEAD.unpack_from(packet)
            frame = packet[PACKET_HEAD.size :]
            if mark != LAST_PIECE_MARK or start or connection.pieces or not frame:
                frame = connection.join_piece(mark, start, frame)
        except (struct.error, ValueError):
            self._counters.malformed += 1
            return
        if frame:
            self._receive(connection.process, frame, sent_ns)

    def _introduce(self, connection: LocalConnection, packet: bytes) -> None:
        """Learn which process has connected; close the connection of a stranger."""
        self._strangers.pop(connection, None)
        try:
            identity = decode_identity(packet)
        except msgspec.MsgspecError:
            self._counters.malformed += 1
            self._end(connection)
            return
        if identity.swarm != self.identity.swarm or not self._is_known(identity):
            self._counters.strangers += 1
            self._end(connection)
            return
        self.forget(identity.process)
        connection.process = identity.process
        self.connections[identity.process] = connection
