"""The owner of a simulated world: when it looks, what it shows and how old that is, how it makes up for lost time."""

import asyncio
import gc
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.mocap.simulated import CameraErrors, SimulatedMocap
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.runtime.clock import run_virtual, run_wall
from crazychoir.runtime.mailbox import Call
from crazychoir.simulation import owner as owner_module
from crazychoir.simulation.lightweight.integrator import CFIntegrator, InputLags
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.owner import LARGEST_CATCH_UP, DelayedLink, WorldOwner
from crazychoir.simulation.trace import Trace
from crazychoir.types import FPQR, Body

PACKAGE_FOLDER = str(Path(owner_module.__file__).parents[1])


class Owned:
    """Two drones in the air in a world of 100 Hz, and what the ports of both say."""

    def __init__(self, clock, rate=100.0, **cameras):
        self.clock, self.bus = clock, Bus(clock)
        self.poses, self.truths = {0: [], 1: []}, {0: [], 1: []}
        for i in (0, 1):
            self.bus.port(i)
            self.bus.subscribe(
                DRONE_TOPICS.pose,
                i,
                i,
                Call(clock, lambda pose, age, i=i: self.poses[i].append((pose, age))),
            )
            self.bus.subscribe(
                DRONE_TOPICS.truth,
                i,
                i,
                Call(clock, lambda state, age, i=i: self.truths[i].append(state)),
            )
        self.world = CFIntegrator((0, 1), np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0]]))
        errors = CameraErrors(**cameras)
        mocap = SimulatedMocap((0, 1), 1, errors, dt=1.0 / rate)
        self.owner = WorldOwner(self.bus, self.world, mocap, rate)

    async def run(self, seconds):
        running = asyncio.create_task(self.owner.run())
        await self.clock.sleep(seconds + 0.005)
        running.cancel()


@virtual
async def test_poses_come_at_the_rate_of_the_cameras_and_truth_at_its_own(clock):
    owned = Owned(clock, rate=50.0)
    await owned.run(1.0)
    assert owned.world.time == pytest.approx(1.0)
    assert [len(owned.poses[i]) for i in (0, 1)] == [50, 50]
    assert [len(owned.truths[i]) for i in (0, 1)] == [
        DRONE_TOPICS.truth.rate,
        DRONE_TOPICS.truth.rate,
    ]
    assert owned.owner.looked_ns == pytest.approx(1e9)


@virtual
async def test_bodies_elsewhere_speak_at_their_own_addresses_and_obey_late(clock):
    bus = Bus(clock)
    for i in (0, 1):
        bus.port(PORT_ADDRESSES.body_offset + i)
    reader, boxes = bus.port(7), {}
    for topic in (DRONE_TOPICS.pose, DRONE_TOPICS.truth, DRONE_TOPICS.body):
        boxes[topic] = topic.mailbox(clock)
        bus.subscribe(
            topic, PORT_ADDRESSES.body_offset + 1, reader.address, boxes[topic]
        )
    world = CFIntegrator((0, 1), np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0]]))
    owner = WorldOwner(
        bus,
        world,
        SimulatedMocap((0, 1), 1),
        100.0,
        base=PORT_ADDRESSES.body_offset,
        delay=2,
    )
    link = owner.link(1, "fpqr")
    link.send(FPQR(np.array([0.1, 0.0, 0.0, 0.0])))
    thrusts = []
    for _ in range(25):
        owner.step()
        thrusts.append(world.commands[1, 0])
    assert thrusts[:3] == [PAPER_PLATFORM.weight, PAPER_PLATFORM.weight, 0.1]
    assert boxes[DRONE_TOPICS.pose].peek().p == pytest.approx(
        world.state(1).p, abs=0.01
    )
    assert (
        boxes[DRONE_TOPICS.truth].peek().flat.tolist() == world.state(1).flat.tolist()
    )
    assert boxes[DRONE_TOPICS.body].peek() == Body("")


@virtual
async def test_the_age_of_a_late_pose_is_the_time_since_its_exposure(clock):
    rate = 20.0
    owned = Owned(clock, rate, noise_p=0.0, noise_angle=0.0, latency_steps=2)

    def move():
        """Fly at 1 m/s in the direction x."""
        owned.world.states[:, 0] += owned.world.dt

    owned.world.step = move
    await owned.run(1.0)
    pose, age = owned.poses[0][-1]
    assert age == pose.age == pytest.approx(2.0 / rate)
    assert pose.p[0] == pytest.approx(1.0 - age)


@virtual
async def test_a_pose_is_of_its_drone_and_says_its_age(clock):
    owned = Owned(clock, noise_p=0.0, noise_angle=0.0, latency_steps=2)
    await owned.run(0.5)
    pose, age = owned.poses[1][-1]
    assert pose.p == pytest.approx([1.0, 0.0, 2.0])
    assert age == pose.age == pytest.approx(0.02)


@virtual
async def test_a_drone_that_is_not_seen_hears_nothing(clock):
    owned = Owned(clock, dropout=0.5)
    await owned.run(2.0)
    assert 60 < len(owned.poses[0]) < 140
    assert len(owned.truths[0]) == 2.0 * DRONE_TOPICS.truth.rate


@virtual
async def test_a_world_that_was_late_makes_up_for_it_up_to_a_limit(clock):
    owned = Owned(clock)
    owned.owner.ticks.due_ns -= 10 * owned.owner.ticks.period_ns
    await owned.run(0.0)
    assert owned.world.tick == 10
    assert len(owned.poses[0]) == 1, "the poses of the missed ticks are not sent now"
    owned.owner.ticks.due_ns -= 1000 * owned.owner.ticks.period_ns
    await owned.run(0.01)
    assert owned.world.tick <= 10 + 1 + LARGEST_CATCH_UP + 2


def test_poses_after_a_stall_are_recent():
    async def main(clock):
        owned = Owned(clock)
        running = asyncio.create_task(owned.owner.run())
        await clock.sleep(0.05)
        before, steps = len(owned.poses[0]), owned.world.tick
        time.sleep(0.15)  # noqa: ASYNC251 - that is what hangs
        await clock.sleep(0.015)
        running.cancel()
        return [age for _, age in owned.poses[0][before:]], owned.world.tick - steps

    ages, steps = run_wall(main)
    assert ages
    assert max(ages) < 0.05, "not 0.15 s: the world has made up for it"
    assert steps >= 15


def test_a_tick_that_comes_late_shows_the_world_as_it_was_when_it_was_due():
    async def main(clock):
        bus = Bus(clock)
        bus.port(0)
        boxes = {
            topic: topic.mailbox(clock)
            for topic in (DRONE_TOPICS.pose, DRONE_TOPICS.truth)
        }
        for topic, box in boxes.items():
            bus.subscribe(topic, 0, 0, box)
        owner = WorldOwner(
            bus, CFIntegrator([0], np.zeros((1, 3))), SimulatedMocap([0], 1), 100.0
        )
        for _ in range(5):  # truth comes with each fifth step
            owner.step(late=0.004)
        return boxes[DRONE_TOPICS.pose].peek().age, *(
            box.age() for box in boxes.values()
        )

    assert run_virtual(main) == pytest.approx((0.004, 0.004, 0.004))


class Frames:
    """A part of the process that takes the frames of the cameras."""

    def __init__(self):
        self.taken = []

    def take_frame(self, frame):
        self.taken.append(frame)


@virtual
async def test_a_taker_gets_all_poses_of_an_exposure_at_once_with_their_age(clock):
    owned = Owned(clock, latency_steps=2, dropout=0.5)
    frames = Frames()
    owned.owner.takers.append(frames)
    for _ in range(8):
        owned.owner.step(late=0.004)
    assert len(frames.taken) == 6, "the first exposure arrives after two steps"
    assert frames.taken[0].age == pytest.approx(0.024)
    for row in (0, 1):
        shown = [frame.pose(row) for frame in frames.taken if frame.seen[row]]
        heard = [pose for pose, _ in owned.poses[row]]
        assert 0 < len(shown) < 6
        assert [(p.age, *p.flat) for p in shown] == [(p.age, *p.flat) for p in heard]


@virtual
async def test_only_drones_that_are_read_are_published(clock):
    bus = Bus(clock)
    sent = []
    for i in (0, 1):
        port = bus.port(i)
        port.publish = lambda topic, value, age, i=i: sent.append((i, topic.name))
    world = CFIntegrator((0, 1), np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0]]))
    owner = WorldOwner(bus, world, SimulatedMocap((0, 1), 1), 100.0)
    for _ in range(25):
        owner.step()
    assert sent == []
    for topic in (DRONE_TOPICS.pose, DRONE_TOPICS.truth, DRONE_TOPICS.body):
        bus.subscribe(topic, 1, 1, topic.mailbox(clock))
    for _ in range(25):
        owner.step()
    assert sent.count((1, "pose")) == 25
    assert sent.count((1, "truth")) == 5
    assert sent.count((1, "body")) == 1
    assert not [i for i, _ in sent if i == 0]


@virtual
async def test_a_late_reader_of_a_body_hears_at_once_how_it_is(clock):
    owned = Owned(clock)
    for _ in range(30):
        owned.owner.step()
    owned.world.impact[1] = 100.0
    box = DRONE_TOPICS.body.mailbox(clock)
    owned.bus.subscribe(DRONE_TOPICS.body, 1, 1, box)
    assert "crashed" in box.peek().harm
    assert box.age() == 0.0


@virtual
async def test_the_engine_of_a_user_may_take_poses_one_by_one(clock):
    owned = Owned(clock, dropout=0.5)
    told = []
    world = owned.world
    owned.owner.world = SimpleNamespace(
        ids=world.ids,
        states=world.states,
        step=world.step,
        state=world.state,
        see=lambda i, pose: told.append((i, *pose.flat)),
    )
    for _ in range(10):
        owned.owner.step()
    assert 0 < len(told) < 20
    for i in (0, 1):
        heard = [(i, *pose.flat) for pose, _ in owned.poses[i]]
        assert [row for row in told if row[0] == i] == heard


def count_calls(work):
    """How often `work` calls a function of the package."""
    calls = []

    def note(frame, event, argument):
        if event == "call" and frame.f_code.co_filename.startswith(PACKAGE_FOLDER):
            calls.append(frame.f_code.co_qualname)

    gc.collect()
    gc.disable()  # it would call what is garbage of other tests
    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
        gc.enable()
    return len(calls)


@pytest.mark.parametrize("delay", [0, 3])
@pytest.mark.parametrize("make", [CFIntegrator, CrazyflieWorld])
def test_a_steady_step_calls_python_as_often_for_a_hundred_drones_as_for_three(
    make, delay
):
    async def count(clock, n):
        bus = Bus(clock)
        for i in range(n):
            bus.port(i)
        world = make(range(n), np.array([[float(i), 0.0, 1.0] for i in range(n)]))
        owner = WorldOwner(
            bus, world, SimulatedMocap(range(n), 1), 100.0, trace=Trace(), delay=delay
        )
        owner.takers.append(Frames())
        for i in range(n):
            owner.link(i, "fpqr")

        def step():
            for _ in range(100):
                owner.commands.inputs[:, 0] = 0.3
                owner.commands.is_new[:] = 1
                owner.step()

        step()
        return count_calls(step)

    async def main(clock):
        return [await count(clock, n) for n in (3, 100)]

    few, many = run_virtual(main)
    assert few == many


class Kept:
    """In a drone's place: what arrives."""

    def __init__(self):
        self.got = []

    def send(self, command):
        self.got.append(command)

    def cut(self):
        self.got.append("cut")


def lagging_world(delay=0.0):
    return CFIntegrator(
        [0], np.array([[0.0, 0.0, 1.0]]), lags=InputLags(rates=0.03, delay=delay)
    )


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_a_link_that_is_late_is_the_same_as_a_plant_that_is(steps):
    late, plain = lagging_world(delay=0.01 * steps), lagging_world()
    link = DelayedLink(plain.link(0), steps)
    draw = np.random.default_rng(1)
    for _ in range(60):
        command = FPQR(
            np.array([PAPER_PLATFORM.weight, 0.0, 0.0, 0.0])
            + 0.05 * draw.standard_normal(4)
        )
        late.link(0).send(command)
        link.send(command)
        link.advance()
        plain.step()
        late.step()
        assert np.array_equal(plain.states, late.states)


def test_all_that_is_on_its_way_arrives_once_and_in_order():
    kept = Kept()
    link = DelayedLink(kept, 2)
    for command in ("a", "b"):
        link.send(command)
    link.advance()
    link.send("c")
    assert kept.got == []
    link.advance()
    link.advance()
    assert kept.got == ["a", "b"]
    link.advance()
    assert kept.got == ["a", "b", "c"]


def test_a_cut_overtakes_what_is_on_its_way():
    kept = Kept()
    link = DelayedLink(kept, 2)
    link.send("a")
    link.cut()
    for _ in range(5):
        link.advance()
    assert kept.got == ["cut"]
