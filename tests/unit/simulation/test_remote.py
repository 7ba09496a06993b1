"""A drone and its body at two ports: what is obeyed, what is refused, what stops without commands."""

import asyncio
from functools import partial

import numpy as np
import pytest
from message_parts import taking_parts
from robots import world_of
from virtual_time import virtual

from crazychoir.bus.codec import encode
from crazychoir.bus.message import Message
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS
from crazychoir.config.checks import WORLD_URIS
from crazychoir.errors import Refused
from crazychoir.numerics.math3d import yaw_of
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.runtime.clock import run_virtual
from crazychoir.simulation import remote
from crazychoir.simulation.lightweight.integrator import (
    LIGHTWEIGHT_COMMAND_TIMEOUT,
    CFIntegrator,
)
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.remote import (
    REMOTE_TIMEOUTS,
    BodyRequests,
    OwnerWatch,
    RemoteBody,
    RemoteLink,
)
from crazychoir.types import FPQR, FRPY, XYZ, Acc, Body, Drive, Pose, Vel

said: list[str] = []
HOVER = FPQR(np.array([PAPER_PLATFORM.weight, 0.0, 0.0, 0.0]))


@pytest.fixture(autouse=True)
def listening(monkeypatch):
    """What is logged, in `said`."""
    said.clear()
    monkeypatch.setattr(
        remote.log, "_log", lambda level, text, arguments: said.append(text % arguments)
    )


class Pair:
    """Drone 3 and its body in the air, on one bus."""

    def __init__(self, clock, timeout=LIGHTWEIGHT_COMMAND_TIMEOUT, heard=True):
        self.clock, bus = clock, Bus(clock)
        self.drone, self.there = bus.port(3), bus.port(PORT_ADDRESSES.body_offset + 3)
        self.world = CFIntegrator((3,), np.array([[0.0, 0.0, 2.0]]))
        self.world.command_timeout = timeout
        self.obeyed = []
        link = self.world.link(3, "fpqr")
        self.body = RemoteBody(
            self.there,
            self.world,
            link,
            "fpqr",
            lambda: self.obeyed.append(clock.now()),
        )
        self.link = RemoteLink(self.drone)
        if heard:
            self.there.publish(DRONE_TOPICS.body, Body())

    @property
    def thrust(self):
        """N, as it is commanded."""
        return float(self.world.commands[0, 0])


@virtual
async def test_a_command_arrives(clock):
    pair = Pair(clock)
    pair.link.send(FPQR(np.array([0.1, 1.0, 2.0, 3.0])))
    assert pair.world.commands[0].tolist() == [0.1, 1.0, 2.0, 3.0]
    assert pair.obeyed == [0.0]
    await clock.sleep(0.2)
    assert pair.body.silence == pytest.approx(0.2)


@virtual
async def test_nothing_is_sent_before_it_is_known_whether_the_body_flies(clock):
    for flying in (True, False):
        pair, found = Pair(clock, heard=False), []
        pair.link.found_flying = lambda found=found: found.append(True)
        pair.link.send(FPQR(np.zeros(4)))
        assert pair.obeyed == []
        for _ in range(2):
            pair.there.publish(DRONE_TOPICS.body, Body(flying=flying))
        assert found == [True] * flying
        pair.link.send(FPQR(np.zeros(4)))
        assert pair.obeyed == [0.0]


@virtual
async def test_a_body_flies_when_commands_have_brought_it_into_the_air(clock):
    pair = Pair(clock)
    assert not pair.body.flying, "no command has flown it"
    pair.link.send(FPQR(np.zeros(4)))
    assert pair.body.flying
    pair.link.cut()
    assert not pair.body.flying


@virtual
async def test_commands_of_another_kind_than_the_swarm_file_says_are_refused_and_that_is_said_once(
    clock,
):
    pair = Pair(clock)
    for _ in range(2):
        pair.link.send(FRPY(np.zeros(4)))
    assert pair.body.refused == 2
    assert said == ["drone 3: its agent sends FRPY, the swarm file says fpqr"]
    assert pair.thrust == PAPER_PLATFORM.weight, "it hovers, as it did"


@virtual
async def test_other_senders_are_ignored_and_invalid_commands_are_counted(clock):
    pair = Pair(clock)
    other = pair.drone.bus.port(4)
    wrong = [
        (other, encode(FPQR(np.ones(4)))),
        (pair.drone, encode(FPQR(np.array([np.nan, 0.0, 0.0, 0.0])))),
        (pair.drone, encode(XYZ("go_to", np.zeros(4)))),
        (pair.drone, encode("up")),
        (pair.drone, b"\xff"),
    ]
    for port, payload in wrong:
        port.send(
            Message(DRONE_TOPICS.command, port.address, payload),
            (PORT_ADDRESSES.body_offset + 3,),
        )
    other.send(
        Message(MESSAGE_TOPICS.cut, other.address, encode(None)),
        (PORT_ADDRESSES.body_offset + 3,),
    )
    assert pair.there.counters.malformed == len(wrong)
    assert pair.thrust == PAPER_PLATFORM.weight, "it hovers, as it did"
    assert pair.obeyed == []
    pair.link.send(FPQR(np.ones(4)))
    assert pair.thrust == 1.0, "no cut has reached its motors"


@virtual
async def test_a_cut_goes_out_again_with_each_tick(clock):
    pair = Pair(clock)
    cuts = []
    pair.there.handlers[MESSAGE_TOPICS.cut.number] = taking_parts(
        lambda *message: cuts.append(message[0])
    )
    pair.link.cut()
    pair.link.send(HOVER)
    assert (cuts, pair.obeyed) == ([3, 3], []), "and no command any more"


@virtual
async def test_a_body_with_cut_motors_ignores_commands_and_reports_it_once(clock):
    pair = Pair(clock)
    pair.link.cut()
    RemoteLink(pair.drone).send(HOVER)  # its agent was started again
    RemoteLink(pair.drone).send(HOVER)
    for _ in range(10):
        pair.world.step()
    assert pair.world.state(3).p[2] < 1.99, "it falls"
    assert said == [
        "drone 3: its motors were cut: they stay off until its world is started again"
    ]


@virtual
async def test_an_uncommanded_drone_has_no_thrust(clock):
    pair = Pair(clock)
    await clock.sleep(10.0)
    pair.body.look()
    assert pair.thrust == PAPER_PLATFORM.weight, "no command has ever flown it"
    pair.there.publish(DRONE_TOPICS.body, Body())
    pair.link.send(HOVER)
    await clock.sleep(0.9 * LIGHTWEIGHT_COMMAND_TIMEOUT)
    pair.body.look()
    assert pair.thrust == PAPER_PLATFORM.weight
    await clock.sleep(0.2 * LIGHTWEIGHT_COMMAND_TIMEOUT)
    for _ in range(3):
        pair.body.look()
    assert pair.thrust == 0.0
    assert said == ["drone 3: no command for 0.55 s, limit 0.50 s: no thrust"]
    pair.link.send(HOVER)
    assert pair.thrust == PAPER_PLATFORM.weight, "a command has come again"


@virtual
async def test_nothing_is_sent_to_a_body_that_is_silent_until_it_is_heard_again(clock):
    pair, found = Pair(clock), []
    pair.link.found_flying = lambda: found.append(clock.now())
    pair.there.publish(DRONE_TOPICS.body, Body(flying=True))
    pair.link.send(HOVER)
    assert (pair.link.unheard(), pair.link.flying(), pair.obeyed) == (
        False,
        True,
        [0.0],
    )
    await clock.sleep(DRONE_TOPICS.body.max_age + 0.1)
    pair.link.send(HOVER)
    assert (pair.link.unheard(), pair.link.flying(), pair.obeyed) == (True, True, [0.0])
    pair.there.publish(DRONE_TOPICS.body, Body(flying=True))
    pair.link.send(HOVER)
    assert (pair.link.unheard(), found) == (False, [clock.now()]), (
        "its firmware lands it, say"
    )
    assert pair.obeyed == [0.0, clock.now()]
    await clock.sleep(REMOTE_TIMEOUTS.owner_gone)
    assert not pair.link.flying(), "it does not come back"


@virtual
async def test_an_engine_with_firmware_is_left_alone(clock):
    pair = Pair(clock, timeout=None)
    pair.link.send(HOVER)
    await clock.sleep(10.0)
    pair.body.look()
    assert pair.thrust == PAPER_PLATFORM.weight


def rises(k, weight):
    """Rates of zero, with the thrust for a climb, then of hovering."""
    return FPQR(
        np.array(
            [weight * (1.06 if k < 100 else 0.97 if k < 180 else 1.0), 0.0, 0.0, 0.0]
        )
    )


def flies(k, weight):
    """Velocities: up, then aside."""
    return Vel(np.array([0.3 * (k > 150), 0.0, 0.4 if k < 150 else 0.0, 0.0]))


@pytest.mark.parametrize(("kind", "command"), [("fpqr", rises), ("vel", flies)])
def test_a_drone_without_further_streamed_commands_is_landed_by_its_planner(
    kind, command
):
    run_virtual(partial(landed_by_its_planner, kind, command))


async def landed_by_its_planner(kind, command, clock):
    bus = Bus(clock)
    drone, there = bus.port(3), bus.port(PORT_ADDRESSES.body_offset + 3)
    world = CrazyflieWorld((3,), np.zeros((1, 3)), np.array([1.0]))
    body = RemoteBody(there, world, world.link(3, kind), kind)
    link = RemoteLink(drone)
    there.publish(DRONE_TOPICS.body, Body())
    highest = lowest = 0.0
    for k in range(900):
        await clock.sleep(world.dt)
        if k < 300:
            link.send(command(k, world.platforms[0].weight))
        world.step()
        world.see(3, Pose(world.states[0, [0, 1, 2, 6, 7, 8, 9]]))
        body.look()
        state = world.state(3)
        highest, lowest = max(highest, state.p[2]), min(lowest, state.v[2])
    assert highest > 0.2
    assert (world.resting(3), world.harm(3)) == (True, "")
    assert lowest > -0.6, "it does not fall"
    assert state.p[0] < 1.5
    assert not any(world.onboard[3].record["motors"])
    assert said == ["drone 3: no command for 0.41 s, limit 0.40 s: landing"]


@virtual
async def test_a_drone_with_an_endless_plan_and_no_commands_is_landed(clock):
    bus = Bus(clock)
    drone, there = bus.port(3), bus.port(PORT_ADDRESSES.body_offset + 3)
    world = CrazyflieWorld((3,), np.zeros((1, 3)), np.array([2.0]))
    body = RemoteBody(there, world, world.link(3, "xyz"), "xyz")
    link = RemoteLink(drone)
    there.publish(DRONE_TOPICS.body, Body())

    async def live(seconds, command=None):
        for k in range(round(seconds / world.dt)):
            await clock.sleep(world.dt)
            there.publish(DRONE_TOPICS.body, Body(flying=body.flying))
            if command is not None and k % 10 == 0:
                link.send(command)
            world.step()
            world.see(3, Pose(world.states[0, [0, 1, 2, 6, 7, 8, 9]]))
            body.look()

    await live(5.0, XYZ("line", np.array([0.0, 0.0, 0.5, 2.0, 0.2])))
    assert world.state(3).p[2] == pytest.approx(0.5, abs=0.1)
    await live(0.9)
    assert world.state(3).p[2] == pytest.approx(0.5, abs=0.1)
    await live(5.0)
    assert world.resting(3)
    assert world.harm(3) == ""
    assert yaw_of(world.state(3).q) == pytest.approx(2.0, abs=0.05)
    assert not any(world.onboard[3].record["motors"])
    assert said == ["drone 3: no command for 1.01 s, limit 1.00 s: landing"]


@virtual
async def test_an_arm_request_is_answered_with_its_outcome(clock):
    bus = Bus(clock)
    drone, there = bus.port(3), bus.port(PORT_ADDRESSES.body_offset + 3)
    world, answers = CFIntegrator((3,), np.array([[0.0, 0.0, 2.0]])), ["armed"]

    async def arm():
        if answers:
            return answers.pop()
        raise Refused("drone 3", "its firmware refuses to arm")

    body = RemoteBody(
        there, world, world.link(3, "fpqr"), "fpqr", requests=BodyRequests(arm=arm)
    )
    link = RemoteLink(drone)
    assert await link.arm() == "armed"
    with pytest.raises(Refused, match="refuses to arm"):
        await link.arm()
    answers.append("armed")
    body.stop("it is wild")
    with pytest.raises(Refused, match="motors were cut"):
        await link.arm()
    assert answers
    with pytest.raises(
        Refused, match=r"drone 4: .*no answer of its world's owner .* within 3 s"
    ):
        await RemoteLink(bus.port(4)).arm()


@virtual
async def test_a_drone_says_what_has_broken_its_body_or_that_it_hears_nothing(clock):
    pair = Pair(clock, heard=False)
    assert (
        pair.link.harm()
        == "its world's owner (crazychoir-world) has not said how it is"
    )
    pair.there.publish(DRONE_TOPICS.body, Body())
    assert pair.link.harm() == ""
    pair.there.publish(DRONE_TOPICS.body, Body("crashed"))
    assert pair.link.harm() == "crashed"
    await clock.sleep(2.0)
    assert (
        pair.link.harm() == "its world's owner (crazychoir-world) is silent for 2.0 s"
    )


@virtual
async def test_an_owner_that_disappears_is_missed_once_and_an_absent_one_is_awaited(
    clock,
):
    pair, gone = Pair(clock), []
    never = RemoteLink(pair.drone.bus.port(4))
    watch = OwnerWatch(
        clock, {3: pair.link, 4: never}, lambda i: gone.append((i, clock.now()))
    )
    watching = asyncio.create_task(watch.run())
    for _ in range(8):
        pair.there.publish(DRONE_TOPICS.body, Body())
        await clock.sleep(0.5)
    assert gone == []
    await clock.sleep(10.0)
    watching.cancel()
    ((drone, when),) = gone
    assert (drone, when) == (
        3,
        pytest.approx(3.5 + REMOTE_TIMEOUTS.owner_gone, abs=0.3),
    )
    assert said == ["drone 4: waiting for its world's owner (crazychoir-world)"]


class Stopped:
    """A clock of a process that was stopped from 2 s to 8 s."""

    def __init__(self):
        self.time = 0.0

    def now(self):
        return self.time

    async def ticks(self, rate):
        for k in range(60):
            self.time = k / rate if k < 8 else 8.0 + (k - 8) / rate
            yield 0


@pytest.mark.parametrize(("speaks", "gone"), [(True, []), (False, [3])])
async def test_a_resumed_process_listens_before_it_declares_an_owner_gone(speaks, gone):
    clock, found = Stopped(), []

    class Owner:
        owner, gone = "its world's owner", REMOTE_TIMEOUTS.owner_gone

        @property
        def silence(self):
            heard = 2.0 if clock.time <= 8.0 or not speaks else clock.time
            return max(0.0, clock.time - heard)

    await OwnerWatch(clock, {3: Owner()}, found.append).run()
    assert found == gone


@pytest.mark.parametrize(
    ("uri", "command"),
    [
        (WORLD_URIS.single_integrator, Vel(np.array([0.5, 0.0, 0.0, 0.0]))),
        (WORLD_URIS.double_integrator, Acc(np.array([0.5, 0.0, 0.0]))),
        (WORLD_URIS.unicycle, Drive(np.array([0.5, 0.1]))),
    ],
)
def test_an_uncommanded_robot_stands_still(uri, command):
    @virtual
    async def test(clock):
        bus, world = Bus(clock), world_of(uri)
        drone, there = bus.port(0), bus.port(PORT_ADDRESSES.body_offset)
        body = RemoteBody(there, world, world.link(0, world.kind), world.kind)
        link = RemoteLink(drone)
        there.publish(DRONE_TOPICS.body, Body())
        link.send(command)
        world.step()
        body.look()
        assert body.flying, "it moves"
        await clock.sleep(1.1 * LIGHTWEIGHT_COMMAND_TIMEOUT)
        body.look()
        world.step()
        assert world.resting(0)
        assert not body.flying

    test()
