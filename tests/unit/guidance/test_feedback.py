"""CFDistributedFeedback: when `step` runs, what it gets, and what becomes of its errors; in virtual time."""

import asyncio
import dataclasses
import math

import numpy as np
import pytest
from pilots import make_pilot, tick
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import ConfigError, Hung
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.flight.tick import FlightTick
from crazychoir.guidance import user_hook
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.member import Interrupted, Member
from crazychoir.runtime.clock import run_virtual
from crazychoir.safety.rules.guard import Fence
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.common.links import SimulatedLink
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.team import graph as graphs
from crazychoir.team.communicator import Communicator
from crazychoir.types import Acceleration, Pose, State

TICK = 0.01


class Told(CFDistributedFeedback):
    """A law that does what the test says at each step: raise it, or return it."""

    def __init__(
        self, says=lambda me, heard: Acceleration(-2.0 * me.v), rate=100.0, duration=3.0
    ):
        self.says, self.rate, self.duration = says, rate, duration
        self.heard, self.times = [], []

    def step(self, me, heard):
        self.heard.append(dict(heard))
        self.times.append(self.member.clock.now())
        return self.says(me, heard)


class Drone:
    """Drone 0 of three in a row: it hovers in a simulated world and hears drone 1."""

    def __init__(self, clock, law):
        self.clock, self.law = clock, law
        bus = self.bus = Bus(clock)
        ports = [bus.port(i) for i in range(3)]
        self.neighbor = ports[1]
        self.world = CFIntegrator((0,), np.array([[0.0, 0.0, 1.0]]))
        fence = Fence.box((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5))
        config = default_swarm(3)
        self.pilot = make_pilot(
            ports[0], SimulatedLink(self.world, 0), config.flight, fence
        )
        self.pilot.row.mode = Mode.HOVER
        law.bind(
            Member(0, config, clock, Communicator(ports[0], graphs.path(3)), self.pilot)
        )

    def tick(self, neighbor=True):
        """A period goes by in the world; then the neighbour is heard, and the cameras are."""
        self.world.step()
        if neighbor:
            self.neighbor.publish(DRONE_TOPICS.state, State.at((1.0, 0.0, 1.0)))
        tick(self.pilot, Pose(self.world.state(0).flat[[0, 1, 2, 6, 7, 8, 9]]))

    async def fly(self, seconds, neighbor=True):
        for _ in range(round(seconds / TICK)):
            await self.clock.sleep(TICK)
            self.tick(neighbor)


async def end_of(law):
    """What ends the law; a task may not end with SystemExit."""
    try:
        return await law.run_law()
    except (ValueError, Hung, Interrupted, SystemExit) as error:
        return error


async def flown(clock, law, seconds=None, neighbor=True):
    """The drone after the law's duration, or some seconds; and the law's end, a task that returns its error."""
    drone = Drone(clock, law)
    await drone.fly(0.1)
    ending = asyncio.create_task(end_of(law))
    await drone.fly(law.duration + 0.1 if seconds is None else seconds, neighbor)
    return drone, ending


# When it steps ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [100.0, 50.0, 40.0, 33.0, 7.0])
def test_it_steps_at_its_rate_on_average_whatever_that_of_the_poses(rate):
    async def main(clock):
        law = Told(rate=rate)
        _, ending = await flown(clock, law)
        assert await ending is None
        return law.times

    times = run_virtual(main)
    assert len(times) == pytest.approx(3.0 * rate, abs=1.5)
    gaps = np.diff(times)[1:]
    assert max(gaps) <= 1.0 / rate + TICK + 1e-9
    assert min(gaps) >= 1.0 / rate - TICK - 1e-9


class Timed(Told):
    """Keeps how long it has run in each step."""

    def step(self, me, heard):
        self.elapsed_times.append(self.elapsed)
        return super().step(me, heard)


@virtual
async def test_it_knows_how_long_it_runs(clock):
    law = Timed(rate=50.0)
    law.elapsed_times = []
    before = law.elapsed
    _, ending = await flown(clock, law)
    assert await ending is None
    assert before == 0.0
    assert law.elapsed_times == pytest.approx(
        np.array(law.times) - law.times[0] + law.elapsed_times[0]
    )
    assert 0.0 <= law.elapsed_times[0] <= 0.02
    assert law.elapsed_times[-1] == pytest.approx(3.0, abs=0.03)


@virtual
async def test_late_states_do_not_make_it_catch_up(clock):
    law = Told(rate=50.0)
    drone, ending = await flown(clock, law, seconds=1.0)
    before = len(law.times)
    await clock.sleep(0.5)
    await drone.fly(0.5)
    assert len(law.times) - before == pytest.approx(25, abs=1)
    assert min(np.diff(law.times)) >= 0.5 / law.rate - 1e-9
    ending.cancel()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_each_law_hears_of_this_tick_whichever_drone_is_seen_first(order):
    async def main(clock):
        bus, config = Bus(clock), default_swarm(2)
        world = CFIntegrator((0, 1), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]))
        laws = [Told(), Told()]
        shared = FlightTick(bus, 2)
        for port, law in zip([bus.port(0), bus.port(1)], laws, strict=True):
            fence = Fence.box((-3, -3, -0.2), (3, 3, 2))
            seen = VelocityFilter()
            pilot = make_pilot(
                port,
                SimulatedLink(world, port.address),
                config.flight,
                fence,
                state_filter=seen,
                shared=shared,
            )
            pilot.row.mode = Mode.HOVER
            law.bind(
                Member(
                    port.address,
                    config,
                    clock,
                    Communicator(port, graphs.path(2)),
                    pilot,
                )
            )
        endings = [asyncio.create_task(law.run_law()) for law in laws]
        for k in range(10):
            await clock.sleep(TICK)
            for i in order:
                pose = Pose(np.array([i, 0.1 * k, 1.0, 0.0, 0.0, 0.0, 1.0]))
                shared.see(laws[i].member.pilot.row.index, pose)
            shared.run()
        await clock.sleep(TICK / 2)
        for ending in endings:
            ending.cancel()
        return [[heard[1 - i].p[1] for heard in laws[i].heard] for i in (0, 1)]

    for heard in run_virtual(main):
        assert heard[1:] == pytest.approx(
            [0.1 * k for k in range(10)][-len(heard) + 1 :]
        )


@virtual
async def test_what_it_wants_is_flown_in_the_same_tick(clock):
    law = Told(lambda me, heard: Acceleration(np.array([1.0, 0.0, 0.0])))
    drone, ending = await flown(clock, law, seconds=0.0)
    await drone.fly(2 * TICK)
    assert drone.pilot.mode is Mode.FOLLOW
    assert drone.pilot.row.drone["reference_ns"] == clock.now_ns()
    ending.cancel()


@virtual
async def test_it_does_not_step_before_the_law_nor_after_it(clock):
    law = Told(duration=1.0)
    drone = Drone(clock, law)
    await drone.fly(0.5)
    assert law.times == []
    began = clock.now()
    ending = asyncio.create_task(law.run_law())
    await drone.fly(2.0)
    await ending
    assert law.times[0] == pytest.approx(began + TICK)
    assert law.times[-1] == pytest.approx(began + 1.0, abs=TICK)


# What it hears ------------------------------------------------------------------------------------------------------


@virtual
async def test_it_hears_its_neighbours_with_their_ages_and_no_stale_ones(clock):
    law = Told()
    drone, ending = await flown(clock, law, seconds=1.0)
    assert list(law.heard[-1]) == [1]
    assert law.heard[-1][1].p == pytest.approx([1.0, 0.0, 1.0])
    await drone.fly(1.0, neighbor=False)
    ages = [heard[1].age for heard in law.heard if 1 in heard]
    assert max(ages) == pytest.approx(DRONE_TOPICS.state.max_age, abs=TICK)
    assert law.heard[-1] == {}
    assert law._running.unheard[1] / law.rate == pytest.approx(
        1.0 - DRONE_TOPICS.state.max_age, abs=0.02
    )
    ending.cancel()


@virtual
async def test_a_neighbour_that_moves_is_heard_where_it_is_though_messages_are_lost(
    clock,
):
    law = Told()
    drone = Drone(clock, law)
    await drone.fly(0.1)
    ending = asyncio.create_task(law.run_law())
    for k in range(100):
        await clock.sleep(TICK)
        if k % 5 == 0:
            drone.neighbor.publish(
                DRONE_TOPICS.state,
                State.at((1.0 + 0.5 * k * TICK, 0.0, 1.0), (0.5, 0.0, 0.0)),
            )
        drone.tick(neighbor=False)
        assert law.heard[-1][1].p == pytest.approx([1.0 + 0.5 * k * TICK, 0.0, 1.0])
        assert law.heard[-1][1].age == pytest.approx(k % 5 * TICK)
        assert law.heard[-1][1].v == pytest.approx([0.5, 0.0, 0.0])
    ending.cancel()


@virtual
async def test_a_pause_of_the_law_is_not_made_up_for_in_one_step(clock):
    law = Told()
    drone, ending = await flown(clock, law, seconds=0.5)
    await clock.sleep(0.3)
    for k in range(30):
        drone.neighbor.publish(
            DRONE_TOPICS.state,
            State.at((1.0 + 0.5 * k * TICK, 0.0, 1.0), (0.5, 0.0, 0.0)),
        )
    drone.tick(neighbor=False)
    assert law.heard[-1][1].v == pytest.approx([0.5, 0.0, 0.0])
    ending.cancel()


# Its errors ---------------------------------------------------------------------------------------------------------


def failing(error):
    """Return a law that comes to rest; its 51st step raises the error."""

    def raising(me, heard):
        if len(law.times) > 50:
            raise error
        return Acceleration(-2.0 * me.v)

    law = Told(raising)
    return law


@pytest.mark.parametrize(
    "error", [ValueError("no idea"), SystemExit(3), Hung("a second")], ids=repr
)
def test_an_error_of_step_ends_the_law_and_the_pilot_flies_on(error):
    law = failing(error)

    async def main(clock):
        drone, ending = await flown(clock, law, seconds=2.0)
        assert await ending is error
        assert len(law.times) == 51, "called no more"
        assert drone.pilot.state.age == pytest.approx(0.0, abs=1e-9)
        assert drone.world.state(0).p == pytest.approx([0.0, 0.0, 1.0], abs=0.05)

    run_virtual(main)


@pytest.mark.parametrize(
    "error",
    [asyncio.CancelledError("of another"), StopIteration(), GeneratorExit()],
    ids=lambda error: repr(error),
)
def test_what_asyncio_takes_for_its_own_ends_the_law_as_an_error_and_not_the_tick(
    error,
):
    law = failing(error)

    async def main(clock):
        drone = Drone(clock, law)
        await drone.fly(0.1)
        ending = asyncio.create_task(law.run_law())
        await drone.fly(2.0)
        with pytest.raises(
            RuntimeError,
            match=r"drone 0: step raised (CancelledError|StopIteration|GeneratorExit)",
        ):
            await ending
        assert len(law.times) == 51, "called no more"
        assert drone.pilot.state.age == pytest.approx(0.0, abs=1e-9)

    run_virtual(main)


@pytest.mark.parametrize(
    "wanted", [Acceleration("abc"), Acceleration(["a", "b", "c"])], ids=repr
)
def test_an_unflyable_reference_does_not_end_the_tick(wanted):
    async def main(clock):
        drone, ending = await flown(clock, Told(lambda me, heard: wanted), seconds=1.0)
        assert drone.pilot.mode is Mode.HOVER
        assert drone.world.state(0).p == pytest.approx([0.0, 0.0, 1.0], abs=0.05)
        ending.cancel()

    run_virtual(main)


@virtual
async def test_none_lets_it_come_to_rest_and_hover_at_once_and_it_is_asked_on(clock):
    law = Told(
        lambda me, heard: (
            Acceleration(np.array([0.5, 0.0, 0.0])) if len(law.times) <= 100 else None
        )
    )
    drone, ending = await flown(clock, law, seconds=1.01)
    assert np.linalg.norm(drone.world.state(0).v) > 0.1
    await drone.fly(2 * TICK)
    assert drone.pilot.mode is Mode.HOVER
    await drone.fly(1.8)
    assert np.linalg.norm(drone.world.state(0).v) < 0.05
    assert len(law.times) >= 280, "the law may hear a neighbour again"
    await drone.fly(0.3)
    assert await ending is None


@virtual
async def test_a_law_without_neighbours_hovers_to_its_end_and_counts_unheard_time(
    clock,
):
    law = Told(
        lambda me, heard: Acceleration(-2.0 * me.v) if heard else None, duration=10.0
    )
    drone, ending = await flown(clock, law, seconds=1.0)
    place = drone.world.state(0).p.copy()
    await drone.fly(9.2, neighbor=False)
    assert await ending is None
    assert drone.pilot.mode is Mode.HOVER
    assert drone.world.state(0).p == pytest.approx(place, abs=0.02)
    assert law._running.unheard[1] / law.rate == pytest.approx(
        9.0 - DRONE_TOPICS.state.max_age, abs=0.05
    )


@virtual
async def test_a_pilot_that_lands_unheard_names_the_drones_that_it_does_not_hear(clock):
    law = Told()
    drone, ending = await flown(clock, law, seconds=1.0)
    await drone.fly(1.0, neighbor=False)
    drone.pilot.land("landing on command")
    await drone.fly(0.1, neighbor=False)
    assert (
        str(await ending)
        == "drone 0: landing: landing on command; hears nothing of drone(s) 1"
    )


class High(Told):
    """A law that says at which height it takes off, or fails to."""

    def __init__(self, height):
        super().__init__()
        self._height = height

    def height(self):
        return self._height(self)


@virtual
async def test_a_height_beyond_the_fence_is_refused_before_any_drone_flies(clock):
    member = Drone(clock, Told()).law.member
    with pytest.raises(
        ConfigError, match=r"drone 0: height\(\): found 4.0; allowed: 0 to 2.5 m"
    ):
        High(lambda law: law.id + 4.0).foresee(member)
    for well in (
        lambda law: law.id + 2.5,
        lambda law: None,
        lambda law: law.known_after_bind,
    ):
        law = High(well)
        law.foresee(member)
        assert not hasattr(law, "member"), "its mission has not begun"


def forever(law):
    while True:
        pass


@pytest.mark.parametrize(
    ("height", "said"),
    [
        (
            lambda law: 1.0 / 0.0,
            r"mission .*test_feedback\.py:\d+: height\(\): found ZeroDivisionError.*or None",
        ),
        (forever, r"height\(\): found no end within 0.3 s"),
        (
            lambda law: np.array([0.5, 1.0]),
            r"drone 0: height\(\): found ndarray \(2,\); allowed: 0 to 2.5 m.*single num",
        ),
        (lambda law: np.ones(1), r"found ndarray \(1,\)"),
        (lambda law: "high", r"found str 'high'"),
        (lambda law: float("nan"), r"found nan"),
    ],
    ids=["raises", "hangs", "array", "array of one", "text", "nan"],
)
def test_a_height_that_fails_or_is_no_number_is_refused_before_any_drone_flies(
    monkeypatch, height, said
):
    hasty = dataclasses.replace(user_hook.USER_CODE_TIMES, hook_limit=0.3)
    monkeypatch.setattr(user_hook, "USER_CODE_TIMES", hasty)

    @virtual
    async def refused(clock):
        law, member = High(height), Drone(clock, Told()).law.member
        with pytest.raises(ConfigError, match=said):
            law.foresee(member)
        assert not hasattr(law, "member")

    refused()


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        *(
            ("rate", value, "Hz, 0.001 to 1000")
            for value in (0, "fast", 1e-300, 3e9, math.inf)
        ),
        *(("duration", value, "s, above 0") for value in (-1.0, 0.0, math.nan)),
    ],
)
def test_an_invalid_rate_or_duration_is_refused_before_any_drone_flies(
    name, value, allowed
):
    @virtual
    async def refused(clock):
        law, member = High(lambda law: 1.0), Drone(clock, Told()).law.member
        law.duration = math.inf
        law.foresee(member)
        setattr(law, name, value)
        with pytest.raises(
            ConfigError, match=rf"drone 0: High\.{name}.*a number of {allowed}"
        ):
            law.foresee(member)

    refused()


@pytest.mark.parametrize("duration", [math.inf, 1e300, np.float32(1e30)])
def test_a_law_may_last_for_ever(duration):
    @virtual
    async def flown_for_ever(clock):
        law = Told()
        law.duration = duration
        drone, ending = await flown(clock, law, seconds=5.0)
        assert not ending.done()
        drone.pilot.land("enough")
        await drone.fly(0.1)
        assert isinstance(await ending, Interrupted)

    flown_for_ever()


@virtual
async def test_a_height_may_be_a_number_of_numpy_and_must_be_a_method(clock):
    member = Drone(clock, Told()).law.member
    High(lambda law: np.float32(1.0)).foresee(member)
    High(lambda law: np.array(1.0)).foresee(member)
    law = High(None)
    law.height = 1.0
    with pytest.raises(
        ConfigError, match=r"height: found height = float 1.0; allowed: def height\(\)"
    ):
        law.foresee(member)


@virtual
async def test_a_pilot_that_lands_ends_the_law(clock):
    law = Told()
    drone, ending = await flown(clock, law, seconds=1.0)
    drone.pilot.land("landing on command")
    await drone.fly(0.1)
    error = await ending
    assert isinstance(error, Interrupted)
    assert str(error) == "drone 0: landing: landing on command"
