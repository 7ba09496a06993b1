"""The buffer into which a drone receives packets, with the bytes that earlier packets left in it."""

from typing import NamedTuple

from crazychoir.errors import CodecError
from crazychoir.radio.protocol.crtp import CRTP_FORMAT, Packet


class FirmwareAssertion(CodecError):
    """A failed assertion of the firmware: a real drone resets, and does not fly until it is switched off and on."""


class ReceivedPacket(NamedTuple):
    """One packet as the firmware has it in its memory.

    Most of the firmware reads a field at its place and does not ask how long the packet is.
    """

    port: int
    """0 to 15."""
    channel: int
    """0 to 3."""
    data: bytes
    """Content that was received."""
    buffer: bytes
    """Content, then what earlier packets have left: `CRTP_FORMAT.radio_size` bytes."""


class ReceiveBuffer:
    """Receives packets one after the other into the same bytes, which are zero after a start."""

    def __init__(self) -> None:
        self._bytes = bytearray(CRTP_FORMAT.radio_size)

    def receive(self, packet: Packet) -> ReceivedPacket:
        """Return a packet with the bytes that follow it in the buffer."""
        self._bytes[: len(packet.data)] = packet.data
        return ReceivedPacket(*packet, bytes(self._bytes))


def check_sent(packet: Packet) -> Packet:
    """Return a packet that the firmware sends.

    Raises FirmwareAssertion if it is longer than the firmware allows: an echo of a packet that a
    radio carries, or a read of too many bytes.
    """
    if len(packet.data) > CRTP_FORMAT.payload_size:
        raise FirmwareAssertion(
            f"CRTP answer at port {packet.port}: {len(packet.data)} bytes; "
            f"allowed: {CRTP_FORMAT.payload_size} at most."
        )
    return packet
