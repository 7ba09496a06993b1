"""States of the drones of one process, heard by the drones of another one."""

import numpy as np
from virtual_time import virtual

from crazychoir.bus.codec import decode
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.tables import CollisionTable
from crazychoir.runtime.mailbox import Latest
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.airspace_frames import (
    MOST_FRAMES,
    AirspaceFrames,
)
from crazychoir.safety.airspace.airspace_rows import ALL_BITS, FRAME_ROW
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.types import State


class Process:
    """The drones `own` of a swarm, at places 0.5 m apart in the order of their ids."""

    def __init__(self, clock, own, drones=4, apart=0.5, hosts=None):
        self.bus = Bus(clock)
        for i in own:
            self.bus.port(i)
        rules = AirspaceRules(CollisionTable(), 1.0, 0.0, hosts=hosts or {})
        self.airspace = Airspace(self.bus, range(drones), rules)
        self.frames = AirspaceFrames(self.airspace)
        self.own = own
        self.apart = apart
        self.age = 0.0
        self.others = {}
        self.sent = []
        self.bus.ports[own[0]].send = self.give

    def join(self, *others):
        """Send frames to these processes."""
        self.others = {other.own[0]: other for other in others}
        for other in others:
            for interest in other.bus.interests:
                self.bus.add_remote_interests([interest])

    def listen(self, i, j):
        """Let the law of drone i hear drone j of another process."""
        self.bus.subscribe(
            DRONE_TOPICS.framed_state, j, i, Latest(self.bus.clock, "framed", 1.0)
        )

    def give(self, message, to):
        assert message.topic is DRONE_TOPICS.airspace
        frame = decode(message.payload)
        for address in to:
            drones = np.frombuffer(frame, FRAME_ROW)["drone"].tolist()
            self.sent.append((address, drones))
            self.others[address].frames.take((self.own[0], frame), 0.01)

    def tick(self):
        for k, i in enumerate(self.own):
            self.airspace.publish(k, State.at((self.apart * i, 0.0, 1.0)), self.age)
        self.frames.hear()
        self.airspace.step()
        self.frames.send()


def far_processes(clock, listener):
    """Return two processes with far drones; in the second one the law of `listener` hears drone 0."""
    two = [Process(clock, (0, 1), apart=5.0), Process(clock, (2, 3), apart=5.0)]
    two[1].bus.port(listener)
    two[1].listen(listener, 0)
    two[0].join(two[1])
    two[1].join(two[0])
    return two


async def fly(clock, seconds, *processes):
    """Let the processes tick, and return what each has sent: address and drones of each frame."""
    for process in processes:
        process.sent.clear()
    for _ in range(round(seconds / 0.01)):
        await clock.sleep(0.01)
        for process in processes:
            process.tick()
    return [process.sent for process in processes]


@virtual
async def test_drones_of_two_processes_hear_each_other(clock):
    one, two = Process(clock, (0, 2)), Process(clock, (1, 3))
    one.join(two)
    two.join(one)
    await fly(clock, 1.5, one, two)
    row = one.airspace.pair(0, 3)[0]
    assert row["state"][0] == 1.5
    assert clock.now() - row["heard_time"] < 0.08
    row = one.airspace.pair(0, 1)[0]
    assert clock.now() - row["heard_time"] < 0.05
    assert row["state"][0] == 0.5


@virtual
async def test_states_that_seem_to_come_from_the_future_are_heard(clock):
    """A filter may take an early pose to be measured a little later."""
    one, two = Process(clock, (0, 2)), Process(clock, (1, 3))
    two.age = -0.001
    one.join(two)
    two.join(one)
    await fly(clock, 1.5, one, two)
    row = one.airspace.pair(0, 1)[0]
    assert clock.now() - row["heard_time"] < 0.05


@virtual
async def test_a_process_gets_only_the_states_that_it_needs(clock):
    """Drone 1 is near drone 0, drone 2 is far from both. Far states come in rounds."""
    three = [Process(clock, (i,), 3) for i in range(3)]
    three[2].apart = 10.0
    for process in three:
        process.join(*(other for other in three if other is not process))
    await fly(clock, 3.0, *three)
    sent = (await fly(clock, 1.0, *three))[0]
    to_near = [drones for address, drones in sent if address == 1]
    to_far = [drones for address, drones in sent if address == 2]
    assert 50 <= len(to_near) <= 70
    assert 0 < len(to_far) <= 20
    assert all(drones == [0] for drones in to_near + to_far)


@virtual
async def test_a_process_gets_each_state_that_its_laws_hear(clock):
    two = far_processes(clock, listener=3)
    await fly(clock, 1.0, *two)
    sent, back = await fly(clock, 1.0, *two)
    assert len([drones for _, drones in sent if 0 in drones]) == 100
    assert 0 < len([drones for _, drones in sent if 1 in drones]) <= 50
    assert 0 < len(back) <= 50, "no law hears drone 2 or drone 3"


@virtual
async def test_a_process_that_is_not_known_yet_gets_what_any_process_needs(clock):
    two = [Process(clock, (0, 1), apart=5.0), Process(clock, (2, 3), apart=5.0)]
    two[1].listen(3, 0)
    two[0].join(two[1])
    await fly(clock, 1.0, *two)
    sent, _ = await fly(clock, 1.0, *two)
    assert len([drones for _, drones in sent if 0 in drones]) == 100


@virtual
async def test_a_law_of_a_robot_outside_the_airspace_hears_each_state(clock):
    """Robot 9 drives: it is in no airspace, and may be in any process."""
    two = far_processes(clock, listener=9)
    await fly(clock, 1.0, *two)
    sent, _ = await fly(clock, 1.0, *two)
    assert len([drones for _, drones in sent if 0 in drones]) == 100


@virtual
async def test_a_state_that_laws_hear_is_sent_once(clock):
    """Drone 0 has no new state, while drone 1 ticks on."""
    two = far_processes(clock, listener=3)
    await fly(clock, 1.0, *two)
    one = two[0]
    one.sent.clear()
    for _ in range(100):
        await clock.sleep(0.01)
        one.airspace.publish(1, State.at((5.0, 0.0, 1.0)), 0.0)
        one.frames.hear()
        one.airspace.step()
        one.frames.send()
    rounds = len([drones for _, drones in one.sent if 1 in drones])
    assert len([drones for _, drones in one.sent if 0 in drones]) <= rounds


@virtual
async def test_a_row_that_is_refused_says_nothing_about_its_process(clock):
    process = Process(clock, (0,))
    rows = np.zeros(3, FRAME_ROW)
    rows["drone"] = (1, 2, 3)
    rows["number"] = 1
    rows["state"] = State.at((1.0, 0.0, 1.0)).flat
    rows["age"] = (np.inf, 0.0, NEIGHBOUR_AGES.gone)
    rows["state"][1, 0] = np.nan
    process.frames.take((1, rows.tobytes()), 0.0)
    process.frames.hear()
    swarm = process.airspace.swarm
    assert swarm["is_fresh"].tolist() == [0, 0, 0, 0]
    assert swarm["process_bits"].tolist() == [ALL_BITS] * 4
    rows["age"] = 0.0
    rows["state"][1, 0] = 1.0
    process.frames.take((1, rows.tobytes()), 0.0)
    process.frames.hear()
    assert swarm["is_fresh"].tolist() == [0, 1, 1, 1]
    assert swarm["process_bits"].tolist() == [ALL_BITS, 1, 1, 1]


MALFORMED_FRAMES = [[], None, "x", b"x", bytes(FRAME_ROW.itemsize - 1)]


@virtual
async def test_a_message_that_is_no_frame_is_counted(clock):
    process = Process(clock, (0, 2))
    for frame in MALFORMED_FRAMES:
        process.frames.take((1, frame), 0.0)
    assert process.bus.ports[0].counters.malformed == len(MALFORMED_FRAMES)


@virtual
async def test_frames_do_not_pile_up_while_no_drone_ticks(clock):
    process = Process(clock, (0, 2))
    frame = bytes(FRAME_ROW.itemsize)
    for _ in range(2 * MOST_FRAMES):
        process.frames.take((1, frame), 0.0)
    assert len(process.frames._frames) == MOST_FRAMES


@virtual
async def test_a_host_speaks_for_its_own_drones_only(clock):
    """Drone 1 is on host a, as the process that listens; drones 2 and 3 are on host b."""
    process = Process(clock, (0,), hosts={0: "a", 1: "a", 2: "b", 3: "b"})
    rows = np.zeros(3, FRAME_ROW)
    rows["drone"] = (1, 2, 3)
    rows["number"] = 1
    rows["state"] = State.at((1.0, 0.0, 1.0)).flat
    process.frames.take((3, rows.tobytes()), 0.0)
    process.frames.hear()
    assert process.airspace.swarm["is_fresh"].tolist() == [0, 0, 1, 1]


@virtual
async def test_a_frame_of_an_unknown_sender_is_counted_as_malformed(clock):
    process = Process(clock, (0,))
    process.frames.take((77, bytes(FRAME_ROW.itemsize)), 0.0)
    assert process.bus.ports[0].counters.malformed == 1
