"""Crazyradio dongles, each shared by the links of this process, which take turns in the threads of their drivers.

cflib's own sharing has a thread a dongle that dies of an error of USB, or does not notice that nobody answers any more;
its links then wait for it for ever. Here such an error is kept, and named.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from cflib.crtp import radiodriver

from crazychoir.errors import LinkFailed, error_text

PLUG = "Plug a Crazyradio in, let your user open it (Bitcraze's udev rules), and end what else uses it."
PAUSE = 0.05
"""s until a dongle is asked again that has answered nothing."""
ANSWERS = 0.002
"""s that what a drone has said is given to be answered, before it is asked whether it has more to say."""
SOON, LATER = 0.005, 0.01
"""s until a link that has nothing to say asks whether its drone has: after the first time in vain, then twice as long
each time, up to the second, times the links of its dongle. cflib's asks at once, and takes the others' time for it."""
PATIENT = 5
"""Packets in a row without acknowledgement, from which on it is sent again as seldom."""
SAFELINK = (0xFF, 0x05, 0x01)
"""The first packets of a link: count packets both ways, so that none is lost or taken twice."""
NULL = 0xF3
"""Header of what says nothing, but for the two bits of safelink."""


class DongleFailed(LinkFailed):
    """The dongle of a link is not there, or not any more: no other link of it will do better."""


class Dongle:
    """One Crazyradio. It is opened here; raises what cflib raises.

    failed: called with what USB says when it does not answer any more.
    """

    def __init__(self, number: int, failed: Callable[[str], None]) -> None:
        self._radio = radiodriver.Crazyradio(devid=number)
        self.version: float = self._radio.version
        self.links = 0
        self.over = False
        self._failed = failed
        self._guard, self._waiting = threading.Lock(), deque[threading.Lock]()
        self._never = threading.Event()

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        """First come, first served."""
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
        """A packet to a drone, and cflib's acknowledgement; None if the dongle answers nothing."""
        with self._turn():
            answer = self._use(
                lambda radio: _exchanged(radio, channel, address, rate, data)
            )
            if answer is None:
                self._use(
                    lambda radio: radio.set_arc(radio.arc)
                )  # cflib keeps errors of packets for itself
        if answer is None:
            self._never.wait(PAUSE)
        return answer

    def set_arc(self, retries: int) -> None:
        """How often it sends again by itself what is not acknowledged."""
        with self._turn():
            self._use(lambda radio: radio.set_arc(retries))

    def _use(self, does: Callable[[Any], Any]) -> Any:
        if self.over:
            return None
        try:
            return does(self._radio)
        except Exception as error:  # noqa: BLE001 - whatever USB raises, whoever waits for a turn gets it
            self.over = True
            self._failed(error_text(error))

    def close(self) -> None:
        """After its last link."""
        with self._turn():
            self.over = True
            with contextlib.suppress(Exception):  # pulled out
                self._radio.close()


def _exchanged(
    radio: Any, channel: int, address: bytes, rate: int, data: Sequence[int]
) -> Any:
    radio.set_channel(channel)
    radio.set_address(address)
    radio.set_data_rate(rate)
    return radio.send_packet(data)


class Turns:
    """One link's turns at a dongle: what cflib's driver takes for its radio."""

    def __init__(self, dongle: Dongle, closed: Callable[[], None]) -> None:
        self.version = dongle.version
        self._dongle = dongle
        self._closed = closed
        self._channel, self._address, self._rate = (
            2,
            bytes(5),
            radiodriver.Crazyradio.DR_2MPS,
        )
        self._open = True
        self._heard = False
        self._vain = 0
        self._missed = 0
        self.ends = False
        """Whether the link is about to be closed."""
        self._never = threading.Event()

    def set_channel(self, channel: int) -> None:
        """Of the next packets."""
        self._channel = channel

    def set_address(self, address: Sequence[int]) -> None:
        """Of the next packets."""
        self._address = bytes(address)

    def set_data_rate(self, rate: int) -> None:
        """Of the next packets."""
        self._rate = rate

    def set_arc(self, retries: int) -> None:
        """Of all links."""
        self._dongle.set_arc(retries)

    def send_packet(self, data: Sequence[int]) -> Any:
        """One exchange, in turn; None if there is none.

        cflib asks for safelink ten times. A drone that still counts for an earlier link, and comes within reach only
        after that, would take each packet for one sent again: it is asked until it acknowledges.
        """
        answer = self._exchanged(data)
        while (
            tuple(data) == SAFELINK
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
            self._heard = not _says_nothing(answer.data)
            self._vain = 0 if self._heard or not _says_nothing(data) else self._vain + 1
            self._missed = 0 if answer.ack else self._missed + 1
            if self._missed > PATIENT:
                self._never.wait(self._longest)
        return answer

    @property
    def idle(self) -> float:
        """s that its drone need not be asked, unless there is something to say."""
        if self._vain == 0:
            return ANSWERS if self._heard else 0.0
        return min(SOON * 2.0 ** min(self._vain - 1, PATIENT), self._longest)

    @property
    def _longest(self) -> float:
        return LATER * self._dongle.links

    def close(self) -> None:
        """No more of them."""
        if self._open:
            self._open = False
            self._closed()


def _says_nothing(data: Sequence[int]) -> bool:
    return not len(data) or data[0] & NULL == NULL


class Dongles:
    """Those of this process by number, and why one cannot be used."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[int, Dongle] = {}
        self._why: dict[int, str] = {}

    def open(self, number: int) -> Turns:
        """A link's turns at a dongle, which is opened for the first of them; raises what cflib raises."""
        with self._lock:
            dongle = self._open.get(number)
            if dongle is None or dongle.over:
                dongle = self._open[number] = self._opened(number)
            dongle.links += 1
        return Turns(dongle, lambda: self._leave(number, dongle))

    def _opened(self, number: int) -> Dongle:
        try:
            dongle = Dongle(
                number,
                lambda why: self._fails(
                    number, f"{why}. It was pulled out, or has no power"
                ),
            )
        except Exception as error:
            self._fails(number, f"{error}. {PLUG}")
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
        """Why the dongle of this uri cannot be used; empty if it can, or has not been asked for."""
        number = uri.removeprefix("radio://").partition("/")[0]
        return (
            self._why.get(int(number), "")
            if uri.startswith("radio://") and number.isdigit()
            else ""
        )


DONGLES = Dongles()
