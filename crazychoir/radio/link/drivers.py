"""cflib's drivers, made ready once a process: links that may lose packets, that close at once, and whose errors stay
with whoever asks for them.
"""

import contextlib
import logging
import queue
import socket
import threading
from functools import cache
from typing import Any

import cflib.crtp
from cflib.crtp import radiodriver
from cflib.crtp.radiodriver import RadioDriver
from cflib.crtp.udpdriver import UdpDriver

from crazychoir.radio.link.dongles import DONGLES, Turns

ROOM = 0.05
"""s that a packet waits for room at most: a driver's queue holds one, which leaves with the next exchange."""
ENDS = 0.5
"""s that the thread of a link gets to end its last exchange."""


class LossyUdpDriver(UdpDriver):  # type: ignore[misc]
    """cflib's UDP link, asked to behave as one that loses packets.

    cflib's own counts on every datagram: it never asks again for an answer that does not come, and its thread looks
    once a second whether it is to end.
    """

    def __init__(self) -> None:
        super().__init__()
        self.needs_resending = True

    def connect(
        self, uri: str, radio_link_statistics_callback: Any, link_error_callback: Any
    ) -> None:
        """As cflib's."""
        super().connect(
            uri, radio_link_statistics_callback, link_error_callback or _ignored
        )

    def close(self) -> None:
        """Without waiting for either thread."""
        thread = self._thread
        waiting = self.in_queue
        if thread is not None:
            thread._sp = True
        at = self.socket
        if at is not None:
            with contextlib.suppress(OSError):
                at.shutdown(socket.SHUT_RDWR)
        if waiting is not None:
            waiting.put(None)
        super().close()


class Outbox(queue.Queue[Any]):
    """Room for the packet that leaves with the next exchange; a link with nothing to say waits here to listen."""

    def __init__(self, turns: Turns) -> None:
        super().__init__(1)
        self._turns = turns

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        """The packet; queue.Empty if there is none for as long as its drone need not be asked."""
        return super().get(True, self._turns.idle)


class PatientRadioDriver(RadioDriver):  # type: ignore[misc]
    """cflib's radio link, whose sender waits a short time for room, and is never called back with an error.

    cflib's own keeps who sends for 2 s when its air is full, then ends the link in that thread. Here who sends is told
    that there is no room; a drone that does not acknowledge is noticed by its silence, and its link goes on trying.
    """

    _radio: Any

    @property
    def needs_resending(self) -> bool:
        """Always: a packet for which there is no room is lost, acknowledgements or not."""
        return True

    @needs_resending.setter
    def needs_resending(self, needs: bool) -> None:
        """Not up to the thread."""

    def connect(
        self, uri: str, radio_link_statistics_callback: Any, link_error_callback: Any
    ) -> None:
        """As cflib's, by a dongle that is shared in our way."""
        super().connect(uri, radio_link_statistics_callback, _ignored)
        self.out_queue = self._thread._out_queue = Outbox(self._radio)

    def send_packet(self, pk: Any) -> bool:
        """Whether there was room for it in time."""
        try:
            self.out_queue.put(pk, timeout=ROOM)
        except queue.Full:
            return False
        return True

    def room(self) -> bool:
        """Whether there is, or is in time."""
        waiting: Outbox = self.out_queue
        with waiting.not_full:
            return waiting.not_full.wait_for(lambda: not waiting.queue, ROOM)

    def close(self) -> None:
        """Once its thread has ended, or has had the time to; nobody waits for packets any more."""
        thread = self._thread
        turns = self._radio
        if turns is not None:
            turns.ends = True
        if thread is not None:
            thread._sp = True
            if thread is not threading.current_thread():
                thread.join(ENDS)
        if turns is not None:
            turns.close()
        if self.in_queue is not None:
            self.in_queue.put(None)
        self._radio = None


def room(cf: Any) -> bool:
    """Whether a packet would leave soon; one that is closed has room, and whoever sends is told."""
    link = cf.link
    return link.room() if isinstance(link, PatientRadioDriver) else True


def _ignored(message: str) -> None:
    """An error of a link that nobody listens to."""


OURS = {UdpDriver: LossyUdpDriver, RadioDriver: PatientRadioDriver}


@cache
def ready() -> None:
    """Let cflib know its drivers, ours in place of its own; once a process, as cflib adds them at each call."""
    logging.getLogger("cflib").setLevel(
        logging.CRITICAL
    )  # what fails is said once, by who has asked for it
    cflib.crtp.init_drivers()
    radiodriver.RadioManager = DONGLES
    cflib.crtp.CLASSES[:] = [OURS.get(driver, driver) for driver in cflib.crtp.CLASSES]
