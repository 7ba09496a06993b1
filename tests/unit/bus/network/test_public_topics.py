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

    def __init__(self, read=("state",)):
        self.places = []
        self.read = read
        self.looks = 0

    def has_audience(self, name):
        self.looks += name == "state"
        return name in self.read

    def announce(self, drone, name, payload):
        self.places.append(json.loads(payload)["p"][0])


@virtual
async def test_without_readers_a_process_wakes_only_to_look_for_them(clock):
    bus = Bus(clock)
    bus.port(0)
    announcer = Announcer(read=())
    copies = asyncio.create_task(PublicCopies(bus, announcer, [0]).run())
    await clock.sleep(10.1)
    copies.cancel()
    assert announcer.looks in (20, 21)


@virtual
async def test_a_topic_with_readers_is_published_at_its_rate(clock):
    bus = Bus(clock)
    port = bus.port(0)
    announcer = Announcer()
    port.latched.offer(
        DRONE_TOPICS.state, lambda: State.at((clock.now(), 0.0, 0.0)), lambda: 0.0
    )
    copies = asyncio.create_task(PublicCopies(bus, announcer, [0]).run())
    await clock.sleep(10.05)
    copies.cancel()
    assert len(announcer.places) in (95, 96)


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
