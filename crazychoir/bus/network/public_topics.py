"""Publish the public topics of the drones as JSON, at a lower rate, for other Zenoh programs.

The keys are choir/<swarm>/drone/<id>/<topic>.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import msgspec
import numpy as np

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import ALL_TOPICS, Topic
from crazychoir.files.path_texts import json_bytes
from crazychoir.runtime.actor import Actor


class Announcer(Protocol):
    """The part of a network session that `PublicCopies` needs."""

    def has_audience(self, topic: str) -> bool:
        """Return whether another program reads this topic of some drone."""

    def announce(self, drone: int, topic: str, text: bytes) -> None:
        """Publish a text under choir/<swarm>/drone/<drone>/<topic>."""


AUDIENCE_RATE = 2.0
"""Looks for readers of public topics, Hz. No topic is published less often."""


class PublicCopies(Actor):
    """Publishes JSON copies of the public topics of the drones of a process, while others read them.

    bus: bus of the process
    announcer: publishes the copies
    ids: of the drones
    """

    name = "public"

    def __init__(self, bus: Bus, announcer: Announcer, ids: Sequence[int]) -> None:
        self.bus = bus
        self.announcer = announcer
        self.ids = list(ids)
        self._topics = [topic for topic in ALL_TOPICS if topic.public > 0]
        self._newest: dict[tuple[str, int], Any] = {}
        """The last published value of each topic and drone."""

    async def run(self) -> None:
        """Publish new values at the public rate of each topic.

        The drones offer their present values, so that they need not publish them in each tick.
        While no other program reads, this process only looks for readers.
        """
        async for _ in self.bus.clock.ticks(AUDIENCE_RATE, aligned=True):
            read = [
                topic
                for topic in self._topics
                if self.announcer.has_audience(topic.name)
            ]
            if read:
                await self._publish_until_next_look(read)

    async def _publish_until_next_look(self, read: Sequence[Topic]) -> None:
        """Publish new values of topics with readers, until it is time to look for readers again."""
        fastest = max(topic.public for topic in read)
        for step in range(max(1, round(fastest / AUDIENCE_RATE))):
            if step:
                await self.bus.clock.sleep(1.0 / fastest)
            for topic in read:
                if step % round(fastest / topic.public) == 0:
                    for drone in self.ids:
                        self._publish(topic, drone)

    def _publish(self, topic: Topic, drone: int) -> None:
        """Publish the present value of a topic of a drone, if there is a new one."""
        bus = self.bus
        port = bus.ports.get(drone)
        found = None if port is None else port.latched.find(topic, bus.clock.now_ns())
        if found is None or found[1] > topic.max_age:
            return
        if found[0] is self._newest.get((topic.name, drone)):
            return
        self._newest[topic.name, drone] = found[0]
        self.announcer.announce(drone, topic.name, fields_as_json(found[0]))


def fields_by_name(value: msgspec.Struct) -> dict[str, Any]:
    """Return the fields of a wire type by name, with a flat vector divided into its parts.

    The vector is not divided if some of its elements belong to no named part.
    """
    fields = msgspec.structs.asdict(value)
    if "flat" not in fields:
        return fields
    parts = {
        name: getattr(value, name)
        for name, what in vars(type(value)).items()
        if isinstance(what, property)
    }
    if sum(np.size(part) for part in parts.values()) == fields["flat"].size:
        del fields["flat"]
    return parts | fields


def fields_as_json(value: msgspec.Struct) -> bytes:
    """Return the fields of a wire type as JSON.

    A flat vector is divided into its parts, arrays become lists, and numbers that are not finite
    become null.
    """
    return json_bytes(fields_by_name(value), enc_hook=np.ndarray.tolist)
