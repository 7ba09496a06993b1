"""States of the drones of one process, heard by the drones of another one."""

import numpy as np
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.tables import CollisionTable
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.airspace_frames import AirspaceFrames
from crazychoir.types import State


class Process:
    """The drones `own` of a swarm of four; its frames go to `other`."""

    def __init__(self, clock, own):
        self.bus = Bus(clock)
        for i in own:
            self.bus.port(i)
        rules = AirspaceRules(CollisionTable(), 1.0, 0.0)
        self.airspace = Airspace(self.bus, range(4), rules)
        self.frames = AirspaceFrames(self.airspace)
        self.own = own
        self.other = None
        for i in own:
            self.bus.ports[i].publish = self.give

    def give(self, topic, frame):
        assert topic is DRONE_TOPICS.airspace
        self.other.frames.take((self.own[0], frame), 0.01)

    def tick(self):
        for k, i in enumerate(self.own):
            self.airspace.publish(k, State.at((0.5 * i, 0.0, 1.0)), 0.0)
        self.airspace.step()
        self.frames.send()


@virtual
async def test_drones_of_two_processes_hear_each_other(clock):
    one, two = Process(clock, (0, 2)), Process(clock, (1, 3))
    one.other, two.other = two, one
    for _ in range(150):
        await clock.sleep(0.01)
        one.tick()
        two.tick()
    row = one.airspace.pair(0, 3)[0]
    assert row["state"][0] == 1.5
    assert clock.now() - row["heard_time"] < 0.08
    row = one.airspace.pair(0, 1)[0]
    assert clock.now() - row["heard_time"] < 0.05
    assert row["state"][0] == 0.5


MALFORMED_FRAMES = [
    [],
    [1, 2, 3, 4],
    [np.zeros(1), np.zeros(1), np.zeros((1, 16)), np.zeros(1)],
    [np.zeros(1, int), np.zeros(2, int), np.zeros((1, 16)), np.zeros(1)],
    [np.zeros(1, int), np.zeros(1, int), np.zeros((1, 15)), np.zeros(1)],
    [np.zeros(1, int), np.zeros(1, int), np.zeros((1, 16)), np.full(1, np.nan)],
    [np.zeros(1, int), np.zeros(1, int), np.zeros((1, 16)), -np.ones(1)],
]


@virtual
async def test_a_message_that_is_no_frame_is_counted(clock):
    process = Process(clock, (0, 2))
    for frame in MALFORMED_FRAMES:
        process.frames.take((1, frame), 0.0)
    assert process.bus.ports[0].counters.malformed == len(MALFORMED_FRAMES)
