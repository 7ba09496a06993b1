"""The right to use a dongle, for one process of this machine at a time.

The process holds a lock, which is released when it ends. The lock is the name of a Unix socket in
the abstract namespace of Linux. The name is the same for all users and in every environment (a
login shell, cron, `sudo`, a service with folders of its own), and there is no file that could be
taken, removed or left behind. The kernel tells which process holds it. Like the addresses of
virtual drones it belongs to a network namespace; if two namespaces have the same Crazyradio, the
kernel lets one process claim the device.
"""

import contextlib
import hashlib
import os
import re
import socket
import struct
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.files.user_folders import user_name


@dataclass(frozen=True, slots=True)
class LandAdvice:
    """Advice about the drones of the process that owns a dongle."""

    same_user: str = (
        "and may fly drones: land them first (Ctrl-C there, or `crazychoir land`)"
    )
    """Advice about drones of a process of the same user."""
    other_user: str = (
        "and may fly drones: that user, or root, must land them first (Ctrl-C "
        "there, or `crazychoir land`)"
    )
    """Advice about drones of a process of another user."""


LAND_ADVICE = LandAdvice()


LOCK_PREFIX = "crazychoir-"
"""Start of the name of each lock."""


@dataclass(frozen=True, slots=True)
class LockLimits:
    """Sizes and times of the locks of dongles."""

    longest_name: int = 107
    """Bytes of a name, after the zero byte that makes it abstract."""
    answer_timeout: float = 0.5
    """s: time for the owner to tell its swarm; a stopped process does not answer."""
    answer_size: int = 256
    """Most bytes of that answer."""


LOCK_LIMITS = LockLimits()


PEER_CREDENTIALS = struct.Struct("3i")  # process, user and group, from the kernel


@contextlib.contextmanager
def own_dongle(config: SwarmConfig, dongle: int) -> Iterator[None]:
    """Own a dongle inside this context; for virtual drones, own their addresses.

    Raises Refused while another process owns them.
    """
    with contextlib.ExitStack() as kept:
        for name in _lock_names(config, dongle):
            kept.enter_context(_hold_lock(name, dongle, config.name))
        yield


def require_free(config: SwarmConfig, dongles: Iterable[int]) -> None:
    """Raise Refused while another process owns one of these dongles.

    Call it before anything is started that needs them.
    """
    for dongle in dongles:
        for name in _lock_names(config, dongle):
            owner = _describe_owner(name)
            if owner is not None:
                raise Refused(f"dongle {dongle}", owner)


def _lock_names(config: SwarmConfig, dongle: int) -> list[str]:
    """Return the names of a dongle's locks, in an order that all processes use."""
    uris = [config.drone(i).uri for i in config.topology.dongles[dongle]]
    names = {
        f"dongle-{uri.split('/')[2]}" if uri.startswith("radio") else uri
        for uri in uris
    }
    return sorted(names)


def _lock_address(name: str) -> bytes:
    """Return the abstract name of a lock."""
    text = f"{LOCK_PREFIX}{name}".encode()
    if len(text) > LOCK_LIMITS.longest_name:
        text = (
            f"{LOCK_PREFIX}{hashlib.blake2b(text, digest_size=16).hexdigest()}".encode()
        )
    return b"\0" + text


@contextlib.contextmanager
def _hold_lock(name: str, dongle: int, swarm: str) -> Iterator[None]:
    """Hold the lock inside this context.

    swarm: name that other processes receive
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as lock:
        try:
            lock.bind(_lock_address(name))
        except OSError as error:
            found = (
                _describe_owner(name)
                or f"it cannot be locked ({error.strerror or error})"
            )
            raise Refused(f"dongle {dongle}", found) from None
        lock.listen()
        answering = threading.Thread(
            target=_answer_requests,
            args=(lock, swarm.encode()),
            name=f"lock {name}",
            daemon=True,
        )
        answering.start()
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                # Ends the wait of the thread, which keeps the name.
                lock.shutdown(socket.SHUT_RDWR)
            answering.join()


def _answer_requests(lock: socket.socket, swarm: bytes) -> None:
    """Send the name of the swarm to each asking process, until the lock is released."""
    with contextlib.suppress(OSError):
        while True:
            asking, _ = lock.accept()
            with asking, contextlib.suppress(OSError):
                asking.sendall(swarm)


def _describe_owner(name: str) -> str | None:
    """Return which process holds a lock and what to do; None if no process does."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(LOCK_LIMITS.answer_timeout)
        try:
            asking.connect(_lock_address(name))
        except ConnectionRefusedError:
            return None
        except OSError:  # too many processes ask at once
            return f"another process has it, {LAND_ADVICE.same_user}"
        process, user, _ = PEER_CREDENTIALS.unpack(
            asking.getsockopt(
                socket.SOL_SOCKET, socket.SO_PEERCRED, PEER_CREDENTIALS.size
            )
        )
        try:
            said = asking.recv(LOCK_LIMITS.answer_size).decode(errors="replace")
        except OSError:
            said = ""
    swarm = f" (swarm {said})" if re.fullmatch(r"[\w.-]+", said) else ""
    if user == os.getuid():
        return f"process {process or '?'}{swarm} has it, {LAND_ADVICE.same_user}"
    return f"process {process or '?'}{swarm} of {user_name(user)} has it, {LAND_ADVICE.other_user}"
