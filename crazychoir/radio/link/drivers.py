"""Replacements for cflib's link drivers, registered once in each process.

These links tolerate lost packets, close quickly, and report errors only to a caller that asks for
them.
"""

import contextlib
import logging
import queue
import socket
import threading
from dataclasses import dataclass
from functools import cache
from typing import Any

import cflib.crtp
from cflib.crtp import radiodriver
from cflib.crtp.radiodriver import RadioDriver
from cflib.crtp.udpdriver import UdpDriver

from crazychoir.radio.link.dongles import PROCESS_DONGLES, DongleShare


@dataclass(frozen=True, slots=True)
class DriverTiming:
    """How long a driver waits for room and for the end of its thread."""

    room_timeout: float = 0.05
    """s: longest time that a packet waits for room. A driver's queue holds one packet, which
    leaves with the next exchange.
    """
    thread_deadline: float = 0.5
    """s: time in which the thread of a link may end its last exchange."""


DRIVER_TIMING = DriverTiming()


class LossyUdpDriver(UdpDriver):  # type: ignore[misc]
    """cflib's UDP link, marked as a link that loses packets.

    cflib's own driver relies on every datagram: it never repeats an unanswered request. Its thread
    checks only once a second whether it must end.
    """

    def __init__(self) -> None:
        super().__init__()
        self.needs_resending = True

    def connect(
        self, uri: str, radio_link_statistics_callback: Any, link_error_callback: Any
    ) -> None:
        """Open the link as cflib does; errors without a callback are ignored."""
        super().connect(
            uri, radio_link_statistics_callback, link_error_callback or _ignore_error
        )

    def close(self) -> None:
        """Close the link without waiting for either thread."""
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
    """The queue of a radio link, with room for one packet, which leaves with the next exchange.

    While an idle link has nothing to send, its thread waits in `get` until it polls the drone again.
    """

    def __init__(self, turns: DongleShare) -> None:
        super().__init__(1)
        self._turns = turns

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        """Wait for a packet and return it; both arguments are ignored.

        Raises queue.Empty if none comes before the drone must be polled again.
        """
        return super().get(True, self._turns.idle)


class PatientRadioDriver(RadioDriver):  # type: ignore[misc]
    """cflib's radio link, with a short wait for room in its queue, and without error callbacks.

    If the queue of cflib's own driver stays full, the sender is blocked for 2 s, and then its thread
    ends the link. Here `send_packet` returns False instead. The link keeps trying to reach a drone
    that does not acknowledge; other code notices its silence.
    """

    _radio: Any

    @property
    def needs_resending(self) -> bool:
        """True: a packet without room is lost, even with acknowledgements."""
        return True

    @needs_resending.setter
    def needs_resending(self, needs: bool) -> None:
        """Ignore the value: cflib's thread must not change it."""

    def connect(
        self, uri: str, radio_link_statistics_callback: Any, link_error_callback: Any
    ) -> None:
        """Open the link as cflib does, on a shared dongle of this package."""
        super().connect(uri, radio_link_statistics_callback, _ignore_error)
        outbox = Outbox(self._radio)
        self._radio.has_more = lambda: bool(outbox.queue)
        self.out_queue = self._thread._out_queue = outbox

    def send_packet(self, pk: Any) -> bool:
        """Queue a packet; return whether there was room in time."""
        try:
            self.out_queue.put(pk, timeout=DRIVER_TIMING.room_timeout)
        except queue.Full:
            return False
        return True

    def room(self) -> bool:
        """Return whether there is room, now or within `DRIVER_TIMING.room_timeout`."""
        waiting: Outbox = self.out_queue
        with waiting.not_full:
            return waiting.not_full.wait_for(
                lambda: not waiting.queue, DRIVER_TIMING.room_timeout
            )

    def close(self) -> None:
        """End the thread of the link, then close the link.

        Waits for the thread for at most DRIVER_TIMING.thread_deadline s. A reader that waits for a
        packet gets None.
        """
        thread = self._thread
        turns = self._radio
        if turns is not None:
            turns.ends = True
        if thread is not None:
            thread._sp = True
            if thread is not threading.current_thread():
                thread.join(DRIVER_TIMING.thread_deadline)
        if turns is not None:
            turns.close()
        if self.in_queue is not None:
            self.in_queue.put(None)
        self._radio = None


def has_room(cf: Any) -> bool:
    """Return whether a packet that is sent now would leave soon.

    Returns True for a closed link, so that the sender tries to send and gets the error.
    """
    link = cf.link
    return link.room() if isinstance(link, PatientRadioDriver) else True


def _ignore_error(message: str) -> None:
    """Ignore an error of a link."""


DRIVER_REPLACEMENTS = {UdpDriver: LossyUdpDriver, RadioDriver: PatientRadioDriver}
"""Our driver in place of each of cflib's."""


@cache
def register_drivers() -> None:
    """Register cflib's drivers, with ours in place of its own.

    This is done once a process, because cflib adds its drivers again at each call.
    """
    # The caller reports each failure, once.
    logging.getLogger("cflib").setLevel(logging.CRITICAL)
    cflib.crtp.init_drivers()
    radiodriver.RadioManager = PROCESS_DONGLES
    cflib.crtp.CLASSES[:] = [
        DRIVER_REPLACEMENTS.get(driver, driver) for driver in cflib.crtp.CLASSES
    ]
