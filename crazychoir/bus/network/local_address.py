"""Where the processes of one host find each other: their sockets in the private folder of the user."""

import os
import socket
import struct
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Final

import msgspec

from crazychoir.files.private_folder import runtime_folder
from crazychoir.runtime.clock import date_and_time


@dataclass(frozen=True, slots=True)
class SocketFileRules:
    """How sockets lie in the folder, and when they are removed."""

    suffix: str = ".sock"
    """End of the name of a socket at which a process listens."""
    new_suffix: str = ".new"
    """End of the name of a socket at which a process does not listen yet."""
    new_time: float = 10.0
    """Seconds for which a socket is new: its process may be going to listen."""
    backlog: int = 128
    """Connections that may wait to be accepted."""


SOCKET_FILES = SocketFileRules()


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
    return runtime_folder() / f"{name}{SOCKET_FILES.suffix}"


def listen_at(path: Path) -> socket.socket:
    """Return a socket that listens at a path. Raises OSError if it cannot be made.

    The path appears when the socket listens already, so that `remove_stale_sockets` spares it.
    """
    hidden = path.with_suffix(SOCKET_FILES.new_suffix)
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        listening.setblocking(False)
        listening.bind(str(hidden))
        listening.listen(SOCKET_FILES.backlog)
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


def decode_identity(packet: bytes) -> LocalIdentity:
    """Return the identity that the first packet of a connection tells.

    Raises msgspec.MsgspecError for any other packet.
    """
    if packet[0] != IDENTITY_MARK:
        raise msgspec.DecodeError("no identity")
    return msgspec.msgpack.decode(packet[1:], type=LocalIdentity)


def remove_stale_sockets(folder: Path) -> None:
    """Remove the sockets of processes that ended without removing them.

    A new one is left alone, because it may belong to a process that is going to listen, or to one of
    many that start together: each of them would connect to all others to find out.
    """
    for suffix in (SOCKET_FILES.suffix, SOCKET_FILES.new_suffix):
        for path in folder.glob(f"*{suffix}"):
            if _age(path) > SOCKET_FILES.new_time and _is_abandoned(path):
                path.unlink(missing_ok=True)


def _is_abandoned(path: Path) -> bool:
    """Return True if no process listens at this socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as asking:
        asking.setblocking(False)
        try:
            asking.connect(str(path))
        except ConnectionRefusedError:
            return True
        except OSError:
            pass  # a process listens there, or it is no socket of ours
    return False


def _age(path: Path) -> float:
    """Return the seconds since a file was made; 0 if it is not there any more."""
    try:
        return date_and_time().timestamp() - path.lstat().st_mtime
    except FileNotFoundError:
        return 0.0


def read_user(connected: socket.socket) -> int:
    """Return the user id of the process at the other end of a connection."""
    raw = connected.getsockopt(
        socket.SOL_SOCKET, socket.SO_PEERCRED, PEER_CREDENTIALS.size
    )
    _, user, _ = PEER_CREDENTIALS.unpack(raw)
    return int(user)
