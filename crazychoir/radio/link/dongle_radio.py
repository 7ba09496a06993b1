"""One Crazyradio as USB sees it: packets to one drone, and broadcasts to all drones of a channel.

A Crazyradio 2.0 with firmware 5.1 or newer takes its settings with each packet (its inline mode). Any other
is told each change of its settings by a USB control transfer, which takes longer than a packet. cflib knows
neither the inline mode nor broadcasts.

Source: crazyradio2-firmware, docs/development/compatible-usb-protocol.md.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cflib.crtp import radiodriver
from cflib.drivers import crazyradio

from crazychoir.radio.protocol.packed_poses import BROADCAST_ADDRESS

UsbError = crazyradio.usb.core.USBError
"""Error of a transfer over USB."""
NULL_PACKET = b"\xff"
"""Packet without content."""


@dataclass(frozen=True, slots=True)
class UsbProtocol:
    """Numbers of the USB protocol of a Crazyradio."""

    vendor_request: int = 0x40
    """Type of the control transfers."""
    set_inline: int = 0x23
    """Request that switches the inline mode."""
    first_inline_version: float = 5.1
    """First firmware of the Crazyradio 2.0 with the inline mode."""
    first_other_version: float = 90.0
    """Versions from here on are builds of the Crazyradio PA's firmware for development."""
    endpoint_out: int = 0x01
    """Endpoint of packets to the dongle."""
    endpoint_in: int = 0x81
    """Endpoint of answers of the dongle."""
    answer_size: int = 64
    """Most bytes of an answer."""
    ack_flag: int = 0x10
    """Bit of the second byte of an inline packet: wait for an acknowledgement."""
    header_size: int = 8
    """Bytes of the settings before an inline packet."""
    timeout: int = 1000
    """ms for a transfer."""
    probe_timeout: int = 50
    """ms in which a dongle answers a broadcast, if it answers broadcasts."""
    stale_timeout: int = 1
    """ms for the read of an answer that is late, and of no use any more."""


USB_PROTOCOL = UsbProtocol()


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """An answer of the dongle, with the names that cflib's driver reads."""

    ack: bool
    """Whether the drone has acknowledged."""
    powerDet: bool
    """Whether its signal is strong."""
    retry: int
    """Number of retransmissions."""
    data: Any
    """Bytes of the packet from the drone; empty without one."""


class DongleRadio:
    """A Crazyradio, opened by the constructor, which raises the errors of cflib.

    number: number of the dongle
    """

    def __init__(self, number: int) -> None:
        self._radio = radiodriver.Crazyradio(devid=number)
        self.version: float = self._radio.version
        self._answers_broadcasts = False
        self._has_stale_answers = False
        """Whether a read has failed: the dongle may still give its answer to the next read."""
        self.is_inline = self._begin_inline()
        """Whether the dongle takes its settings with each packet."""

    def _begin_inline(self) -> bool:
        """Switch to the inline mode if the dongle knows it; return whether it does."""
        is_known = (
            USB_PROTOCOL.first_inline_version
            <= self.version
            < USB_PROTOCOL.first_other_version
        )
        if not is_known:
            return False
        try:
            self._set_inline(1)
        except UsbError:
            return False  # the dongle refuses the request: it does not know it
        self._write_inline(
            2, BROADCAST_ADDRESS, radiodriver.Crazyradio.DR_2MPS, NULL_PACKET, 0
        )
        try:
            answer = self._read(USB_PROTOCOL.probe_timeout)
        except UsbError:
            return True
        self._answers_broadcasts = True
        if len(answer) < 2 or answer[0] != len(answer):
            self._set_inline(0)  # an inline mode in another form
            return False
        return True

    def _set_inline(self, on: int) -> None:
        self._radio.handle.ctrl_transfer(
            USB_PROTOCOL.vendor_request,
            USB_PROTOCOL.set_inline,
            wValue=on,
            wIndex=0,
            timeout=USB_PROTOCOL.timeout,
            data_or_wLength=(),
        )

    def _write(self, data: bytes) -> None:
        self._radio.handle.write(
            endpoint=USB_PROTOCOL.endpoint_out, data=data, timeout=USB_PROTOCOL.timeout
        )

    def _read(self, timeout: int) -> Any:
        try:
            return self._radio.handle.read(
                USB_PROTOCOL.endpoint_in, USB_PROTOCOL.answer_size, timeout=timeout
            )
        except UsbError:
            self._has_stale_answers = True
            raise

    def _drop_stale_answers(self) -> None:
        """Read the answers to earlier packets, so that none is taken for the next packet's."""
        if not self._has_stale_answers:
            return
        with contextlib.suppress(UsbError):
            while True:
                self._read(USB_PROTOCOL.stale_timeout)
        self._has_stale_answers = False

    def _write_inline(
        self, channel: int, address: bytes, rate: int, data: bytes, ack: int
    ) -> None:
        """Send a packet after its settings: length, data rate and acknowledgement, channel, address.

        ack: 1 to wait for an acknowledgement, 0 not to
        """
        settings = bytes(
            [
                USB_PROTOCOL.header_size + len(data),
                rate | ack * USB_PROTOCOL.ack_flag,
                channel,
            ]
        )
        self._drop_stale_answers()
        self._write(settings + address + data)

    def exchange(
        self, channel: int, address: bytes, rate: int, data: Sequence[int]
    ) -> Any:
        """Send a packet to a drone and return the acknowledgement; None if the dongle does not answer."""
        if self.is_inline:
            with contextlib.suppress(UsbError):
                self._write_inline(channel, address, rate, bytes(data), 1)
                return _parse_inline_answer(self._read(USB_PROTOCOL.timeout))
            return None
        self._set(channel, address, rate)
        return self._radio.send_packet(data)

    def broadcast(self, channel: int, rate: int, packets: Sequence[bytes]) -> None:
        """Send packets to all drones of a channel and data rate; none acknowledges them.

        Raises UsbError if the dongle does not answer any more.
        """
        try:
            if self.is_inline:
                self._broadcast_inline(channel, rate, packets)
            else:
                self._broadcast(channel, rate, packets)
        except UsbError:
            self.check()  # a packet may be lost on USB

    def _broadcast_inline(
        self, channel: int, rate: int, packets: Sequence[bytes]
    ) -> None:
        for packet in packets:
            self._write_inline(channel, BROADCAST_ADDRESS, rate, packet, 0)
            if self._answers_broadcasts:
                self._read(USB_PROTOCOL.timeout)

    def _broadcast(self, channel: int, rate: int, packets: Sequence[bytes]) -> None:
        self._radio.set_ack_enable(False)
        try:
            self._set(channel, BROADCAST_ADDRESS, rate)
            for packet in packets:
                self._write(
                    packet
                )  # without acknowledgements the dongle does not answer
        finally:
            self._radio.set_ack_enable(True)

    def _set(self, channel: int, address: bytes, rate: int) -> None:
        """Tell the dongle the settings that have changed."""
        self._radio.set_channel(channel)
        self._radio.set_address(address)
        self._radio.set_data_rate(rate)

    def set_arc(self, retries: int) -> None:
        """Set how often the dongle itself sends an unacknowledged packet again."""
        self._radio.set_arc(retries)

    def check(self) -> None:
        """Raise USBError if the dongle does not answer."""
        self._radio.set_arc(self._radio.arc)

    def close(self) -> None:
        """Close the dongle."""
        self._radio.close()


def _parse_inline_answer(answer: Any) -> Acknowledgement | None:
    """Return the acknowledgement in an answer: length, status, packet; None if it has another form."""
    if len(answer) < 2 or answer[0] != len(answer):
        return None
    status = answer[1]
    is_acknowledged = bool(status & 1)
    return Acknowledgement(
        is_acknowledged,
        bool(status & 2),
        status >> 4,
        answer[2:] if is_acknowledged else (),
    )
