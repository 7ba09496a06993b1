"""Crazyradio dongles, each shared by the links of this process.

The links take turns, in the threads of their drivers. cflib's own sharing has a thread for each
dongle, which dies of a USB error, or does not notice that no link reads its answers any more; the
links then wait for ever. Here such an error is kept, and reported with the dongle.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from cflib.crtp import radiodriver

from crazychoir.errors import LinkFailed, error_text

PLUG_ADVICE = "Plug a Crazyradio in, let your user open it (Bitcraze's udev rules), and end other programs that use it."
"""Advice for a missing dongle."""


@dataclass(frozen=True, slots=True)
class DonglePacing:
    """How often a dongle and its idle links ask again."""

    retry_pause: float = 0.05
    """s: time until a dongle that has not answered is asked again."""
    answer_time: float = 0.002
    """s: time for this process to answer a drone's packet, before the drone is asked for more.
    """
    first_pause: float = 0.005
    """s: time until an idle link asks its drone again after the first request without data. The
    time doubles with each further one, up to `longest_pause` times the links of the dongle.
    cflib asks again at once, and takes time from the other links.
    """
    longest_pause: float = 0.01
    """s for each link of the dongle: limit of that time."""
    missed_limit: int = 5
    """Packets in a row without an acknowledgement, after which the link sends more rarely too.
    """


DONGLE_PACING = DonglePacing()


@dataclass(frozen=True, slots=True)
class SafelinkBytes:
    """The bytes of safelink, which counts packets both ways."""

    start_packet: tuple[int, ...] = (0xFF, 0x05, 0x01)
    """First packet of a link. It switches on a count of packets both ways, so that none is lost or
    taken twice.
    """
    null_header: int = 0xF3
    """Header of an empty packet, apart from the two bits of safelink."""


SAFELINK_BYTES = SafelinkBytes()


class DongleFailed(LinkFailed):
    """The dongle of a link is missing or was removed: every other link of it fails too."""


class Dongle:
    """One Crazyradio, opened by the constructor. Raises the errors of cflib.

    number: number of the dongle
    failed: called with the USB error when the dongle stops answering
    """

    def __init__(self, number: int, failed: Callable[[str], None]) -> None:
        self._radio = radiodriver.Crazyradio(devid=number)
        self.version: float = self._radio.version
        self.links = 0
        """Links that use this dongle."""
        self.over = False
        """True once the dongle has failed or is closed."""
        self._failed = failed
        self._guard, self._waiting = threading.Lock(), deque[threading.Lock]()
        self._never = threading.Event()

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        """Wait for the dongle, first come, first served."""
        mine = threading.Lock()
        mine.acquire()
        with self._guard:
            self._waiting.append(mine)
            if len(self._waiting) == 1:
                mine.release()
        with mine:
            try:
                yield
            finally:
                with self._guard:
                    self._waiting.popleft()
                    if self._waiting:
                        self._waiting[0].release()

    def exchange(
        self, channel: int, address: bytes, rate: int, data: Sequence[int]
    ) -> Any:
        """Send a packet to a drone and return cflib's acknowledgement.

        Returns None if the dongle does not answer.
        """
        with self._turn():
            answer = self._use(
                lambda radio: _exchange_packet(radio, channel, address, rate, data)
            )
            if answer is None:
                # cflib hides the errors of packets; this request shows them.
                self._use(lambda radio: radio.set_arc(radio.arc))
        if answer is None:
            self._never.wait(DONGLE_PACING.retry_pause)
        return answer

    def set_arc(self, retries: int) -> None:
        """Set how often the dongle itself sends an unacknowledged packet again."""
        with self._turn():
            self._use(lambda radio: radio.set_arc(retries))

    def _use(self, does: Callable[[Any], Any]) -> Any:
        if self.over:
            return None
        try:
            return does(self._radio)
        except Exception as error:  # noqa: BLE001 - any USB error must free the waiting links
            self.over = True
            self._failed(error_text(error))

    def close(self) -> None:
        """Close the dongle after its last link."""
        with self._turn():
            self.over = True
            with contextlib.suppress(Exception):  # the dongle was unplugged
                self._radio.close()


def _exchange_packet(
    radio: Any, channel: int, address: bytes, rate: int, data: Sequence[int]
) -> Any:
    radio.set_channel(channel)
    radio.set_address(address)
    radio.set_data_rate(rate)
    return radio.send_packet(data)


class DongleShare:
    """One link's share of a dongle, in the form of the radio that cflib's driver expects.

    closed: called when the link is closed
    """

    def __init__(self, dongle: Dongle, closed: Callable[[], None]) -> None:
        self.version = dongle.version
        self._dongle = dongle
        self._closed = closed
        self._channel = 2
        self._address = bytes(5)
        self._rate = radiodriver.Crazyradio.DR_2MPS
        self._open = True
        self._heard = False
        self._vain = 0
        self._missed = 0
        self.ends = False
        """True once the link is about to be closed."""
        self._never = threading.Event()

    def set_channel(self, channel: int) -> None:
        """Set the channel of the next packets."""
        self._channel = channel

    def set_address(self, address: Sequence[int]) -> None:
        """Set the address of the next packets."""
        self._address = bytes(address)

    def set_data_rate(self, rate: int) -> None:
        """Set the data rate of the next packets."""
        self._rate = rate

    def set_arc(self, retries: int) -> None:
        """Set the retransmissions of the dongle, for all links."""
        self._dongle.set_arc(retries)

    def send_packet(self, data: Sequence[int]) -> Any:
        """Do one exchange in turn; return None if there is none.

        cflib asks for safelink ten times. A drone may still count packets of an earlier link, and
        come within reach only after that; it would take each new packet for a repeated one. So
        safelink is asked for until the drone acknowledges it.
        """
        answer = self._exchanged(data)
        while (
            tuple(data) == SAFELINK_BYTES.start_packet
            and not (answer and answer.ack)
            and self._open
            and not self.ends
        ):
            answer = self._exchanged(data)
        return answer

    def _exchanged(self, data: Sequence[int]) -> Any:
        if not self._open:
            return None
        answer = self._dongle.exchange(self._channel, self._address, self._rate, data)
        if answer is not None:
            self._heard = not _is_empty(answer.data)
            self._vain = 0 if self._heard or not _is_empty(data) else self._vain + 1
            self._missed = 0 if answer.ack else self._missed + 1
            if self._missed > DONGLE_PACING.missed_limit:
                self._never.wait(self._longest)
        return answer

    @property
    def idle(self) -> float:
        """Seconds for which the drone need not be asked, unless there is a packet to send."""
        if self._vain == 0:
            return DONGLE_PACING.answer_time if self._heard else 0.0
        return min(
            DONGLE_PACING.first_pause
            * 2.0 ** min(self._vain - 1, DONGLE_PACING.missed_limit),
            self._longest,
        )

    @property
    def _longest(self) -> float:
        return DONGLE_PACING.longest_pause * self._dongle.links

    def close(self) -> None:
        """End this link's share."""
        if self._open:
            self._open = False
            self._closed()


def _is_empty(data: Sequence[int]) -> bool:
    return (
        not len(data)
        or data[0] & SAFELINK_BYTES.null_header == SAFELINK_BYTES.null_header
    )


class DonglePool:
    """The dongles of this process by number, and why one cannot be used."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[int, Dongle] = {}
        self._why: dict[int, str] = {}

    def open(self, number: int) -> DongleShare:
        """Return a link's share of a dongle, which is opened for its first link.

        Raises the errors of cflib.
        """
        with self._lock:
            dongle = self._open.get(number)
            if dongle is None or dongle.over:
                dongle = self._open[number] = self._opened(number)
            dongle.links += 1
        return DongleShare(dongle, lambda: self._leave(number, dongle))

    def _opened(self, number: int) -> Dongle:
        try:
            dongle = Dongle(
                number,
                lambda why: self._fails(
                    number, f"{why}. It was pulled out, or has no power"
                ),
            )
        except Exception as error:
            self._fails(number, f"{error}. {PLUG_ADVICE}")
            raise
        self._why.pop(number, None)
        return dongle

    def _fails(self, number: int, why: str) -> None:
        self._why[number] = why

    def _leave(self, number: int, dongle: Dongle) -> None:
        with self._lock:
            dongle.links -= 1
            if dongle.links == 0:
                dongle.close()
                if self._open.get(number) is dongle:
                    del self._open[number]

    def failure(self, uri: str) -> str:
        """Return why the dongle of this uri cannot be used.

        The text is empty if the dongle can be used, or was not opened yet.
        """
        number = uri.removeprefix("radio://").partition("/")[0]
        return (
            self._why.get(int(number), "")
            if uri.startswith("radio://") and number.isdigit()
            else ""
        )


PROCESS_DONGLES = DonglePool()
"""The dongles of this process."""
