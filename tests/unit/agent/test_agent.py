"""Agents in virtual time: results, what all hosts must have in common, and an agent that comes back."""

import asyncio
import re
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from pilots import change_fence

from crazychoir.agent.agent import Agent, AgentProcess
from crazychoir.agent.mission_result import MISSION_REASONS
from crazychoir.agent.mission_runner import MissionRunner
from crazychoir.bus.message import Message
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.presence import Presence
from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import Refused
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission import compute_mission_hash, load_mission
from crazychoir.runtime.clock import NS_PER_SECOND, run_virtual
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.rules.guard import Fence
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.trace import Trace
from crazychoir.types import Acceleration, Velocity

BRISK = {
    "takeoff_height": 0.3,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.6,
}


class Does(CFGuidance):
    """A mission that is one coroutine function of the test."""

    def __init__(self, does):
        self.does = does

    async def mission(self):
        return await self.does(self)


def mission_of(does):
    return SimpleNamespace(guidance=lambda i, config: Does(does))


STRAIGHT = {"tilt_spread": 0.0}
"""Keys of [mocap] for drones that need no time to learn how their markers are mounted."""


def swarm(n, **changes):
    return default_swarm(n).replace(flight=BRISK, mocap=STRAIGHT, **changes)


async def observe(agent, topic, drone=0):
    """All values of a topic, as an observer hears them from now on."""
    heard = []
    if PORT_ADDRESSES.first_observer not in agent.bus.ports:
        agent.bus.port(PORT_ADDRESSES.first_observer)
    agent.bus.subscribe(
        topic,
        drone,
        PORT_ADDRESSES.first_observer,
        Call(agent.clock, lambda value, age: heard.append(value)),
    )
    return heard


# Results ------------------------------------------------------------------------------------------------------------


async def returns(guidance):
    await guidance.take_off()
    return {"answer": 42}


async def returns_nothing(guidance):
    await guidance.take_off()


async def returns_a_list(guidance):
    await guidance.take_off()
    return [1, 2]


async def raises(guidance):
    await guidance.take_off()
    raise ValueError("no idea")


async def exits(guidance):
    await guidance.take_off()
    raise SystemExit(3)


async def is_refused(guidance):
    await guidance.take_off()
    raise Refused("drone 9", "not today")


@pytest.mark.parametrize(
    ("does", "result"),
    [
        (returns, {"success": True, "answer": 42}),
        (returns_nothing, {"success": True}),
        (
            returns_a_list,
            "TypeError: mission() returned a list; allowed: a dictionary, or nothing",
        ),
        (raises, "drone 0: guidance failed: ValueError: no idea ("),
        (exits, "RuntimeError: the mission called sys.exit(3)"),
        (is_refused, {"success": False, "reason": "drone 9: refused: not today"}),
    ],
)
def test_however_a_mission_ends_its_drone_lands_and_says_the_result(does, result):
    async def main(clock):
        agent = Agent(clock, swarm(1), mission_of(does), (0,))
        told = await observe(agent, DRONE_TOPICS.result)
        results = await agent.run()
        assert agent.drones[0].pilot.mode is Mode.GROUND
        assert agent.owners[0].world.state(0).p[2] == pytest.approx(0.0, abs=1e-6)
        assert told == [results[0]]
        return results[0]

    found = run_virtual(main)
    if isinstance(result, dict):
        assert found == result
    else:
        assert not found["success"]
        assert result in found["reason"]
        assert (
            "test_agent.py" in found["reason"] or "mission_result.py" in found["reason"]
        )


async def returns_a_set(guidance):
    await guidance.take_off()
    return {"seen": {1, 2}}


@pytest.mark.parametrize("watched", [False, True])
def test_the_result_is_the_same_with_and_without_an_observer(watched):
    async def main(clock):
        agent = Agent(clock, swarm(1), mission_of(returns_a_set), (0,))
        if watched:
            await observe(agent, DRONE_TOPICS.result)
        return (await agent.run())[0]

    result = run_virtual(main)
    assert result["success"] is False
    assert (
        "mission() returned what cannot travel: value['seen']: found a set"
        in result["reason"]
    )


def test_an_observer_that_comes_when_the_mission_is_over_still_gets_the_result_once():
    async def main(clock):
        agent = Agent(clock, swarm(1), mission_of(returns), (0,))
        running = asyncio.create_task(agent.run())
        while agent.drones[0].pilot.airborne or not agent.drones[0].result:
            await clock.sleep(0.1)
        told = await observe(agent, DRONE_TOPICS.result)
        assert told == [{"success": True, "answer": 42}]
        await running
        return told

    assert len(run_virtual(main)) == 1


def test_an_operators_landing_is_the_result():
    async def main(clock):
        async def stays(guidance):
            await guidance.take_off()
            await guidance.sleep(60.0)

        agent = Agent(clock, swarm(1), mission_of(stays), (0,))
        running = asyncio.create_task(agent.run())
        await clock.sleep(3.0)
        agent.land_all("enough")
        assert (await running)[0] == {"success": False, "reason": "enough"}
        assert clock.now() < 10.0

    run_virtual(main)


def test_a_process_that_is_refused_before_its_missions_begin_ends():
    async def main(clock):
        agent = Agent(clock, swarm(1), mission_of(stays), (0,))
        agent.refuse(Refused("drone 0", "another process flies it"))
        async with asyncio.timeout(10.0):
            results = await agent.run()
        assert results[0]["success"] is False
        assert "another process flies it" in results[0]["reason"]

    run_virtual(main)


def test_after_an_emergency_stop_the_agent_says_what_it_waits_for_and_an_operator_may_end_it(
    caplog,
):
    async def main(clock):
        agent = Agent(clock, swarm(1), mission_of(stays), (0,))
        running = asyncio.create_task(agent.run())
        await clock.sleep(3.0)
        agent.bus.stopped = True
        agent.commands[0].stop(True)
        await clock.sleep(60.0)
        agent.bus.link_faults = ["full 3"]
        status = agent.drones[0].status()
        assert status.link_faults == ["full 3"]
        assert (status.phase, status.note, status.stopped) == (
            "stopped",
            MISSION_REASONS.stays,
            True,
        )
        assert [r.message for r in caplog.records].count(
            f"drone 0: {MISSION_REASONS.stays}"
        ) == 1
        agent.land_all("SIGINT: landing")
        await clock.sleep(1.0)
        assert running.done()

    run_virtual(main)


@pytest.mark.parametrize(
    ("pause", "why"),
    [
        (5.0, "emergency stop in force: no take-off until `crazychoir stop --clear`"),
        (15.0, "emergency stop: no take-off until its agent is started again"),
    ],
    ids=["before it is cleared", "after it is cleared"],
)
def test_an_emergency_stop_cuts_for_good_and_its_clearing_only_ends_the_agent(
    pause, why
):
    async def main(clock):
        async def tries_again(guidance):
            await guidance.take_off()
            await guidance.sleep(pause)
            await guidance.take_off()

        agent = Agent(clock, swarm(1), mission_of(tries_again), (0,))
        running = asyncio.create_task(agent.run())
        await clock.sleep(3.0)
        agent.bus.stopped = True
        agent.commands[0].stop(True)
        await clock.sleep(10.0)
        assert not running.done(), "the agent stays, to tell later agents of the stop"
        agent.bus.stopped = False
        assert not agent.drones[0].status().stopped
        result = (await running)[0]
        assert not result["success"]
        assert result["reason"].startswith(
            f"drone 0: stopped: {why}; crashed: hit the floor at 2.4"
        )
        assert agent.drones[0].pilot.mode is Mode.CUT

    run_virtual(main)


# The end of a flight ------------------------------------------------------------------------------------------------


def ended(does, at=None, act=lambda agent: None, drones=1, seconds=60.0, **flight):
    """The results, the agent, and (phase, ...) of drone 0; `act` on the agent at some time."""

    async def main(clock):
        config = default_swarm(drones).replace(flight=BRISK | flight, mocap=STRAIGHT)
        agent = Agent(clock, config, mission_of(does), config.ids)
        phases = [agent.drones[0].pilot.mode]

        async def look():
            while True:
                await clock.sleep(0.02)
                if agent.drones[0].pilot.mode is not phases[-1]:
                    phases.append(agent.drones[0].pilot.mode)

        if at is not None:
            clock.call_at(round(at * NS_PER_SECOND), act, agent)
        looking, running = asyncio.create_task(look()), asyncio.create_task(agent.run())
        await asyncio.wait(
            [running, asyncio.create_task(clock.sleep(seconds))],
            return_when=asyncio.FIRST_COMPLETED,
        )
        looking.cancel()
        assert running.done(), "it has not ended"
        return running.result(), agent, phases

    return run_virtual(main)


async def stays(guidance):
    await guidance.take_off()
    await guidance.sleep(20.0)
    await guidance.land()


def failing(actor):
    """Its next step raises."""

    def fail(*_):
        raise ValueError("no idea")

    if actor == "world":
        return lambda agent: setattr(agent.owners[0], "step", fail)
    return lambda agent: setattr(agent.pacemaker.tick, "tick_late_drones", fail)


@pytest.mark.parametrize("actor", ["world", "pacemaker"])
def test_without_world_or_pacemaker_every_mission_ends_with_the_reason(actor):
    results, agent, _ = ended(stays, 3.0, failing(actor), drones=2, seconds=10.0)
    whys = [(r["success"], r["reason"]) for r in results.values()]
    assert whys == 2 * [(False, f"{actor} failed: ValueError: no idea")]
    assert not any(drone.pilot.airborne for drone in agent.drones.values())


class Cancels(CFDistributedFeedback):
    """Drone 0 asks for the result of a task that was cancelled."""

    duration = 4.0

    def step(self, me, heard):
        if self.id == 0 and self.member.clock.now() > 3.0:
            raise asyncio.CancelledError
        return Acceleration(-2.0 * me.v)


def test_a_step_that_raises_cancelled_error_ends_its_own_law_alone():
    async def main(clock):
        agent = Agent(
            clock,
            swarm(2),
            SimpleNamespace(guidance=lambda i, config: Cancels()),
            (0, 1),
        )
        results = await agent.run()
        assert (
            "drone 0: step raised CancelledError: it was cancelled"
            in results[0]["reason"]
        )
        assert not results[0]["success"]
        assert results[1]["success"], results[1]
        assert results[1]["law_s"] == pytest.approx(Cancels.duration)
        assert [agent.drones[i].pilot.mode for i in (0, 1)] == [
            Mode.GROUND,
            Mode.GROUND,
        ]

    run_virtual(main)


def test_a_mission_that_raises_cancelled_error_has_failed():
    async def gives_up(guidance):
        await guidance.take_off()
        raise asyncio.CancelledError

    results, _, phases = ended(gives_up)
    assert not results[0]["success"]
    assert (
        "guidance failed: RuntimeError: the mission raised CancelledError: it was cancelled"
        in results[0]["reason"]
    )
    assert phases == [Mode.GROUND, Mode.TAKEOFF, Mode.HOVER, Mode.LAND, Mode.GROUND]


@pytest.mark.parametrize(
    "lands", [False, True], ids=["after its mission", "in its mission"]
)
def test_a_drone_with_motors_cut_during_its_landing_is_no_success(lands):
    async def is_cut(guidance):
        await guidance.take_off()
        clock = guidance.member.clock
        clock.call_at(
            clock.now_ns() + NS_PER_SECOND // 4,
            guidance.member.pilot.cut,
            "emergency stop",
        )
        if lands:
            await guidance.land()
        return {"answer": 42}

    results, _, phases = ended(is_cut)
    assert phases[-2:] == [Mode.LAND, Mode.CUT]
    assert not results[0]["success"]
    assert results[0]["reason"] == (
        "drone 0: stopped: emergency stop" if lands else "drone 0: emergency stop"
    )


def test_a_drone_that_its_guard_has_landed_for_good_is_no_success():
    async def waits(guidance):
        await guidance.take_off()
        while guidance.member.pilot.airborne:
            await guidance.sleep(0.05)

    def narrow(agent):
        fence = Fence.box((-3.0, -3.0, -0.5), (3.0, 3.0, -0.05))
        change_fence(agent.drones[0].pilot, fence)

    results, _, phases = ended(waits, 2.5, narrow)
    assert phases[-2:] == [Mode.LAND, Mode.GROUND]
    assert not results[0]["success"]
    assert results[0]["reason"].startswith("drone 0: 0.3")
    assert "outside the fence" in results[0]["reason"]


def blind(at, until):
    """The cameras see nothing from `at` to `until` s."""

    def close(agent):
        sample = agent.owners[0].cameras.sample
        agent.owners[0].cameras.sample = lambda x, k: (
            None if agent.clock.now() < until else sample(x, k)
        )

    return at, close


@pytest.mark.parametrize(
    "lands", [False, True], ids=["after its mission", "in its mission"]
)
def test_a_drone_that_was_landed_for_lack_of_poses_is_no_success_though_its_mission_slept_through_it(
    lands,
):
    async def sleeps(guidance):
        await guidance.take_off()
        await guidance.sleep(6.0)
        if lands:
            await guidance.land()
        return {"photo": "taken"}

    results, _, phases = ended(sleeps, *blind(4.0, 4.8))
    assert phases[-3:] == [Mode.HOVER, Mode.LAND, Mode.GROUND]
    assert (results[0]["success"], results[0]["photo"]) == (False, "taken")
    assert results[0]["reason"] == "drone 0: pose 0.52 s old, limit 0.50 s: landing"


@pytest.mark.parametrize("method", ["off", "barrier", "cells"])
def test_unseen_drones_land_with_every_collision_method(method):
    """Their places are old news to each other, too: that may not keep them in the air until their motors are cut."""

    async def main(clock):
        config = default_swarm(2).replace(flight=BRISK, collision={"method": method})
        agent = Agent(clock, config, mission_of(stays), config.ids)
        running = asyncio.create_task(agent.run())
        await clock.sleep(4.0)
        blind(4.0, 60.0)[1](agent)
        await clock.sleep(1.6)
        states, notes = (
            agent.owners[0].world.states,
            [drone.pilot.notes.text for drone in agent.drones.values()],
        )
        running.cancel()
        return states[:, 2].tolist(), notes

    heights, notes = run_virtual(main)
    assert max(heights) < 0.15, "of 0.3 m"
    assert all(
        re.fullmatch(r"pose 1\.\d+ s old, limit 0.50 s: landing", note)
        for note in notes
    ), notes


def test_a_drone_that_crashed_is_no_success():
    """A gust throws it to the floor, whence it rises again."""

    async def hovers(guidance):
        await guidance.take_off(1.0)
        await guidance.sleep(6.0)
        await guidance.land()
        return {"answer": 42}

    def gust(speed):
        return lambda agent: agent.owners[0].world.states.__setitem__((0, 5), -speed)

    results, _, phases = ended(hovers, 5.0, gust(6.0))
    assert phases == [Mode.GROUND, Mode.TAKEOFF, Mode.HOVER, Mode.LAND, Mode.GROUND], (
        "its mission saw nothing of it"
    )
    assert (results[0]["success"], results[0]["answer"]) == (False, 42)
    assert re.fullmatch(
        r"drone 0: crashed: hit the floor at \d\.\d\d m/s, allowed 1 m/s",
        results[0]["reason"],
    )
    assert ended(hovers, 5.0, gust(1.0))[0][0] == {"success": True, "answer": 42}

    async def knows(guidance, **told):
        return {**await hovers(guidance), "success": False, **told}

    for does, begins in (
        (knows, "crashed: hit"),
        (partial(knows, reason="a gust"), "a gust; crashed: hit"),
    ):
        assert ended(does, 5.0, gust(6.0))[0][0]["reason"].startswith(begins)


def test_a_descent_may_take_as_long_as_it_is_planned():
    results, agent, phases = ended(
        raises, takeoff_height=2.0, landing_speed=0.05, seconds=150.0
    )
    assert "ValueError: no idea" in results[0]["reason"]
    assert phases[-2:] == [Mode.LAND, Mode.GROUND]
    assert agent.clock.now() > 60.0


@pytest.mark.parametrize(
    "patience", [0.5, 6.0], ids=["still in the air", "on the ground"]
)
def test_a_drone_landed_on_command_stays_down_whatever_its_law_catches(
    patience,
):
    async def stubborn(guidance):
        while True:
            try:
                await guidance.take_off()
                await guidance.go_to(guidance.state.p)
                await guidance.sleep(5.0)
                return {"answer": 42}
            except BaseException:  # noqa: BLE001 - as some write
                await guidance.sleep(patience)

    def land(agent):
        agent.land_all("landed on command")

    results, _, phases = ended(stubborn, 2.0, land)
    assert results[0] == {"success": False, "reason": "landed on command"}
    assert phases == [
        Mode.GROUND,
        Mode.TAKEOFF,
        Mode.HOVER,
        Mode.FOLLOW,
        Mode.HOVER,
        Mode.LAND,
        Mode.GROUND,
    ]


def test_what_a_mission_leaves_behind_flies_nothing():
    async def leaves(guidance):
        await guidance.take_off()
        guidance.left = asyncio.create_task(again(guidance))

    async def again(guidance):
        await guidance.sleep(5.0)
        await guidance.take_off()

    results, _, phases = ended(leaves)
    assert results[0] == {"success": True}
    assert phases == [Mode.GROUND, Mode.TAKEOFF, Mode.HOVER, Mode.LAND, Mode.GROUND]


# A law --------------------------------------------------------------------------------------------------------------


class Stay(CFDistributedFeedback):
    """A law that brakes; it commands nothing while it hears no neighbour."""

    duration = 4.0

    def step(self, me, heard):
        return Acceleration(-2.0 * me.v) if heard else None


def test_the_result_of_a_law_gives_its_duration_end_place_and_unheard_drones():
    cut = {"partitions": [{"at": 3.0, "groups": [[1]], "until": 5.0}]}

    async def main(clock):
        config = swarm(2, network=cut, collision={"method": "off"})
        agent = Agent(
            clock, config, SimpleNamespace(guidance=lambda i, config: Stay()), (0, 1)
        )
        return await agent.run()

    for i, result in run_virtual(main).items():
        assert result["success"], result
        assert result["law_s"] == pytest.approx(Stay.duration), "without its landing"
        assert result["place"] == pytest.approx(
            [*default_swarm(2).drone(i).home[:2], 0.3], abs=0.05
        )
        assert list(result["unheard_s"]) == [1 - i]
        assert 1.0 < result["unheard_s"][1 - i] < 2.0


def test_a_missed_formation_fails_and_names_misplaced_and_deaf_drones():
    mission = load_mission("bearing_formation")
    config = mission.swarm(None)
    goal = mission.goal(config)
    at = {
        i: {"success": True, "law_s": 20.0, "place": p.tolist(), "unheard_s": {}}
        for i, p in goal.items()
    }
    assert mission.report(config, at) == {"success": True, "reasons": {}}
    near = {
        **at,
        3: {
            **at[3],
            "place": (goal[3] + [0.0, 0.009, 0.0]).tolist(),
            "unheard_s": {1: 2.0},
        },
    }
    assert mission.report(config, near)["success"], (
        "it was deaf for a while, and got there"
    )
    off = {
        **at,
        2: {
            **at[2],
            "place": (goal[2] + [0.0, 0.3, 0.0]).tolist(),
            "unheard_s": {1: 2.5, 3: 0.25},
        },
    }
    assert mission.report(config, off) == {
        "success": False,
        "reasons": {
            2: "0.300 m from its place at the end of the law, allowed 0.01 m; "
            "did not hear drone 1 for 2.50 s, drone 3 for 0.25 s"
        },
    }
    assert mission.report(config, {2: {"success": False, "reason": "landed"}})[
        "success"
    ], "that is said elsewhere"


# What all hosts must have in common ---------------------------------------------------------------------------------


def test_a_mission_is_what_its_text_and_its_swarm_say_wherever_the_file_lies(tmp_path):
    text = "def guidance(i, config):\n    return None\n"
    for folder, body in (("a", text), ("b", text), ("c", text + "# changed\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text(body)

    def hashed(folder, **changes):
        path = str(tmp_path / folder / "mine.py")
        return compute_mission_hash(
            default_swarm(3).replace(mission=path, **changes), load_mission(path)
        )

    assert hashed("a") == hashed("b")
    assert hashed("a") != hashed("c")
    assert hashed("a") != hashed("a", seed=7)
    assert hashed("a") == hashed("a", base_port=8000), "that is a host's own matter"
    assert len(hashed("a").partition(":")[0]) == 16


def test_a_file_that_the_options_name_counts_by_what_is_in_it(tmp_path):
    def hashed(name, content):
        path = tmp_path / name
        path.write_text(content)
        config = default_swarm(3).replace(mission_options={"instance": str(path)})
        return compute_mission_hash(config, mission_of(returns))

    assert hashed("one.json", "{}") == hashed("two.json", "{}")
    assert hashed("one.json", "{}") != hashed("two.json", "[]")


def test_the_digest_of_a_run_is_of_all_messages_between_drones_and_all_states():
    def digest(*parts):
        trace = Trace()
        for part in parts:
            if isinstance(part, tuple):
                to, number, payload = part
                message = Message(MESSAGE_TOPICS.rounds, 0, payload, number)
                trace.message(to, message, 0.0)
            else:
                trace.update(np.frombuffer(part, np.uint8))
        return trace.digest()

    one, two = (1, 5, b"x"), (2, 5, b"x")
    whole = digest(one, two, b"state")
    assert whole == digest(one, two, b"state")
    another = (2, 5, b"y")
    others = [
        (two, one, b"state"),
        (one, b"state"),
        (one, two, b"other"),
        (one, two),
        (one, another, b"state"),
    ]
    assert len({whole, *(digest(*other) for other in others)}) == 1 + len(others)
    assert whole == digest(
        one, (PORT_ADDRESSES.first_observer, 1, b"z"), two, b"state"
    ), "a message of an observer does not change the digest"


# An agent that comes back -------------------------------------------------------------------------------------------


class Wire:
    """The network between the buses of several agents in one virtual time; an unplugged bus hears nothing."""

    def __init__(self, clock, delay=0.002):
        self.clock, self.delay_ns, self.buses = clock, round(delay * NS_PER_SECOND), []

    def plug(self, bus):
        self.buses.append(bus)
        bus.forwarder = Plug(self, bus)
        bus.forwarder.interested()
        for other in self.buses:
            bus.add_remote_interests(other.interests if other is not bus else [])

    def unplug(self, bus):
        self.buses.remove(bus)

    def carry(self, bus, j, message, age):
        there = [other for other in self.buses if other is not bus and j in other.ports]
        if bus in self.buses and there:
            self.clock.call_at(
                self.clock.now_ns() + self.delay_ns,
                there[0].deliver,
                message,
                (j,),
                age,
            )


class Plug:
    """One bus's way to the others."""

    def __init__(self, wire, bus):
        self.wire, self.bus = wire, bus

    def forward(self, message, to, age):
        for j in to:
            self.wire.carry(self.bus, j, message, age)

    def then(self, work):
        work()

    def interested(self):
        for other in self.wire.buses:
            if other is not self.bus:
                other.add_remote_interests(self.bus.interests)


class Counts(CFGuidance):
    """Exchanges rounds on a joinable channel until a time; rounds: {k: the robots that were heard}."""

    def __init__(self, until):
        self.until, self.rounds = until, {}

    async def mission(self):
        communicator = self.member.communicator
        channel = communicator.open("count", joinable=True)
        while self.member.clock.now() < self.until:
            k = channel.receiving
            heard = await self.neighbors_exchange([self.id, k], channel="count")
            assert all(message == [j, k] for j, message in heard.items()), (k, heard)
            self.rounds[k] = tuple(heard)
            await self.sleep(0.01)
        return {"rounds": len(self.rounds)}


@pytest.mark.parametrize(
    "away", [0.3, 6.0], ids=["before it is lost", "after it was lost"]
)
def test_a_restarted_agent_is_a_new_incarnation_and_the_joinable_channel_goes_on(away):
    config, until = swarm(4, lost_after=2.0), 4.0 + away + 8.0

    async def main(clock):
        wire, born = Wire(clock), {}

        def agent(ids, incarnation=1):
            mission = SimpleNamespace(
                guidance=lambda i, config: born.setdefault(
                    (i, incarnation), Counts(until)
                )
            )
            made = Agent(
                clock,
                config,
                mission,
                ids,
                process=AgentProcess(f"{ids[0]}-{incarnation}", incarnation),
            )
            wire.plug(made.bus)
            return made, asyncio.create_task(made.run())

        (three, running), (_, victim) = agent((0, 1, 2)), agent((3,))
        logs = [await observe(three, DRONE_TOPICS.log, i) for i in (0, 1, 2)]
        await clock.sleep(4.0)
        wire.unplug(wire.buses[1])
        victim.cancel()
        await clock.sleep(away)
        again, returned = agent((3,), incarnation=2)
        await clock.sleep(until - clock.now() - 1.0)
        rosters = [d.barrier.roster for a in (three, again) for d in a.drones.values()]
        results = await running | await returned
        assert logs == [[], [], []]
        return results, rosters, born

    results, rosters, born = run_virtual(main)
    assert all(result["success"] for result in results.values()), results
    assert all(roster == rosters[0] for roster in rosters)
    assert rosters[0].members == {0: 1, 1: 1, 2: 1, 3: 2}
    first = rosters[0].first_round
    assert min(born[3, 2].rounds) == first > max(born[3, 1].rounds)
    last = max(born[3, 2].rounds)
    assert last > first + 100
    neighbors = config.graph().in_neighbors
    for i, counts in (
        (0, born[0, 1]),
        (1, born[1, 1]),
        (2, born[2, 1]),
        (3, born[3, 2]),
    ):
        assert all(
            set(counts.rounds[k]) == set(neighbors(i)) for k in range(first, last - 2)
        ), i
        assert list(counts.rounds) == sorted(counts.rounds), "no round twice"
        if i != 3:
            assert len(counts.rounds) == max(counts.rounds) + 1, "nor left out"


def test_a_team_that_comes_apart_says_so_in_log_status_and_result(caplog):
    async def hovers(guidance):
        await guidance.take_off()
        await guidance.member.clock.sleep(8.0)
        return {"success": True}

    async def main(clock):
        agent = Agent(
            clock, swarm(3, graph="path", lost_after=1.0), mission_of(hovers), (0, 1, 2)
        )
        said, statuses = (
            await observe(agent, DRONE_TOPICS.log),
            await observe(agent, DRONE_TOPICS.status),
        )

        def crash():
            agent.bus.close(1)
            drone = agent.drones[1]
            drone.port.send = drone.port.publish = lambda *message, **named: None
            drone.pilot.row.drone["is_running"] = 0  # no other drone hears its states
            agent.runners[1].abort("killed")

        clock.call_at(4 * NS_PER_SECOND, crash)
        return await agent.run(), said, statuses

    found, said, statuses = run_virtual(main)
    apart = "graph in 2 parts: 0 | 2"
    told = f"drone 0: {apart}: no message of one reaches another; without drone(s) 1"
    assert [text for text in said if "parts" in text] == [told]
    assert caplog.text.count(apart) == 1
    assert any(apart in status.note for status in statuses)
    assert (found[0]["apart"], found[2]["apart"]) == (apart, apart)


class Rests(CFDistributedFeedback):
    """A law that lasts longer than a drone without heartbeats and states would count as present."""

    duration = 6.0

    def step(self, me, heard):
        return Velocity(np.zeros(3))


@pytest.mark.parametrize("method", ["barrier", "off"])
def test_the_states_of_a_drone_are_signs_of_its_life(method):
    """Drone 1 sends no heartbeats; the others hear its states by the collision filter, or in their laws."""
    config = swarm(3, lost_after=1.0, collision={"method": method})

    async def main(clock):
        mission = SimpleNamespace(guidance=lambda i, config: Rests())
        agent = Agent(clock, config, mission, (0, 1, 2))
        running = asyncio.create_task(agent.run())
        while agent.drones[1].pilot.mode is not Mode.FOLLOW:
            await clock.sleep(0.1)
        agent.drones[1].barrier.presence.monitor.silent = True
        await clock.sleep(5.0)
        believed = [agent.drones[i].barrier.presence.monitor.state(1) for i in (0, 2)]
        await running
        return believed

    assert run_virtual(main) == [Presence.ALIVE, Presence.ALIVE]


def test_a_drone_that_may_not_fly_does_not_hold_up_the_others(monkeypatch):
    """Its states are heard while it waits for its radio, but it is no member: it sends no heartbeats."""
    config = swarm(3, start=2, start_deadline=10.0)
    until_fit = MissionRunner._until_fit

    async def wait_for_radio(runner):
        runner.config = SimpleNamespace(
            topology=SimpleNamespace(reached={2}), radio=config.radio
        )
        try:
            await until_fit(runner)
        finally:
            runner.config = config

    monkeypatch.setattr(MissionRunner, "_until_fit", wait_for_radio)

    async def main(clock):
        mission = SimpleNamespace(guidance=lambda i, config: Rests())
        agent = Agent(clock, config, mission, (0, 1, 2))
        agent.drones[2].unfit = lambda: ["its radio does not answer"]
        return await agent.run()

    results = run_virtual(main)
    assert [results[i]["success"] for i in range(3)] == [True, True, False]
    assert "its radio does not answer" in results[2]["reason"]


def test_a_drone_that_a_radio_reaches_is_watched_by_the_figures_of_its_platform():
    drones = [
        {
            "id": i,
            "home": [i, 0, 0],
            "uri": f"udp://127.0.0.1:{19850 + i}",
            "platform": platform,
        }
        for i, platform in enumerate(("cf21", "cf21bl"))
    ]

    async def main(clock):
        config = SwarmConfig.of(
            {"name": "a", "drones": drones, "control": {"sender": "xyz"}}
        )
        agent = Agent(
            clock,
            config,
            mission_of(stays),
            config.ids,
            process=AgentProcess(is_alone=False),
        )
        return [drone.radio_watch.firmware.low for drone in agent.drones.values()]

    assert run_virtual(main) == [3.2, 3.35]
