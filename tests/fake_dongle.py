"""A Crazyradio that is not there, as cflib's USB sees it: its packets go to virtual Crazyflies on UDP."""

import contextlib
import random
import socket
import threading
import time
from array import array
from collections import deque
from types import SimpleNamespace

import usb.core

CHANNEL, ADDRESS, RATE, ARC, ACK, INLINE = 0x01, 0x02, 0x03, 0x06, 0x10, 0x23
"""Requests of a Crazyradio that change what its next packet does."""
BROADCAST = bytes.fromhex("FFE7E7E7E7")
NULL, SAFELINK = 0xF3, 0x05
RSSI = 40
"""-dBm that a drone says it hears."""


class Receiver:
    """The radio of one drone, with its half of safelink: a bit each way tells a new packet from one sent again.

    port: of the virtual drone on this machine;  loss: share of exchanges that fail;  silent: all do;  tries: exchanges
    with it;  up: packets that it has taken, in order.
    """

    def __init__(self, port, loss=0.0):
        self.loss, self.silent, self.tries, self.up = loss, False, 0, []
        self._safe, self._expects, self._sent = False, 0, 1
        self._payload, self._waiting = b"", deque()
        self._door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._door.connect(("127.0.0.1", port))
        self._door.setblocking(False)

    def exchange(self, packet):
        """A packet arrives; what rides back on its acknowledgement."""
        if packet[:2] == bytes([0xFF, SAFELINK]):
            self._safe, self._expects, self._sent, self._payload = (
                bool(packet[2]),
                0,
                1,
                b"",
            )
            return packet
        head = packet[0]
        if not self._safe or head >> 3 & 1 == self._expects:
            self._expects ^= 1
            self._take(packet)
        if not self._safe or head >> 2 & 1 != self._sent:  # the last one has been heard
            self._sent ^= 1
            self._payload = self._next()
        return bytes([self._payload[0] & 0xF3 | self._sent << 2]) + self._payload[1:]

    def _take(self, packet):
        if packet[0] & 0xF3 != NULL:
            self.up.append(packet)
            with contextlib.suppress(OSError):
                self._door.send(bytes([packet[0] | 0x0C]) + packet[1:])

    def _next(self):
        with contextlib.suppress(OSError):
            while True:
                self._waiting.append(self._door.recv(64))
        return self._waiting.popleft() if self._waiting else bytes([NULL, 0x01, RSSI])

    def close(self):
        self._door.close()


class FakeDongle:
    """One, as pyusb's device.

    drones: by (channel, address), as (80, "E7E7E7E701");  exchanges: so many a second;  used: exchanges so far;
    change: s that it takes to be told another setting;  inline: whether it takes them with each packet;
    late: so many answers miss the read that waits for them.
    """

    serial_number = "FAKE"

    def __init__(
        self, drones, exchanges=250.0, seed=0, change=0.0, inline=False, late=0
    ):
        self.drones, self.exchanges, self.used, self.there = drones, exchanges, 0, True
        self.change, self.inline, self.changes, self.broadcasts = change, inline, 0, 0
        self.bcdDevice = 0x0510 if inline else 0x0055
        self._ctx = SimpleNamespace(dispose=lambda device: None)
        self._channel, self._address, self._acks, self._told = 2, b"", True, False
        self._draw, self._free, self._answers = random.Random(seed), 0.0, deque()  # noqa: S311 - of losses
        self._users = threading.Lock()
        self.late = late

    def _require(self):
        if not self.there:
            raise usb.core.USBError(
                "No such device (it may have been disconnected)", -4, 19
            )

    def set_configuration(self, number):
        self._require()

    def reset(self):
        self._require()

    def ctrl_transfer(self, kind, request, wValue, wIndex, timeout, data_or_wLength):
        self._require()
        if request == CHANNEL:
            self._channel = wValue
        elif request == ADDRESS:
            self._address = bytes(data_or_wLength)
        elif request == ACK:
            self._acks = bool(wValue)
        elif request == INLINE:
            if not self.inline:
                raise usb.core.USBError("Pipe error", -9, 32)
            self._told = bool(wValue)
        if request in (CHANNEL, ADDRESS, RATE, ACK):
            assert not self._told, "this ends its inline mode"
            self.changes += 1
            self._pass(self.change)

    def _pass(self, seconds):
        """So long is it busy."""
        now = time.monotonic()
        self._free = max(self._free, now) + seconds
        time.sleep(max(self._free - now, 0.0))

    def write(self, endpoint, data, timeout):
        self._require()
        assert self._users.acquire(blocking=False), "two threads use the dongle at once"
        self._pass(1.0 / self.exchanges)
        data = bytes(data)
        if self._told:
            assert data[0] == len(data)
            assert data[1] & 0x0F == 2
            self._acks, self._channel, self._address = (
                bool(data[1] & 0x10),
                data[2],
                data[3:8],
            )
            data = data[8:]
        if self._acks:
            self.used += 1
            answer = self._exchange(data)
        else:
            self._spread(data)
            answer = b"\0"
        if self._acks or self._told:
            self._answers.append(
                bytes([1 + len(answer)]) + answer if self._told else answer
            )
        else:
            self._users.release()  # it has no answer

    def _spread(self, packet):
        """Send a packet that no drone acknowledges to all that hear it."""
        assert self._address == BROADCAST
        self.broadcasts += 1
        for (channel, _), drone in self.drones.items():
            if channel == self._channel and not (
                drone.silent or self._draw.random() < drone.loss
            ):
                drone._take(packet)

    def _exchange(self, packet):
        drone = self.drones.get((self._channel, self._address.hex().upper()))
        if drone is not None:
            drone.tries += 1
        if drone is None or drone.silent or self._draw.random() < drone.loss:
            return b"\x00"
        back = drone.exchange(packet)
        return b"\x00" if self._draw.random() < drone.loss else b"\x01" + back

    def read(self, endpoint, length, timeout):
        if self._users.locked():
            self._users.release()
        self._require()
        is_late = self.late > 0
        self.late -= is_late
        if is_late or not self._answers:
            raise usb.core.USBTimeoutError("timed out")
        return array("B", self._answers.popleft())
