"""What is fixed about one drone on a radio, and its throttled warnings."""

import logging

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.config.calibrated import find_known_platform
from crazychoir.config.radio_checks import address_number, radio_settings
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.safety.rules.guard import Throttle

log = logging.getLogger(__name__)


class DroneSetup:
    """One drone as the swarm file describes it, with its clock, its port and its warnings.

    i: id of the drone
    kind: kind of its commands
    rate: Hz of set-points
    """

    def __init__(
        self, bus: Bus, config: SwarmConfig, i: int, kind: str, rate: float
    ) -> None:
        self.bus = bus
        self.clock = bus.clock
        self.config = config
        self.drone = i
        self.kind = kind
        self.rate = rate
        """Hz of set-points."""
        self.port = bus.ports[PORT_ADDRESSES.body_offset + i]
        """Port of the drone's body."""
        self.row = config.drone(i)
        """Row of the swarm file."""
        self.platform = find_known_platform(self.row)
        self.seen_by_cameras = self.row.pose == "mocap"
        """Whether cameras tell the pose of the drone."""
        self.number = address_number(self.row)
        """Number of the drone in packets with the poses of several."""
        self.radio_settings = radio_settings(self.row)
        """Channel and data rate of the drone."""
        self._throttle = Throttle()

    def may_log(self, topic: str) -> bool:
        """Return whether a line about this topic is due; lines of one topic are throttled."""
        return self._throttle.due(self.clock.now(), topic)

    def warn(self, topic: str, text: str) -> None:
        """Log a warning about the drone, unless one of this topic was logged a moment ago."""
        if self.may_log(topic):
            log.warning("drone %d: %s", self.drone, text)
