"""The probe of a survey on a real Crazyradio, through cflib: the dongle and one drone change the channel together.

The drone's radio takes a null packet that begins ff 03 01 as the order to go to the channel in its next byte, until it
is switched off. It acknowledges before it goes: who has heard that knows where it is, who has not must look.
"""

from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np

from crazychoir.config.uris import RADIO, parse_uri
from crazychoir.errors import ConfigError, Refused
from crazychoir.radio.link.dongles import PLUG
from crazychoir.radio.survey.survey import Sample

NULL = (0xFF,)
"""A packet that says nothing."""
NO_SAFELINK = (0xFF, 0x05, 0x00)
"""A drone that counts packets, as an earlier connection has told it to, would take the first of ours and no other."""
GO = (0xFF, 0x03, 0x01)
TRIES = 50
"""Packets until one that is not answered is given up."""
PATIENT = 15
"""Retries of each of them: the most that the dongle allows."""
ROUNDS = 5
"""How often a drone is looked for where it may be."""
RESTART = "Switch it off and on: it starts on its own channel."


class CrazyradioProbe:
    """Measures channels with a drone that is on and does not fly; a context, which takes it back home at its end.

    radio: as cflib's Crazyradio, data rate and address set;  home: the drone's channel;  now: s.
    Raises Refused for a dongle that is gone, and a drone that is not found again.
    """

    def __init__(self, radio: Any, home: int, now: Callable[[], float]) -> None:
        self.radio = radio
        self.home = home
        self.now = now
        self._at = home

    def __enter__(self) -> Self:
        try:
            self._tune(self.home)
            if not self._says(NO_SAFELINK):
                raise Refused(
                    f"drone on channel {self.home}",
                    f"no answer. Is it on, and is that its uri? {RESTART}",
                )
        except BaseException:
            self.radio.close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        try:
            if kind is None or issubclass(kind, KeyboardInterrupt):
                self._go(self.home)
        finally:
            self.radio.close()

    def measure(self, channel: int, packets: int, retries: int) -> Sample:
        """As Probe."""
        self._go(channel)
        self._set(self.radio.set_arc, retries)
        answers = [self._timed() for _ in range(packets)]
        return Sample(
            np.array([ack.ack for ack, _ in answers], bool),
            np.array([min(ack.retry, retries) for ack, _ in answers], int),
            np.array([seconds for _, seconds in answers], float),
            np.array(
                [rssi(ack.data) if ack.ack else np.nan for ack, _ in answers], float
            ),
        )

    def _timed(self) -> tuple[Any, float]:
        began = self.now()
        ack = self._send(NULL)
        return ack, self.now() - began

    def _go(self, channel: int) -> None:
        """Take the drone to a channel; it is there, heard or not, once it has acknowledged that it goes."""
        if channel == self._at:
            return
        for _ in range(ROUNDS):
            self._tune(self._at)
            if self._says((*GO, channel)):
                self._tune(channel)
                self._at = channel
                return
            self._tune(channel)
            if self._says(NULL):  # it went, and only its answer was lost
                self._at = channel
                return
        places = (
            f"channel {self._at}, where it was, nor on {channel}, where it was to go"
        )
        raise Refused(
            "drone",
            f"no answer on {places}. {RESTART} Then leave out --channels where nothing passes.",
        )

    def _tune(self, channel: int) -> None:
        self._set(self.radio.set_arc, PATIENT)
        self._set(self.radio.set_channel, channel)

    def _says(self, packet: Sequence[int]) -> bool:
        """Whether it acknowledges one of TRIES."""
        return any(self._send(packet).ack for _ in range(TRIES))

    def _send(self, packet: Sequence[int]) -> Any:
        ack = self.radio.send_packet(packet)
        if ack is None:
            raise Refused("Crazyradio", f"no answer over USB. {PLUG}")
        return ack

    def _set(self, setter: Callable[[int], None], value: int) -> None:
        try:
            setter(value)
        except OSError as error:  # USB errors are
            raise Refused("Crazyradio", f"{error}. {PLUG}") from error


def rssi(data: Sequence[int]) -> float:
    """dBm at which the drone has heard a packet, from what it answers; NaN where it answers something else.

    A drone that has nothing to say answers f3 01 and the absolute value, of which the first byte's third and fourth bit
    count packets.
    """
    says = len(data) > 2 and data[0] & 0xF3 == 0xF3 and data[1] == 0x01
    return -float(data[2]) if says else float("nan")


def open_probe(uri: str, now: Callable[[], float]) -> CrazyradioProbe:
    """The dongle and the drone of a uri; ConfigError for what is none, Refused without a dongle."""
    if not uri.startswith(RADIO):
        raise ConfigError(
            "uri",
            uri,
            "radio://DONGLE/CHANNEL/RATE/ADDRESS, as radio://0/80/2M/E7E7E7E7E7",
        )
    uri = str(parse_uri(uri, "uri", serials=True))
    from cflib.crtp.radiodriver import RadioDriver
    from cflib.drivers.crazyradio import Crazyradio

    try:
        number, channel, rate, address, _ = RadioDriver.parse_uri(uri)
        radio = Crazyradio(devid=number)
        radio.set_data_rate(rate)
        radio.set_address(address)
    except Exception as error:  # cflib raises nothing more special
        raise Refused(uri, f"{error}. {PLUG}") from error
    return CrazyradioProbe(radio, channel, now)
