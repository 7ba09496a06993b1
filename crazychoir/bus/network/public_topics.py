"""Decimated JSON copies of public topics under choir/<swarm>/drone/<id>/<topic>, for other Zenoh programs."""

from typing import Any, Protocol

import msgspec
import numpy as np

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import TOPICS, Topic
from crazychoir.files.path_texts import json_bytes
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.mailbox import Latest


class Announcer(Protocol):
    """What this needs of the link."""

    bus: Bus

    def announce(self, drone: int, topic: str, text: bytes) -> None:
        """Put a text under the drone's public key, if anybody listens."""


class PublicCopies(Actor):
    """The public topics of one drone."""

    name = "public"

    def __init__(self, link: Announcer, drone: int) -> None:
        self.link = link
        self.drone = drone
        self._clock = link.bus.clock
        self._boxes: dict[Topic, Latest[Any]] = {}
        for topic in TOPICS:
            if topic.public > 0:
                box = self._boxes[topic] = Latest(
                    self._clock, topic.name, topic.max_age
                )
                link.bus.subscribe(topic, drone, drone, box)

    async def run(self) -> None:
        """Put what is new, at each topic's public rate."""
        fastest = max(topic.public for topic in self._boxes)
        sent = dict.fromkeys(self._boxes, 0)
        tick = 0
        async for _ in self._clock.ticks(fastest, drone=self.drone):
            for topic, box in self._boxes.items():
                value = box.peek()
                if (
                    value is not None
                    and tick % round(fastest / topic.public) == 0
                    and box.version > sent[topic]
                ):
                    sent[topic] = box.version
                    self.link.announce(self.drone, topic.name, as_json(value))
            tick += 1


def by_name(value: msgspec.Struct) -> dict[str, Any]:
    """The fields of a wire type, with a flat vector by its parts; whole where no parts are named, or not all."""
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


def as_json(value: msgspec.Struct) -> bytes:
    """The fields of a wire type by name, a flat vector by its parts; arrays as lists; what is not finite as null."""
    return json_bytes(by_name(value), enc_hook=np.ndarray.tolist)
