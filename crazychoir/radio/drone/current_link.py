"""The state of the link to one drone, across the connections that follow one another."""

import logging
import math
from collections.abc import Iterable

from crazychoir.errors import ConfigError
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.timing import SILENCE_LIMITS
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.protocol.crtp import Packet

log = logging.getLogger(__name__)


class CurrentLink:
    """Keeps the connection that is in use, and why there is none."""

    def __init__(self, setup: DroneSetup) -> None:
        self.connection: Connection | None = None
        """The connection in use; None while there is none."""
        self.opening: Connection | None = None
        """The connection while it is opened and the drone answers the first questions."""
        self.state = "connecting"
        """State of the link as its agent reads it."""
        self.why = ""
        """Reason why the connection must be ended; empty if it works."""
        self.problem = ""
        """Reason why the link is not up, or may only land the drone."""
        self.only_lands = ""
        """Reason why the drone may only land; empty if it may fly."""
        self.up_ns = 0
        """ns: when the connection came up, or last carried packets again after a silence."""
        self.reconnected = 0
        """Count of connections after a loss."""
        self._setup = setup
        self._clock = setup.clock
        self._heard_at = -math.inf

    @property
    def silence(self) -> float:
        """Seconds since its last packet over any connection; infinite before the first."""
        way = self.connection
        return min(
            math.inf if way is None else way.silence,
            self._clock.now() - self._heard_at,
        )

    def is_quiet(self) -> bool:
        """Return whether there is no connection, or a silent one."""
        return (
            self.connection is None
            or self.connection.silence > SILENCE_LIMITS.link_degraded
        )

    def send_all(self, packets: Iterable[Packet]) -> None:
        """Send packets in order; drop them if there is no connection."""
        connection = self.connection
        if connection is None:
            return
        for packet in packets:
            connection.send(packet)

    def take_up(self, connection: Connection, release: str) -> None:
        """Use this connection: the drone has answered all first questions.

        release: of its firmware
        """
        self.connection = connection
        self.opening = None
        self.up_ns = self._clock.now_ns()
        self.reconnected += self.state == "lost"
        if self.state != "up":
            log.info("drone %d: connected, firmware %s", self._setup.drone, release)
        self._change("up", self.only_lands)

    def drop(self, connection: Connection) -> None:
        """Forget this connection, which is about to be closed."""
        self._heard_at = max(self._heard_at, self._clock.now() - connection.silence)
        self.connection = None
        self.opening = None

    def note_silence(self, silence: float) -> None:
        """Note whether the connection in use is degraded, or counts as new after a long silence.

        silence: s since its last packet
        """
        if silence > SILENCE_LIMITS.drone_unreached:
            self.up_ns = self._clock.now_ns()
        self.state = "degraded" if silence > SILENCE_LIMITS.link_degraded else "up"

    def lose(self, reason: str) -> None:
        """Note that the driver has given up."""
        self.why = reason

    def fail(self, error: Exception, is_prepared: bool, began: float) -> None:
        """Note why an attempt to connect, or the connection in use, has failed.

        is_prepared: whether the drone has been connected and prepared before
        began: s: time of the first attempt to connect
        """
        self.problem = str(error)
        deadline = self._setup.config.radio.connect_deadline
        if isinstance(error, ConfigError):
            self._change("refused", str(error))
        elif is_prepared:
            self._change("lost", str(error))
        elif self._clock.now() - began > deadline:
            self._change("absent", str(error))
        if self.state != "connecting" and self._setup.may_log(self.state):
            log.error("drone %d: %s: %s", self._setup.drone, self.state, error)

    def _change(self, state: str, problem: str) -> None:
        self.state = state
        self.why = ""
        self.problem = problem
