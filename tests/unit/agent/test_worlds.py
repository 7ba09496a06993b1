"""The owner of a world and the agents of its drones, as two processes, in virtual time."""

import asyncio
import contextlib
import logging
import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.agent.agent import Agent, AgentProcess
from crazychoir.agent.worlds import WORLD_OWNER_RULES, WorldProcess
from crazychoir.bus.commands import ANSWER_TEXTS, Commander
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.launch.flight_observer import FlightScore
from crazychoir.runtime.clock import run_virtual
from crazychoir.simulation import engines
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.simulation.owner import DelayedLink
from crazychoir.simulation.remote import MOTORS_CUT_TEXT

BRISK = {
    "takeoff_height": 0.5,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.6,
}


class Wire:
    """In the network's place: carries everything to another process at once, until it is torn."""

    def __init__(self, here, there):
        self.here, self.there, self.torn, self.late = here, there, False, 0.0
        here.forwarder = self

    def forward(self, message, to, age):
        for j in to if not self.torn else ():
            if j in self.there.ports:
                self.there.deliver(message, (j,), age + self.late)

    def then(self, work):
        work()

    def interested(self):
        self.there.add_remote_interests(self.here.interests)


def wired(one, other):
    """Two processes, each with a way to the other; what was wanted before is served."""
    wires = [Wire(one, other), Wire(other, one)]
    for wire in wires:
        wire.interested()
    return wires


def swarm(**tables):
    drones = [{"id": i, "home": [float(i), 0.0, 0.0]} for i in range(2)]
    return SwarmConfig.of(
        {
            "name": "a",
            "drones": drones,
            "flight": BRISK,
            "world": {"owned": True},
            **tables,
        }
    )


class Hops(CFGuidance):
    """Up, aside, down."""

    async def mission(self):
        await self.take_off()
        await self.go_to(self.state.p + np.array([0.0, 0.5, 0.0]))
        await self.sleep(1.0)
        place = self.state.p.tolist()
        await self.land()
        return {"place": place}


class Stays(CFGuidance):
    """Up, for a long time: so many seconds."""

    def __init__(self, seconds=600.0):
        self.seconds = seconds

    async def mission(self):
        await self.take_off()
        await self.sleep(self.seconds)


MISSION = SimpleNamespace(guidance=lambda i, config: Hops())
ENDLESS = SimpleNamespace(guidance=lambda i, config: Stays())


async def two_processes(clock, config, meanwhile, mission=MISSION):
    """An agent that flies all drones beside the owner of their world; what each has come to."""
    world = WorldProcess(clock, config, "world", "here", 1)
    agent = Agent(
        clock, config, mission, config.ids, process=AgentProcess(is_alone=False)
    )
    wires = wired(agent.bus, world.bus)
    serving = asyncio.create_task(world.serve())
    flying = asyncio.create_task(agent.run())
    await meanwhile(clock, world, agent, wires)
    results = await flying
    world.end("all have landed")
    await serving
    return results, world


def fly(config, meanwhile=None, mission=MISSION):
    async def nothing(clock, *parts):
        await clock.sleep(0.0)

    return run_virtual(
        lambda clock: two_processes(clock, config, meanwhile or nothing, mission)
    )


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.013])
def test_a_flight_is_the_same_bit_by_bit_wherever_the_body_is(delay):
    config = swarm(plant={"command_delay": delay}, mocap={"latency": 0.02})
    apart, world = fly(config)
    together = run_virtual(
        lambda clock: Agent(clock, config, MISSION, config.ids).run()
    )
    assert apart == together
    assert all(result["success"] for result in apart.values()), apart
    assert world.report()["commands"] > 100


def test_all_drones_of_the_world_are_in_one_and_obey_their_own_agents():
    seen = {}

    async def meanwhile(clock, world, agent, wires):
        assert agent.owners == []
        await clock.sleep(2.0)
        seen.update(
            {i: world.owners[0].world.state(i).p.tolist() for i in (0, 1)},
            flown=world.flown,
        )

    _, world = fly(swarm(), meanwhile=meanwhile)
    assert seen["flown"] == [0, 1]
    assert [seen[i][0] for i in (0, 1)] == pytest.approx([0.0, 1.0], abs=0.02)
    assert min(seen[i][2] for i in (0, 1)) > 0.3
    assert world.report()["crashed"] == []


def test_the_truth_comes_from_the_body():
    async def main(clock):
        config = swarm()
        world = WorldProcess(clock, config, "world", "here", 1)
        score = FlightScore(world.bus, config.ids, source=config.topology.source)
        serving = asyncio.create_task(world.serve(score))
        await clock.sleep(1.0)
        world.end("enough")
        await serving
        return score, list(world.bus.ports)

    score, ports = run_virtual(main)
    assert score.min_separation == pytest.approx(1.0)
    assert ports == [
        PORT_ADDRESSES.body_offset,
        PORT_ADDRESSES.body_offset + 1,
        PORT_ADDRESSES.first_observer,
    ]
    assert DRONE_TOPICS.truth.of_body


def test_an_owner_that_falls_silent_brings_its_drones_down_with_the_reason_whatever_their_mission_waits_for():
    async def meanwhile(clock, world, agent, wires):
        await clock.sleep(2.5)
        for wire in wires:
            wire.torn = True

    async def main(clock):
        results, _ = await two_processes(clock, swarm(), meanwhile, ENDLESS)
        return results, clock.now()

    results, ended = run_virtual(main)
    assert ended < 2.5 + 10.0
    for result in results.values():
        assert not result["success"]
        assert "s old, limit" in result["reason"], result
        assert "its world's owner (crazychoir-world) is silent for" in result["reason"]


class Foreign:
    """A world that is not ours: as the lightweight one, without a delay in its model.

    It takes commands by links only.
    """

    takes_rows = ()

    def __init__(self, setup):
        self._world = CFIntegrator(setup.ids, np.array(setup.homes), dt=setup.dt)

    def __getattr__(self, name):
        return getattr(self._world, name)


def test_a_world_that_has_no_delay_of_its_own_gets_the_delay_of_the_swarm_file(
    monkeypatch,
):
    monkeypatch.setitem(sys.modules, "foreign", SimpleNamespace(world=Foreign))
    monkeypatch.setitem(
        engines.BUILT_IN_ENGINES,
        WORLD_URIS.motor_level,
        EntryPoint(WORLD_URIS.motor_level, "foreign:world", "crazychoir.worlds"),
    )
    drones = [
        {"id": i, "home": [float(i), 0.0, 0.0], "uri": WORLD_URIS.motor_level}
        for i in range(2)
    ]

    async def main(clock):
        world = WorldProcess(
            clock,
            swarm(drones=drones, plant={"command_delay": 0.03}),
            "world",
            "here",
            1,
        )
        return [body.link for body in world.bodies], world.owners[0].world

    links, world = run_virtual(main)
    assert [(type(link), link.steps) for link in links] == [(DelayedLink, 3)] * 2
    assert world.ids == (0, 1)


def test_a_sender_that_no_drone_of_the_world_can_fly_is_refused_at_the_start():
    async def main(clock):
        with pytest.raises(
            ConfigError, match="drone 0: sender: found frpy; allowed: fpqr"
        ):
            WorldProcess(clock, swarm(control={"sender": "frpy"}), "world", "here", 1)
        with pytest.raises(
            ConfigError, match="drone 0: sender: found vel; allowed: fpqr"
        ):
            Agent(clock, swarm(control={"sender": "vel"}), MISSION, (0, 1))

    run_virtual(main)


def test_a_cut_reaches_the_body():
    fell = {}

    async def meanwhile(clock, world, agent, wires):
        await clock.sleep(2.5)
        agent.cut_all("emergency stop")
        await clock.sleep(0.2)
        fell.update({i: world.owners[0].world.state(i).v[2] for i in (0, 1)})

    results, _ = fly(swarm(), meanwhile=meanwhile)
    assert all(speed < -1.0 for speed in fell.values()), fell
    assert all("emergency stop" in result["reason"] for result in results.values()), (
        results
    )


def test_an_emergency_stop_reaches_the_body_whatever_its_agent_goes_on_to_send():
    seen = {}

    async def meanwhile(clock, world, agent, wires):
        operator = Commander(world.bus.port(PORT_ADDRESSES.first_observer + 1))
        await clock.sleep(2.5)
        refused = await operator.request(PORT_ADDRESSES.body_offset, "land")
        seen.update(
            refused=refused.kind,
            missing=await operator.emergency_stop(
                [PORT_ADDRESSES.body_offset], deadline=1.0
            ),
        )
        await clock.sleep(0.2)
        seen.update({i: world.owners[0].world.state(i).v[2] for i in (0, 1)})

    results, _ = fly(swarm(), meanwhile=meanwhile)
    assert (seen["refused"], seen["missing"]) == (ANSWER_TEXTS.refused, [])
    assert seen[0] < -1.0 < -0.1 < seen[1], "drone 0 falls, drone 1 flies on"
    assert [result["success"] for result in results.values()] == [False, True]


@contextlib.asynccontextmanager
async def started_again(clock, config):
    """The owner of a world, the agent that has flown its drones for 3 s, and what ends that and starts another one."""
    world = WorldProcess(clock, config, "world", "here", 1)
    first, second = (
        Agent(
            clock,
            config,
            ENDLESS,
            config.ids,
            process=AgentProcess("local", n, is_alone=False),
        )
        for n in (1, 2)
    )
    tasks = [asyncio.create_task(world.serve()), asyncio.create_task(first.run())]
    wires = wired(first.bus, world.bus)

    def again():
        for wire in wires:
            wire.torn = True
        tasks[1].cancel()
        wired(second.bus, world.bus)
        tasks.append(asyncio.create_task(second.run()))
        return second

    await clock.sleep(3.0)
    try:
        yield world, first, again
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@pytest.mark.parametrize("sender", ["fpqr", "xyz"])
def test_an_agent_that_is_started_again_lands_a_drone_that_is_in_the_air(sender):
    drones = [
        {"id": i, "home": [float(i), 0.0, 0.0], "uri": WORLD_URIS.motor_level}
        for i in range(2)
    ]
    flight = BRISK | {"speed_limit": 0.9}
    tables = (
        {"drones": drones, "flight": flight, "control": {"sender": sender}}
        if sender == "xyz"
        else {}
    )
    config = swarm(**tables)

    async def main(clock):
        async with started_again(clock, config) as (world, _, again):
            height = world.owners[0].world.state(0).p[2]
            drones = again().drones.values()
            await clock.sleep(0.1)
            notes, speeds = [drone.pilot.notes.text for drone in drones], []
            while any(drone.pilot.mode.value == "landing" for drone in drones):
                await clock.sleep(0.05)
                speeds.append(world.owners[0].world.state(0).v[2])
            return height, notes, min(speeds), world.report()

    height, notes, sinks, report = run_virtual(main)
    assert height > 0.4
    assert notes == ["found in the air, where others have flown it: landing"] * 2
    assert sinks > -1.3, "it falls"
    assert report["crashed"] == []


def test_an_agent_that_is_started_again_hears_that_the_motors_were_cut_and_takes_no_part():
    config = swarm()

    async def main(clock):
        async with started_again(clock, config) as (_, first, again):
            first.drones[1].pilot.cut("its estimate is wrong")
            await clock.sleep(1.0)
            drones = again().drones
            await clock.sleep(30.0)
            return {i: drone.result for i, drone in drones.items()}, [
                d.pilot.body.list_problems() for d in drones.values()
            ]

    results, problems = run_virtual(main)
    assert MOTORS_CUT_TEXT in results[1]["reason"], results
    assert problems == [[], [MOTORS_CUT_TEXT]]


@pytest.mark.parametrize("length", [0.6, 1.2, 1.8, 2.4, 3.6])
def test_a_drone_cut_off_from_its_body_for_a_while_lands_without_falling(
    length,
):
    drones = [
        {"id": i, "home": [float(i), 0.0, 0.0], "uri": WORLD_URIS.motor_level}
        for i in range(2)
    ]
    config = swarm(
        drones=drones, flight=BRISK | {"takeoff_height": 1.2, "landing_speed": 0.4}
    )
    seen = {"sinks": []}

    async def meanwhile(clock, world, agent, wires):
        await clock.sleep(6.0)
        for torn in (True, False):
            for wire in wires:
                wire.torn = torn
            ends = clock.now() + (length if torn else 6.0)
            while clock.now() < ends:
                await clock.sleep(0.05)
                seen["sinks"].append(world.owners[0].world.state(0).v[2])
        seen["down"] = [world.owners[0].world.state(i).p[2] for i in (0, 1)]

    _, world = fly(
        config, meanwhile, SimpleNamespace(guidance=lambda i, config: Stays(20.0))
    )
    assert min(seen["sinks"]) > -1.0, "it falls"
    assert max(seen["down"]) < 0.05
    assert world.report()["crashed"] == []


def test_a_pose_is_as_old_as_its_way_was_long():
    ages = []

    async def meanwhile(clock, world, agent, wires):
        wires[1].late = 0.03
        await clock.sleep(1.5)
        ages.extend(drone.pilot.state.age for drone in agent.drones.values())

    fly(swarm(), meanwhile=meanwhile)
    assert all(0.03 <= age < 0.045 for age in ages), ages


def test_the_owner_ends_when_no_drone_flies_any_more(caplog):
    ends = {}

    async def meanwhile(clock, world, agent, wires):
        await clock.sleep(1.0)
        world.end("Ctrl-C")
        ends["asked"] = clock.now()

    async def main(clock):
        results, _ = await two_processes(clock, swarm(), meanwhile)
        return results, clock.now() - ends["asked"]

    results, later = run_virtual(main)
    assert all(result["success"] for result in results.values()), (
        "they saw the floor when they landed"
    )
    assert later > 2.0 + WORLD_OWNER_RULES.silence_limit
    said = [
        record.getMessage()
        for record in caplog.records
        if "world:" in record.getMessage()
    ]
    assert said == [
        "world: Ctrl-C: it goes on until the agents of drone(s) 0, 1 have ended"
    ]


def test_agents_that_have_just_ended_are_no_news(caplog):
    fly(swarm())
    assert not any("world:" in record.getMessage() for record in caplog.records)


def test_an_unneeded_owner_ends_at_once():
    async def main(clock):
        world = WorldProcess(clock, swarm(), "world", "here", 1)
        serving = asyncio.create_task(world.serve())
        await clock.sleep(1.0)
        world.end("Ctrl-C")
        await serving
        return clock.now()

    assert run_virtual(main) < 1.2


@pytest.mark.parametrize("how", ["refused", "broken"])
def test_an_owner_that_cannot_go_on_ends_with_the_reason(how, caplog):
    async def main(clock):
        world = WorldProcess(clock, swarm(), "world", "here", 1)
        serving = asyncio.create_task(world.serve())
        await clock.sleep(1.0)
        if how == "refused":
            world.refuse(
                Refused("swarm a", "another owns the world of drone(s) 0, 1 too")
            )
        else:
            world.owners[0].world.states = None
        await serving
        return world.report()

    with caplog.at_level(logging.CRITICAL):
        report = run_virtual(main)
    assert not report["success"]
    assert ("another owns" if how == "refused" else "world failed: ") in report[
        "reason"
    ]


def test_the_cameras_of_a_world_see_its_drones_tilted_as_the_swarm_file_says():
    """All of [mocap] reaches them, and the pose that the drone's own estimator is told is tilted too."""
    mocap = {
        "noise": 0.0,
        "noise_angle": 0.0,
        "tilt": [0.02, -0.03],
        "tilt_spread": 0.0,
    }
    drone = {"id": 0, "home": [0.0, 0.0, 0.0], "uri": WORLD_URIS.motor_level}
    config = SwarmConfig.of({"name": "a", "drones": [drone], "mocap": mocap})

    async def main(clock):
        agent = Agent(
            clock, config, SimpleNamespace(guidance=lambda i, config: Stays()), (0,)
        )
        (owner,) = agent.owners
        told = []
        owner.world.see_frame = lambda flat, seen: told.append(flat[0, 3:7])
        owner.step()
        return told[0]

    x, y, z, w = run_virtual(main)
    assert (2.0 * x / w, 2.0 * y / w) == pytest.approx((0.02, -0.03), rel=1e-3)
    assert z == pytest.approx(0.0, abs=1e-3)
