"""CFGuidance: its verbs are those of the communicator, and a flight that is not flown raises."""

import asyncio
import contextlib
import inspect
import math

import numpy as np
import pytest
from pilots import make_pilot, tick
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import AgentFailed, ConfigError
from crazychoir.flight.pilot import Pilot
from crazychoir.guidance import guidance as base
from crazychoir.guidance.flights import FLIGHT_LIMITS, fly_until_stopped
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.member import Interrupted, Member
from crazychoir.optimization.algorithms.asynchronous_consensus import (
    AsynchronousConsensus,
)
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.algorithms.gradient_tracking import GradientTracking
from crazychoir.optimization.rounds.checks import require_graph
from crazychoir.planning.figure import circle
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.rules.guard import Fence
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.common.links import SimulatedLink
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.team import graph as graphs
from crazychoir.team.algorithm_run import WakingTimes
from crazychoir.team.communicator import Communicator
from crazychoir.types import FullState, Pose

VERBS = ("send", "receive", "asynchronous_receive", "neighbors_exchange")


TICK = 0.01
WIDE = Fence.box((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5))


def pair(clock):
    """Two guidances that hear each other, each with a pilot on the ground."""
    bus, config, world = (
        Bus(clock),
        default_swarm(2),
        CFIntegrator((0, 1), np.zeros((2, 3))),
    )
    fence = Fence.box((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5))
    for i in (0, 1):
        bus.port(i)
    both = []
    for i in (0, 1):
        guidance = CFGuidance()
        pilot = make_pilot(bus.ports[i], SimulatedLink(world, i), config.flight, fence)
        guidance.bind(
            Member(i, config, clock, Communicator(bus.ports[i], graphs.path(2)), pilot)
        )
        both.append(guidance)
    return both


@contextlib.asynccontextmanager
async def in_the_world(clock, seen=lambda: True, home=(0.0, 0.0, 0.0), fence=WIDE):
    """Yield the guidance and pilot of a drone that stands in a running world. seen: whether cameras see it."""
    bus, config, world = (
        Bus(clock),
        default_swarm(2),
        CFIntegrator((0,), np.array([home])),
    )
    pilot = make_pilot(
        bus.port(0),
        SimulatedLink(world, 0),
        config.flight,
        fence,
    )
    guidance = CFGuidance()
    guidance.bind(
        Member(0, config, clock, Communicator(bus.ports[0], graphs.path(2)), pilot)
    )

    async def turn():
        async for _ in clock.ticks(1.0 / TICK):
            for _ in range(round(TICK / world.dt)):
                world.step()
            tick(
                pilot,
                Pose(world.state(0).flat[[0, 1, 2, 6, 7, 8, 9]]) if seen() else None,
            )

    turning = asyncio.create_task(turn())
    try:
        yield guidance, pilot
    finally:
        turning.cancel()


@contextlib.asynccontextmanager
async def in_the_air(clock):
    """Yield the guidance and pilot of a hovering drone."""
    async with in_the_world(clock) as (guidance, pilot):
        await guidance.take_off()
        yield guidance, pilot


@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_has_the_arguments_and_the_documentation_of_the_communicator(verb):
    assert inspect.signature(getattr(CFGuidance, verb)) == inspect.signature(
        getattr(Communicator, verb)
    )
    assert inspect.getdoc(getattr(CFGuidance, verb)) == inspect.getdoc(
        getattr(Communicator, verb)
    )


@virtual
async def test_the_verbs_talk_to_the_neighbours(clock):
    a, b = pair(clock)
    assert await asyncio.gather(
        a.neighbors_exchange("a"), b.neighbors_exchange("b")
    ) == [{1: "b"}, {0: "a"}]
    await a.send(3, channel="x")
    assert await b.receive(channel="x") == {0: 3}
    await a.send(4, channel="y")
    await clock.sleep(0.01)
    assert await b.asynchronous_receive(channel="y") == {0: 4}


@virtual
async def test_a_take_off_that_is_not_flown_raises_with_the_reason(clock):
    a, _ = pair(clock)
    pilot = a.member.pilot
    tick(pilot, Pose(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])))
    pilot.port.bus.stopped = True
    with pytest.raises(
        Interrupted, match="drone 0: on ground: emergency stop in force"
    ):
        await a.take_off()
    pilot.port.bus.stopped = False
    pilot.cut("emergency stop")
    with pytest.raises(
        Interrupted,
        match="drone 0: stopped: emergency stop: no take-off until its agent is started",
    ):
        await a.take_off()


@virtual
async def test_a_rise_that_the_safety_table_has_stopped_goes_on(clock):
    began = clock.now()
    async with in_the_world(clock, lambda: not 0.6 < clock.now() - began < 0.75) as (
        guidance,
        pilot,
    ):
        await guidance.take_off(1.0)
        assert "pose" in pilot.notes.text, "it was stopped"
        assert guidance.state.p == pytest.approx([0.0, 0.0, 1.0], abs=0.02)


@virtual
async def test_a_low_rise_is_not_over_because_the_floor_is_near_it(clock):
    began = clock.now()
    async with in_the_world(clock, lambda: not 0.05 < clock.now() - began < 0.2) as (
        guidance,
        pilot,
    ):
        await guidance.take_off(0.15)
        assert "pose" in pilot.notes.text, "it was stopped"
        assert guidance.state.p[2] == pytest.approx(0.15, abs=0.02)


@virtual
async def test_a_rise_waits_while_an_operator_holds_the_drone_and_ends_at_the_fence(
    clock,
):
    async with in_the_world(clock) as (guidance, pilot):
        rise = asyncio.create_task(guidance.take_off(2.5))
        await clock.sleep(1.5)
        pilot.hold()
        await clock.sleep(20.0)
        assert not rise.done()
        assert 0.2 < guidance.state.p[2] < 2.0
        pilot.hold(False)
        await rise
        assert guidance.state.p[2] == pytest.approx(
            2.4, abs=FLIGHT_LIMITS.arrival_distance
        ), "inside the fence"


@virtual
async def test_a_height_beyond_the_fence_is_refused_on_the_ground(clock):
    async with in_the_world(clock) as (guidance, pilot):
        with pytest.raises(
            ConfigError, match=r"take_off\(\): found str '1'; .*single number"
        ):
            await guidance.take_off("1")
        for bad in (2.51, -0.1, np.nan, np.inf):
            with pytest.raises(
                ConfigError,
                match=r"drone 0: take_off\(\): .*allowed: 0 to 2.5 m above .*fence.max",
            ):
                await guidance.take_off(bad)
        assert pilot.mode is Mode.GROUND


@virtual
async def test_a_place_outside_the_fence_is_refused_before_the_drone_moves(clock):
    async with in_the_air(clock) as (guidance, pilot):
        began = clock.now()
        with pytest.raises(
            ConfigError,
            match=r"drone 0: go_to\(\) = \[9.0, 0.0, 1.0\]: outside the fence",
        ):
            await guidance.go_to([9.0, 0.0, 1.0])
        assert (clock.now(), pilot.mode, pilot.remaining()) == (began, Mode.HOVER, 0.0)


@virtual
async def test_a_flight_waits_while_an_operator_holds_the_drone(clock):
    async with in_the_air(clock) as (guidance, pilot):
        pilot.hold()
        flight = asyncio.create_task(guidance.go_to([1.0, 0.0, 1.0]))
        await clock.sleep(20.0)
        assert not flight.done()
        assert guidance.state.p == pytest.approx([0.0, 0.0, 1.0], abs=0.02)
        pilot.hold(False)
        await flight
        assert guidance.state.p == pytest.approx(
            [1.0, 0.0, 1.0], abs=FLIGHT_LIMITS.arrival_distance
        )


@virtual
async def test_a_flight_waits_while_the_safety_table_brakes_it(clock):
    async with in_the_air(clock) as (guidance, pilot):
        go_to, refused_until = pilot.go_to, clock.now() + 3.0

        def braking(p, yaw=None, duration=0.0):
            return 0.0 if clock.now() < refused_until else go_to(p, duration=duration)

        pilot.go_to = braking
        await guidance.go_to([1.0, 0.0, 1.0])
        assert guidance.state.p == pytest.approx(
            [1.0, 0.0, 1.0], abs=FLIGHT_LIMITS.arrival_distance
        )


@virtual
async def test_a_trajectory_that_the_safety_table_brakes_is_flown_on_from_there(clock):
    unseen = [math.inf, math.inf]
    way = circle((0.5, 0.0, 1.0), 0.5, 5.0)
    async with in_the_world(
        clock, lambda: not unseen[0] <= clock.now() < unseen[1]
    ) as (guidance, pilot):
        await guidance.take_off(1.0)
        await guidance.go_to(way.sample(0.0).p)
        begins = clock.now()
        for at in (1.5, 4.0):
            gap = [begins + at, begins + at + 0.3]
            clock.call_at(
                round(gap[0] * NS_PER_SECOND), unseen.__setitem__, slice(0, 2), gap
            )
        await guidance.fly(way)
        assert pilot.judge.braked == 2
        assert way.duration + 2.0 < clock.now() - begins < way.duration + 10.0
        assert pilot.gap(way.sample(way.duration).p) < 0.05


@virtual
async def test_a_trajectory_that_has_waited_for_others_is_over_when_it_ends(clock):
    async with in_the_air(clock) as (guidance, pilot):
        way = circle((0.5, 0.0, pilot.state.p[2]), 0.5, 5.0)
        begins = clock.now()
        clock.call_at(round((begins + 4.0) * NS_PER_SECOND), pilot.flights.wait, 10.0)
        await guidance.fly(way)
        assert clock.now() - begins < way.duration + 10.0 + 3.0


@virtual
async def test_a_trajectory_ends_whenever_it_has_begun(clock):
    async with in_the_air(clock) as (guidance, pilot):
        way = circle((0.5, 0.0, pilot.state.p[2]), 0.5, 5.0)
        for late in range(24):
            await clock.sleep(0.01 * late)
            await guidance.go_to(way.sample(0.0).p)
            assert 0.0 < await fly_until_stopped(guidance.member, way) < way.duration


@virtual
async def test_a_trajectory_that_is_held_on_its_way_or_landed_is_not_flown(clock):
    for stop, why in (
        (Pilot.hold, "held"),
        (lambda pilot: pilot.land("so be it"), "landing: so be it"),
    ):
        async with in_the_air(clock) as (guidance, pilot):
            way = circle((0.5, 0.0, pilot.state.p[2]), 0.5, 5.0)
            clock.call_at(clock.now_ns() + 4 * NS_PER_SECOND, stop, pilot)
            with pytest.raises(Interrupted, match=why):
                await guidance.fly(way)


@virtual
async def test_a_flight_that_is_held_for_ever_is_given_up(clock):
    async with in_the_air(clock) as (guidance, pilot):
        pilot.hold()
        began = clock.now()
        with pytest.raises(Interrupted, match=r"does not reach.*held by its operator"):
            await guidance.go_to([1.0, 0.0, 1.0])
        assert clock.now() - began == pytest.approx(base.HELD_FLIGHT_PATIENCE, abs=0.1)


@virtual
async def test_a_landing_waits_while_an_operator_holds_the_drone_but_not_for_safety(
    clock,
):
    async with in_the_air(clock) as (guidance, pilot):
        pilot.hold()
        landing = asyncio.create_task(guidance.land())
        await clock.sleep(20.0)
        assert guidance.state.p == pytest.approx([0.0, 0.0, 1.0], abs=0.02)
        pilot.hold(False)
        await landing
        assert pilot.mode is Mode.GROUND
    async with in_the_air(clock) as (guidance, pilot):
        pilot.hold()
        landing = asyncio.create_task(guidance.land())
        await clock.sleep(1.0)
        pilot.land("pose 0.51 s old")
        await clock.sleep(pilot.remaining() + 1.0)
        assert landing.done()
        assert pilot.mode is Mode.GROUND


@virtual
async def test_an_unseen_drone_does_not_wait_for_ever_to_take_off(clock):
    a, _ = pair(clock)
    with pytest.raises(Interrupted, match="drone 0: no pose within 300 s"):
        await a.take_off()


@virtual
async def test_a_landing_that_does_not_end_on_the_ground_raises(clock):
    async with in_the_air(clock) as (guidance, pilot):
        clock.call_at(clock.now_ns() + NS_PER_SECOND, pilot.cut, "emergency stop")
        with pytest.raises(Interrupted, match="drone 0: stopped: emergency stop"):
            await guidance.land()
    async with in_the_air(clock) as (guidance, pilot):
        await guidance.land()
        assert pilot.mode is Mode.GROUND


@virtual
async def test_a_mission_that_is_over_flies_nothing(clock):
    async with in_the_air(clock) as (guidance, _):
        guidance.member.ended = "landed on command"
        for flight in (guidance.take_off, lambda: guidance.go_to([1.0, 0.0, 1.0])):
            with pytest.raises(
                Interrupted, match="drone 0: its mission has ended: landed on command"
            ):
                await flight()
        with pytest.raises(Interrupted, match="its mission has ended"):
            guidance.follow(FullState.at((1.0, 0.0, 1.0)))
        await guidance.land()


@virtual
async def test_an_asynchronous_algorithm_flies_as_it_is(clock):
    both = pair(clock)
    agents = [
        AsynchronousConsensus(i, [10.0 * i], {0: 0.5, 1: 0.5}, rounds=60)
        for i in (0, 1)
    ]
    began = clock.now()
    for guidance in both:
        guidance.member.communicator.port.bus.impairment.update({"loss": 0.4})
    await asyncio.gather(
        *(
            g.optimize(a, pace=WakingTimes((0.01, 0.03)))
            for g, a in zip(both, agents, strict=True)
        )
    )
    assert 1.5 < clock.now() - began < 4.0
    assert abs(agents[0].x - agents[1].x) < 1e-6
    assert 0.1 < agents[0].x < 9.9


@virtual
async def test_an_algorithm_that_fails_at_one_drone_ends_at_all(clock):
    both = pair(clock)
    agents = [Counting(), Consensus(1, [1.0], {0: 0.5, 1: 0.5})]  # which hears no array
    ends = [g.optimize(a) for g, a in zip(both, agents, strict=True)]
    found = await asyncio.gather(*ends, return_exceptions=True)
    assert [type(error) for error in found] == [AgentFailed, ConfigError]
    assert str(found[1]) in str(found[0])
    assert clock.now() < 5.0


class Counting:
    done = False

    def message(self):
        return 0

    def step(self, heard):
        pass


@virtual
async def test_an_algorithm_that_needs_another_graph_is_refused_at_all_drones(clock):
    both = pair(clock)
    for guidance in both:
        guidance.member.communicator.graph = graphs.empty(2)
    for i, guidance in enumerate(both):
        with pytest.raises(
            ConfigError,
            match=r"graph of Consensus: found no path from agent 0 to \[1\]",
        ):
            await guidance.optimize(Consensus(i, [1.0], {i: 1.0}, rounds=3))
    one_way = graphs.ring(3, directed=True)
    with pytest.raises(
        ConfigError,
        match="graph of GradientTracking: found agent 1 hears agent 0, but not the other",
    ):
        require_graph(
            GradientTracking(0, [1.0], {0: 0.5, 2: 0.5}, lambda x: x, 0.1), one_way
        )


NARROW = Fence.box((-0.5, -0.5, -0.2), (0.5, 0.5, 2.5))
"""The fence of a drone that stays further inside than the swarm file has it."""


@virtual
async def test_drone_flies_home_as_near_as_the_guard_allows(clock):
    async with in_the_world(clock, home=(0.45, 0.0, 0.0), fence=NARROW) as (
        guidance,
        pilot,
    ):
        await guidance.take_off()
        await guidance.go_to([0.0, 0.0, 0.5])
        pilot.guard.room = Fence((-0.3, -0.3, 0.1), (0.3, 0.3, 2.4))
        await guidance.go_to([0.45, 0.0, 0.5])
        assert pilot.state.p[0] == pytest.approx(0.3, abs=0.05)
        with pytest.raises(ConfigError, match="outside the fence"):
            await guidance.go_to([0.0, 0.45, 0.5])
        await guidance.land()
        assert pilot.mode is Mode.GROUND
