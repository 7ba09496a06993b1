"""The console of a drone's firmware, line by line, for the log and for observers."""

import logging
from collections.abc import Callable

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.protocol.crtp import CrtpPort, Packet

log = logging.getLogger(__name__)
LONGEST_LINE = 400
"""Bytes of a line after which it is told without its end."""


class ConsoleReader:
    """Joins the packets of the console to lines, and publishes each line.

    others: called with each packet of another port
    """

    def __init__(self, setup: DroneSetup, others: Callable[[Packet], None]) -> None:
        self._setup = setup
        self._others = others
        self._part = b""

    def hear(self, packet: Packet) -> None:
        """Take a packet from the drone."""
        if packet.port != CrtpPort.CONSOLE:
            self._others(packet)
            return
        self._part += packet.data.rstrip(b"\0")
        *lines, self._part = self._part.split(b"\n")
        if len(self._part) > LONGEST_LINE:
            lines.append(self._part)
            self._part = b""
        for line in lines:
            if text := line.decode(errors="replace").strip():
                self._publish(text)

    def _publish(self, text: str) -> None:
        line = f"drone {self._setup.drone}: firmware: {text}"
        log.info("%s", line)
        self._setup.port.publish(DRONE_TOPICS.console, line)
