"""The notes of one drone: its newest trouble in words, for the status and for the log."""

import logging

from crazychoir.bus.port import Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.throttle import Throttle

log = logging.getLogger(__name__)


class FlightNotes:
    """Keeps the newest trouble of one drone, and logs it at most now and then.

    port: of the drone
    """

    def __init__(self, port: Port) -> None:
        self.drone = port.address
        self.text = ""
        """The newest trouble in words; empty if there is none."""
        self.is_grave = False
        """Whether it needs attention: motors were cut, or the drone lands for safety."""
        self.brought_down = ""
        """Why the safety table first ended a flight by a landing; empty if it never did."""
        self._port = port
        self._clock = port.bus.clock
        self._throttle = Throttle()
        self._evasion = ""

    def say(self, topic: str, text: str, is_grave: bool = False) -> None:
        """Keep a note for the status, and log it, at most now and then.

        topic: notes of one topic share the limit of log lines
        """
        # Errors name their drone, and so does the log line.
        text = text.removeprefix(f"drone {self.drone}: ")
        self.text = text
        self.is_grave = is_grave
        now = self._clock.now()
        if self._throttle.due(now, topic) and self._throttle.due(now, text):
            log.warning("drone %d: %s", self.drone, text)

    def say_evades(self, other: int | None, is_first: bool) -> None:
        """Say which drone this one evades.

        other: id of that drone; None if this drone brakes, because it does not hear a drone that may
            be near, or most of the others
        is_first: whether it is the first evasion of the drone, which is logged
        """
        if other is None:
            self.say("collision", "braking: other drones are not heard")
        else:
            self.text = f"keeps clear of drone {other}"
            self.is_grave = False
            if is_first:
                log.info("drone %d: %s", self.drone, self.text)
        self._evasion = self.text

    def end_evasion(self) -> None:
        """Remove the note of an evasion, unless a newer note has replaced it."""
        if self.text == self._evasion:
            self.text = ""
            self.is_grave = False

    def report(self, topic: str, text: str) -> None:
        """Keep a note, and send it to the observers' log too."""
        self.say(topic, text)
        self._port.publish(DRONE_TOPICS.log, f"drone {self.drone}: {text}")
