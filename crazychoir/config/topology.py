"""The places of the bodies and the poses of drones, in real time."""

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS, Topic
from crazychoir.config.checks import world_owned_drones
from crazychoir.config.radio_checks import (
    camera_drones,
    drones_by_dongle,
    radio_drones,
)
from crazychoir.config.tables import Swarm


class Topology:
    """Which process has the body of each drone and sends its pose, in real time.

    All ids are in increasing order.

    owned: drones that the process of the world's owner simulates
    reached: drones with a radio, udp:// or radio://
    seen: drones with poses from the process of motion capture
    unseen: drones with a radio that estimate their own pose, which is also their truth
    elsewhere: drones with a body outside the process of their agent
    dongles: drones of each dongle, by its number
    """

    def __init__(self, swarm: Swarm) -> None:
        self._swarm = swarm
        self.owned = world_owned_drones(swarm)
        self.reached = radio_drones(swarm)
        self.seen = camera_drones(swarm)
        self.unseen = tuple(i for i in self.reached if i not in self.seen)
        self.elsewhere = tuple(sorted((*self.owned, *self.reached)))
        self.dongles = drones_by_dongle(swarm)

    def dongle_host(self, number: int) -> str | None:
        """Return the host of a dongle's owner; None without [hosts]."""
        rows = self._swarm.radio.dongles
        return next((row.host for row in rows if row.dongle == number), None)

    def source(self, topic: Topic, i: int) -> int:
        """Return the address that sends a topic of drone i: its agent, its body or the cameras."""
        if not topic.of_body or i not in self.elsewhere:
            return i
        if topic in (DRONE_TOPICS.pose, DRONE_TOPICS.truth) and i in self.seen:
            return PORT_ADDRESSES.camera_offset + i
        return PORT_ADDRESSES.body_offset + i
