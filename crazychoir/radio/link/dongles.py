"""Crazyradio dongles, each shared by the links of this process.

The links take turns, in the threads of their drivers. cflib's own sharing has a thread for each
dongle, which dies of a USB error, or does not notice that no link reads its answers any more; the
links then wait for ever. Here such an error is kept, and reported with the dongle.
"""

import contextlib
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from cflib.crtp import radiodriver

from crazychoir.errors import LinkFailed, error_text
from crazychoir.radio.link.dongle_radio import DongleRadio
from crazychoir.radio.link.turns import DongleTurns
from crazychoir.radio.protocol.crtp import PACKET_FORMS

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
    longest_inline_pause: float = 0.003
    """The same, for a dongle that takes its settings with each packet: its polls take less time."""
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


EMERGENCY_HEADS = tuple(
    bytes([form.port << 4 | form.channel]) + form.head
    for form in (PACKET_FORMS["emergency_stop"], PACKET_FORMS["supervisor_stop"])
)
"""First two bytes of the packets that stop the motors for good, without the bits of safelink."""


class DongleFailed(LinkFailed):
    """The dongle of a link is missing or was removed: every other link of it fails too."""


class Dongle:
    """One Crazyradio, opened by the constructor. Raises the errors of cflib.

    number: number of the dongle
    failed: called with the USB error when the dongle stops answering
    """

    def __init__(self, number: int, failed: Callable[[str], None]) -> None:
        self._radio = DongleRadio(number)
        self.version = self._radio.version
        self.is_inline = self._radio.is_inline
        """Whether the dongle takes its settings with each packet."""
        self.links = 0
        """Links that use this dongle."""
        self.over = False
        """True once the dongle has failed or is closed."""
        self._failed = failed
        self.turns = DongleTurns()
        """Turns of the links."""
        self._never = threading.Event()

    def exchange(
        self,
        link: "DongleShare",
        channel: int,
        address: bytes,
        rate: int,
        data: Sequence[int],
    ) -> Any:
        """Send a packet of a link to its drone and return the acknowledgement.

        Returns None if the dongle does not answer.
        """
        with self.turns.take(link, first=is_emergency(data)):
            answer = self._use(
                lambda radio: radio.exchange(channel, address, rate, data)
            )
            if answer is None:
                # Errors of packets are hidden; this request shows them.
                self._use(lambda radio: radio.check())
            elif self._may_go_on(link, answer):
                self.turns.hold(link)
        if answer is None:
            self._never.wait(DONGLE_PACING.retry_pause)
        return answer

    def _may_go_on(self, link: "DongleShare", answer: Any) -> bool:
        """Return whether a visit is longer than this packet: it saves the time to come back to the drone."""
        has_more = link.has_more() or not _is_empty(answer.data)
        return has_more and bool(answer.ack) and not self.is_inline

    def broadcast(self, channel: int, rate: int, packets: Sequence[bytes]) -> None:
        """Send packets to all drones of a channel and data rate, before the packets that wait."""
        with self.turns.take(self, first=True):
            self._use(lambda radio: radio.broadcast(channel, rate, packets))

    def set_arc(self, retries: int) -> None:
        """Set how often the dongle itself sends an unacknowledged packet again."""
        with self.turns.take(self):
            self._use(lambda radio: radio.set_arc(retries))

    def _use(self, does: Callable[[DongleRadio], Any]) -> Any:
        if self.over:
            return None
        try:
            return does(self._radio)
        except Exception as error:  # noqa: BLE001 - any USB error must free the waiting links
            self.over = True
            self._failed(error_text(error))

    def close(self) -> None:
        """Close the dongle after its last link."""
        with self.turns.take(self):
            self.over = True
            with contextlib.suppress(Exception):  # the dongle was unplugged
                self._radio.close()


def is_emergency(data: Sequence[int]) -> bool:
    """Return whether a packet stops the motors for good."""
    # Without the two bits of safelink.
    head = bytes([data[0] & SAFELINK_BYTES.null_header, *data[1:2]])
    return head in EMERGENCY_HEADS


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
        self.has_more: Callable[[], bool] = lambda: False
        """Return whether another packet of this link waits."""
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
        answer = self._dongle.exchange(
            self, self._channel, self._address, self._rate, data
        )
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
        if self._dongle.turns.is_visiting(self):
            return 0.0
        if self._vain == 0:
            return DONGLE_PACING.answer_time if self._heard else 0.0
        return min(
            DONGLE_PACING.first_pause
            * 2.0 ** min(self._vain - 1, DONGLE_PACING.missed_limit),
            self._longest,
        )

    @property
    def _longest(self) -> float:
        each = (
            DONGLE_PACING.longest_inline_pause
            if self._dongle.is_inline
            else DONGLE_PACING.longest_pause
        )
        return each * self._dongle.links

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

    def find(self, number: int) -> Dongle | None:
        """Return an open dongle; None if no link uses it, or it has failed."""
        with self._lock:
            dongle = self._open.get(number)
        return None if dongle is None or dongle.over else dongle

    def is_inline(self, uri: str) -> bool | None:
        """Return whether the open dongle of this uri takes its settings with each packet; None without one."""
        number = _dongle_number(uri)
        dongle = None if number is None else self.find(number)
        return None if dongle is None else dongle.is_inline

    def failure(self, uri: str) -> str:
        """Return why the dongle of this uri cannot be used.

        The text is empty if the dongle can be used, or was not opened yet.
        """
        number = _dongle_number(uri)
        return "" if number is None else self._why.get(number, "")


def _dongle_number(uri: str) -> int | None:
    """Return the number of the dongle of a radio:// uri; None for another uri."""
    number = uri.removeprefix("radio://").partition("/")[0]
    return int(number) if uri.startswith("radio://") and number.isdigit() else None


PROCESS_DONGLES = DonglePool()
"""The dongles of this process."""
