"""The probe of a survey on a real Crazyradio, through cflib.

The dongle and one drone change the channel together. A null packet that begins with ff 03 01 orders
the drone's radio to the channel in the next byte, until it is switched off. The drone acknowledges
before it changes. If the acknowledgement arrives, the drone's channel is known; if it does not, the
probe must search for the drone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from crazychoir.config.uris import RADIO_SCHEME, parse_uri
from crazychoir.errors import ConfigError, Refused
from crazychoir.radio.link.dongles import PLUG_ADVICE
from crazychoir.radio.survey.survey import Sample


@dataclass(frozen=True, slots=True)
class ProbePackets:
    """Packets that a probe sends."""

    null: tuple[int] = (0xFF,)
    """An empty packet."""
    safelink_off: tuple[int, ...] = (0xFF, 0x05, 0x00)
    """Packet that ends the counting of packets. A drone that counts packets since an earlier
    connection would take the first of ours and no other.
    """
    channel_order: tuple[int, ...] = (0xFF, 0x03, 0x01)
    """First bytes of the order to change the channel."""


PROBE_PACKETS = ProbePackets()


@dataclass(frozen=True, slots=True)
class ProbeLimits:
    """How long a probe searches for a drone."""

    packets: int = 50
    """Packets without an answer until the probe gives up."""
    retries: int = 15
    """Retransmissions of each of these: the most that the dongle allows."""
    searches: int = 5
    """Number of searches for the drone on its possible channels."""


PROBE_LIMITS = ProbeLimits()


RESTART_ADVICE = "Switch it off and on: it starts on its own channel."
"""Advice for a lost drone."""


class CrazyradioProbe:
    """Measures channels with a drone that is on and does not fly.

    It is a context, which ends on the drone's own channel.

    radio: cflib's Crazyradio, with data rate and address set
    home: the drone's own channel
    now: returns the time in s
    Raises Refused if the dongle is gone, or the drone is not found again.
    """

    def __init__(self, radio: Any, home: int, now: Callable[[], float]) -> None:
        self.radio = radio
        self.home = home
        self.now = now
        self._at = home

    def __enter__(self) -> Self:
        try:
            self._tune(self.home)
            if not self._says(PROBE_PACKETS.safelink_off):
                raise Refused(
                    f"drone on channel {self.home}",
                    f"no answer. Is it on, and is that its uri? {RESTART_ADVICE}",
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
        """Measure a channel, see Probe."""
        self._go(channel)
        self._set(self.radio.set_arc, retries)
        answers = [self._timed() for _ in range(packets)]
        return Sample(
            np.array([ack.ack for ack, _ in answers], bool),
            np.array([min(ack.retry, retries) for ack, _ in answers], int),
            np.array([seconds for _, seconds in answers], float),
            np.array(
                [parse_rssi(ack.data) if ack.ack else np.nan for ack, _ in answers],
                float,
            ),
        )

    def _timed(self) -> tuple[Any, float]:
        began = self.now()
        ack = self._send(PROBE_PACKETS.null)
        return ack, self.now() - began

    def _go(self, channel: int) -> None:
        """Move the drone to a channel.

        After its acknowledgement it is there, even if that was lost.
        """
        if channel == self._at:
            return
        for _ in range(PROBE_LIMITS.searches):
            self._tune(self._at)
            if self._says((*PROBE_PACKETS.channel_order, channel)):
                self._tune(channel)
                self._at = channel
                return
            self._tune(channel)
            if self._says(
                PROBE_PACKETS.null
            ):  # the drone moved, and only its answer was lost
                self._at = channel
                return
        places = (
            f"channel {self._at}, where it was, nor on {channel}, where it was to go"
        )
        raise Refused(
            "drone",
            f"no answer on {places}. {RESTART_ADVICE} Then leave out channels of --channels without answers.",
        )

    def _tune(self, channel: int) -> None:
        self._set(self.radio.set_arc, PROBE_LIMITS.retries)
        self._set(self.radio.set_channel, channel)

    def _says(self, packet: Sequence[int]) -> bool:
        """Return whether the drone acknowledges one of `PROBE_LIMITS.packets` packets."""
        return any(self._send(packet).ack for _ in range(PROBE_LIMITS.packets))

    def _send(self, packet: Sequence[int]) -> Any:
        ack = self.radio.send_packet(packet)
        if ack is None:
            raise Refused("Crazyradio", f"no answer over USB. {PLUG_ADVICE}")
        return ack

    def _set(self, setter: Callable[[int], None], value: int) -> None:
        try:
            setter(value)
        except OSError as error:  # USB errors are OSErrors
            raise Refused("Crazyradio", f"{error}. {PLUG_ADVICE}") from error


def parse_rssi(data: Sequence[int]) -> float:
    """Return the dBm at which the drone has received a packet, from its answer.

    Returns NaN if the answer does not tell it. An idle drone answers f3 01 and the absolute value;
    the third and fourth bit of the first byte count packets.
    """
    says = len(data) > 2 and data[0] & 0xF3 == 0xF3 and data[1] == 0x01
    return -float(data[2]) if says else float("nan")


def open_probe(uri: str, now: Callable[[], float]) -> CrazyradioProbe:
    """Open the dongle and the drone of a uri.

    Raises ConfigError if the uri is not one of a radio.
    Raises Refused without a dongle.
    """
    if not uri.startswith(RADIO_SCHEME):
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
    except Exception as error:  # cflib raises plain Exceptions
        raise Refused(uri, f"{error}. {PLUG_ADVICE}") from error
    return CrazyradioProbe(radio, channel, now)
