"""Public copies of topics: which values other programs get."""

import asyncio
import json

from virtual_time import virtual

from crazychoir.bus.network.public_topics import PublicCopies
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.types import State


class Announcer:
    """A session with other programs, which read states."""

    def __init__(self):
        self.places = []

    def has_audience(self, name):
        return name == "state"

    def announce(self, drone, name, payload):
        self.places.append(json.loads(payload)["p"][0])


@virtual
async def test_new_values_are_announced_once_and_stale_ones_are_not(clock):
    bus = Bus(clock)
    port = bus.port(0)
    announcer = Announcer()
    found = {"state": State.at((1.0, 0.0, 0.0)), "age": 0.0}
    port.latched.offer(DRONE_TOPICS.state, lambda: found["state"], lambda: found["age"])
    copies = asyncio.create_task(PublicCopies(bus, announcer, [0]).run())
    await clock.sleep(1.0)
    found.update(state=State.at((2.0, 0.0, 0.0)), age=DRONE_TOPICS.state.max_age + 0.1)
    await clock.sleep(1.0)
    found.update(state=State.at((3.0, 0.0, 0.0)), age=0.1)
    await clock.sleep(1.0)
    copies.cancel()
    assert announcer.places == [1.0, 3.0]
