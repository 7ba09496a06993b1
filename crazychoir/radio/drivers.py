"""cflib's drivers, made ready once a process: UDP as a link that may lose packets, and that closes at once."""

import contextlib
import logging
import socket
from functools import cache
from typing import Any

import cflib.crtp
from cflib.crtp.udpdriver import UdpDriver


class LossyUdpDriver(UdpDriver):  # type: ignore[misc]
    """cflib's UDP link, asked to behave as one that loses packets.

    cflib's own counts on every datagram: it never asks again for an answer that does not come, and its thread looks
    once a second whether it is to end.
    """

    def __init__(self) -> None:
        super().__init__()
        self.needs_resending = True

    def connect(self, uri: str, radio_link_statistics_callback: Any, link_error_callback: Any) -> None:
        """As cflib's."""
        super().connect(uri, radio_link_statistics_callback, link_error_callback or _ignored)

    def close(self) -> None:
        """Without waiting for either thread."""
        thread, waiting = self._thread, self.in_queue
        if thread is not None:
            thread._sp = True
        at = self.socket
        if at is not None:
            with contextlib.suppress(OSError):
                at.shutdown(socket.SHUT_RDWR)
        if waiting is not None:
            waiting.put(None)
        super().close()


def _ignored(message: str) -> None:
    """An error of a link that nobody listens to."""


@cache
def ready() -> None:
    """Let cflib know its drivers, ours in place of its UDP driver; once a process, as cflib adds them at each call."""
    logging.getLogger("cflib").setLevel(logging.CRITICAL)  # what fails is said once, by who has asked for it
    cflib.crtp.init_drivers()
    drivers = cflib.crtp.CLASSES
    drivers[drivers.index(UdpDriver)] = LossyUdpDriver
