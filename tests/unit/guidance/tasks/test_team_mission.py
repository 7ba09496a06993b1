"""TeamMission: when a team plans, what a robot that is cut off or left alone does, and how all ends."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.errors import ConfigError
from crazychoir.guidance.member import Interrupted, Member
from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.tasks.task_assignment import TaskRoom
from crazychoir.guidance.tasks.task_book import Record
from crazychoir.guidance.tasks.task_source import TaskSource
from crazychoir.guidance.tasks.team_mission import (
    PLAN_LOOK_INTERVAL,
    TeamMission,
    TeamRules,
)
from crazychoir.guidance.tasks.team_news import NEWS_TIMING, UNREACHED_REASON
from crazychoir.safety.rules.modes import Mode
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import graph_from_name
from crazychoir.types import State

CONFIG = load_mission("task_assignment").swarm(3)
RULES = TeamRules(recover=False, news_period=0.2, reunion_time=5.0)


class StandInPilot:
    """A pilot that lands at once, and remembers why."""

    def __init__(self, clock, i):
        self.clock = clock
        self.port = SimpleNamespace(address=i)
        self.airborne = True
        self.permission = SimpleNamespace(held=False)
        self.mode = Mode.HOVER
        self.state = State.at((float(i), 1.0, 0.5))
        self.landings = []

    def land(self, reason=""):
        self.landings.append(reason)
        self.airborne = False


class CountingMission(TeamMission):
    """Plan when asked to, and end with the n-th planning."""

    def __init__(self, last):
        super().__init__(RULES)
        self.last = last
        self.wanted = False
        self.plans = []
        self.lost = []
        self.flown = False

    def bind(self, member):
        super().bind(member)
        self.source = TaskSource(self.news, TaskRoom(member.config))

    async def plan_once(self, key):
        self.wanted = False
        await self.sleep(0.1)
        self.plans.append((key, self.member.clock.now()))
        if len(self.plans) == self.last:
            self.news.say(ended=True)
        return True

    def needs_plan(self, alive):
        return self.wanted

    def lose_quorum(self):
        self.lost.append(self.member.clock.now())

    async def fly_plan(self):
        while not self.is_over:
            await self.sleep(0.1)
        self.flown = True

    def outcome(self):
        return {"plans": len(self.plans)}


def team(clock, count=3, last=1, kind=CountingMission):
    graph = graph_from_name("complete", count)
    bus = Bus(clock)
    missions = {}
    for i in graph.ids:
        missions[i] = kind(last)
        communicator = Communicator(bus.port(i), graph)
        pilot = StandInPilot(clock, i)
        missions[i].bind(Member(i, CONFIG, clock, communicator, pilot))
    return missions


def start(missions):
    return {
        i: asyncio.ensure_future(mission.mission()) for i, mission in missions.items()
    }


async def disappear(missions, runs, *ids):
    """End these robots without a word to the others."""

    async def say_nothing():
        pass

    for i in ids:
        missions[i].news.last_words = say_nothing
    await end({i: runs.pop(i) for i in ids})


async def end(runs):
    for run in runs.values():
        run.cancel()
    await asyncio.gather(*runs.values(), return_exceptions=True)


@virtual
async def test_a_team_plans_once_and_ends_together(clock):
    missions = team(clock)
    results = await asyncio.gather(*start(missions).values())
    assert results == [{"plans": 1}] * 3
    assert all(mission.flown for mission in missions.values())
    assert clock.now() < 2.0


@virtual
async def test_when_a_robot_begins_a_planning_the_others_plan_too(clock):
    missions = team(clock, last=9)
    runs = start(missions)
    await clock.sleep(1.0)
    assert [len(mission.plans) for mission in missions.values()] == [1, 1, 1]
    missions[1].wanted = True
    await clock.sleep(3 * RULES.news_period + 0.1)
    times = [mission.plans[1][1] for mission in missions.values()]
    assert times[1] < 1.0 + 0.1 + 2 * PLAN_LOOK_INTERVAL
    assert not any(run.done() for run in runs.values())
    await end(runs)


@virtual
async def test_a_robot_that_is_cut_off_is_told_so_once_and_plans_no_more(clock):
    missions = team(clock, last=9)
    runs = start(missions)
    await clock.sleep(1.0)
    missions[0].news.key = lambda: (1, ())
    missions[0].news.count = lambda: False
    missions[0].wanted = True
    await clock.sleep(1.0)
    assert len(missions[0].lost) == 1
    assert len(missions[0].plans) == 1
    await end(runs)


@virtual
async def test_a_robot_that_is_left_alone_gives_up_lands_and_tells_why(clock):
    missions = team(clock, last=9)
    runs = start(missions)
    await clock.sleep(1.0)
    await disappear(missions, runs, 1, 2)
    since = clock.now()
    with pytest.raises(Interrupted, match=f"drone 0: {UNREACHED_REASON} for 5 s"):
        await runs[0]
    assert clock.now() > since + NEWS_TIMING.silence
    (why,) = missions[0].member.pilot.landings
    assert why.startswith("mission failed: drone 0: ")
    assert missions[0].news.record.out


@virtual
async def test_a_busy_robot_is_not_left_alone(clock):
    missions = team(clock, last=9)
    missions[0].is_busy = lambda: True
    runs = start(missions)
    await clock.sleep(1.0)
    await disappear(missions, runs, 1, 2)
    await clock.sleep(30.0)
    assert not runs[0].done()
    await end(runs)


@virtual
async def test_a_robot_that_cannot_fly_on_lands_and_leaves_the_plans_to_the_others(
    clock,
):
    missions = team(clock, last=3)

    async def broken():
        await clock.sleep(1.0)
        raise ConfigError("drone 2", "a fault", "none")

    missions[2].fly_plan = broken
    runs = start(missions)
    await clock.sleep(2.0)
    assert missions[2].member.pilot.landings == [""]
    assert missions[2].news.record.out
    assert missions[0].plans[-1][0] == (0, (2,)), "the others plan without it"
    missions[0].wanted = True
    results = await asyncio.gather(*runs.values())
    assert [result.get("success") for result in results] == [None, None, False]
    assert "a fault" in results[2]["reason"]


@pytest.mark.parametrize("text", ["broken", ""])
def test_an_unexpected_error_comes_out_alone_after_the_landing(text):
    @virtual
    async def test(clock):
        missions = team(clock, last=9)

        async def broken():
            raise RuntimeError(text)

        missions[0].fly_plan = broken
        with pytest.raises(RuntimeError) as found:
            await missions[0].mission()
        assert str(found.value) == text
        (why,) = missions[0].member.pilot.landings
        assert why.startswith("mission failed: ")
        assert why.endswith(text or "raised without a text")

    test()


@virtual
async def test_a_cancelled_mission_lands_without_a_reason(clock):
    missions = team(clock, last=9)
    runs = start(missions)
    await clock.sleep(1.0)
    await end(runs)
    assert [mission.member.pilot.landings for mission in missions.values()] == [
        [""]
    ] * 3
    assert all(mission.news.record.out for mission in missions.values())


@virtual
async def test_the_place_of_a_robot_is_its_last_encodable_position(clock):
    mission = team(clock)[1]
    seen = []
    for p in ((2.0, 1.0, 0.5), (float("nan"), 0.0, 0.5), (1e9, 0.0, 0.5), (3, 1, 0)):
        mission.member.pilot.state = SimpleNamespace(p=np.array(p, dtype=float))
        seen.append(mission.here())
    assert seen == [(2.0, 1.0), (2.0, 1.0), (2.0, 1.0), (3.0, 1.0)]


@virtual
async def test_a_place_is_flown_to_at_take_off_height(clock):
    flight = CONFIG.flight
    height = flight.ground + flight.takeoff_height
    assert team(clock)[0].above((1.0, 2.0)) == pytest.approx([1.0, 2.0, height])
    assert team(clock)[0].above((1.0, 2.0, 9.0)) == pytest.approx([1.0, 2.0, height])


@virtual
async def test_the_robot_with_the_lowest_id_in_flight_speaks_for_all(clock):
    missions = team(clock)
    for mission in missions.values():
        for i in (0, 1, 2):
            mission.news.book.hear(Record(i, 9, 9, (0.0, 0.0), out=i == 0))
    assert [mission.speaks for mission in missions.values()] == [False, True, False]
