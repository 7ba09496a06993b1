"""OnlinePDVRPGuidance on the ground: to what a robot is bound, what it may pick up, when it may leave a stop."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.guidance.delivery.online_delivery import (
    ONLINE_TIMING,
    OnlinePDVRPGuidance,
)
from crazychoir.guidance.delivery.replanning import PlannedGoods, PlanShare
from crazychoir.guidance.member import Member
from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.tasks.task_book import Deed, Record, Task, TaskBook
from crazychoir.guidance.tasks.task_source import TaskEvent
from crazychoir.routing.instance.plan import Stop
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import graph_from_name

MISSION = load_mission("online_delivery")
CONFIG = MISSION.swarm(5)
TASKS = [Task(j, 0, False, (1.0 * j, 1.0), (1.0 * j, 4.0)) for j in range(4)]
PICK, DROP = "pickup", "delivery"


def robot(clock, i=0):
    """Robot i of five; it has news of all five, and knows the tasks 0 to 3."""
    guidance = OnlinePDVRPGuidance(
        MISSION.hooks.instance(CONFIG).local(i),
        TASKS,
        (),
        MISSION.hooks.options(CONFIG),
    )
    communicator = Communicator(Bus(clock).port(i), CONFIG.graph())
    guidance.bind(Member(i, CONFIG, clock, communicator, SimpleNamespace(state=None)))
    for j in CONFIG.ids:
        if j != i:
            guidance.news.book.hear(Record(j, 1, 1, (0.0, 0.0)))
    return guidance


def cut_off(guidance):
    guidance.news.count()
    guidance.member.communicator.graph = graph_from_name("complete", (guidance.id,))


def stops(*pairs):
    return [Stop(j, kind) for j, kind in pairs]


ROUTE = stops((0, PICK), (1, PICK), (0, DROP), (1, DROP), (2, PICK), (2, DROP))


@virtual
async def test_a_robot_is_bound_to_where_it_flies_and_to_what_follows_soon(clock):
    guidance = robot(clock)
    assert guidance.forecast.head(ONLINE_TIMING.binding_horizon)[0] == []
    guidance.commitments.route = list(ROUTE)
    head, start, ready = guidance.forecast.head(ONLINE_TIMING.binding_horizon)
    assert head == ROUTE[: len(head)]
    assert 0 < len(head) < len(ROUTE)
    assert start == pytest.approx(guidance.forecast.place(head[-1]))
    assert ready == pytest.approx(guidance.forecast.seconds(head))
    assert ready > ONLINE_TIMING.binding_horizon or head == ROUTE
    assert guidance.forecast.seconds(head[:-1]) <= ONLINE_TIMING.binding_horizon
    guidance.commitments.route = stops((3, DROP))
    assert (
        guidance.forecast.head(ONLINE_TIMING.binding_horizon)[0]
        == guidance.commitments.route
    ), "however far"


@virtual
async def test_its_route_is_over_the_stops_that_are_left_home(clock):
    guidance = robot(clock)
    assert guidance.route() == []
    guidance.commitments.route = stops((1, PICK), (1, DROP))
    z, home = (
        CONFIG.flight.ground + CONFIG.flight.takeoff_height,
        guidance.own.home[:2].tolist(),
    )
    assert np.allclose(guidance.route(), [[1.0, 1.0, z], [1.0, 4.0, z], [*home, z]])
    guidance.commitments.route, guidance.up = [], True
    assert np.allclose(guidance.route(), [[*home, z]])
    guidance.up = False
    assert guidance.route() == [], "it stands at home"


@virtual
async def test_while_others_may_have_a_new_plan_it_is_bound_to_no_new_pickup(clock):
    guidance = robot(clock)
    commitments = guidance.commitments
    commitments.route, commitments.planning = list(ROUTE), True
    assert guidance.forecast.head(ONLINE_TIMING.binding_horizon)[0] == []
    commitments.bound = {0: None}
    assert guidance.forecast.head(ONLINE_TIMING.binding_horizon)[0] == ROUTE[:1]
    guidance.commitments.route = stops((0, DROP), (1, PICK))
    assert guidance.forecast.head(ONLINE_TIMING.binding_horizon)[0] == stops(
        (0, DROP)
    ), "no other robot may serve goods on board"
    commitments.planning, commitments.bound = False, {}
    cut_off(guidance)
    assert guidance.forecast.head(ONLINE_TIMING.binding_horizon)[0] == stops((0, DROP))


@virtual
async def test_goods_that_are_not_there_are_left_out(clock):
    guidance = robot(clock)
    guidance.news.book.hear(Record(3, 1, 2, (0.0, 0.0), (Deed(0, PICK, 1),)))
    guidance.news.book.cancel(1)
    guidance.commitments.route = list(ROUTE)
    assert guidance.commitments.next() == Stop(2, PICK)
    assert guidance.commitments.route == stops((2, PICK), (2, DROP))


@virtual
async def test_a_drone_on_its_way_to_goods_turns_to_where_they_are_heard_to_lie(clock):
    guidance = robot(clock)
    guidance.news.recover, guidance.up, flown = True, True, []

    async def go_to(p):
        flown.append(tuple(p[:2]))
        await clock.sleep(1.0)
        if len(flown) == 1:
            guidance.news.book.hear(
                Record(9, 1, 2, (3.0, 3.0), (Deed(1, PICK, 1),))
            )  # robot 9 says its new place

    guidance.go_to = go_to
    guidance.member.pilot.remaining = lambda: 0.0
    guidance.news.book.hear(Record(9, 1, 1, (1.0, 1.0), (Deed(1, PICK, 1),)))
    guidance.commitments.route = stops((1, PICK), (1, DROP))
    assert not await guidance._reach(Stop(1, PICK))
    assert await guidance._reach(Stop(1, PICK))
    assert flown == [(1.0, 1.0), (3.0, 3.0)]
    guidance.news.book.hear(Record(9, 1, 3, (3.1, 3.0), (Deed(1, PICK, 1),)))
    assert guidance._leads_to(Stop(1, PICK), np.array([3.0, 3.0])), (
        "near enough: a place is never known to the mm"
    )


@virtual
async def test_a_new_plan_keeps_what_it_was_bound_to_and_leaves_out_what_is_done(clock):
    guidance = robot(clock)
    guidance.commitments.begin(ROUTE[:2])
    guidance.news.say(deeds=(Deed(0, PICK, 1),), idle=True)
    new = Task(9, 0, False, (2.0, 2.0), (3.0, 3.0))
    shared = stops((9, PICK), (0, DROP), (1, DROP), (9, DROP))
    guidance._adopt(PlanShare(tuple(shared), (3,), TaskBook([*TASKS, new]), False, {}))
    assert guidance.commitments.route == stops(
        (1, PICK), (9, PICK), (0, DROP), (1, DROP), (9, DROP)
    )
    assert not guidance.commitments.planning
    assert list(guidance.notes.unserved) == [3]
    assert not guidance.news.record.idle
    assert guidance.news.book.tasks[9] == new, "it may hear of it by the plan first"


@virtual
async def test_its_own_problem_begins_where_it_will_be_with_what_it_may(clock):
    guidance = robot(clock, 1)
    later = Task(20, 0, False, (2.0, 2.0), (3.0, 3.0), robots=(4,))
    tasks = (*TASKS, later)
    mine, free = (False, True, False, False, False), (True, False, False, True, True)
    goods = PlannedGoods(tasks, tuple(t.pickup for t in tasks), mine, free, (None,) * 5)
    local = guidance._problem(goods, np.array([2.0, 3.0]), 4.0, 7.0)
    capable = guidance.own.capable[:4]
    assert local.capable.tolist() == [capable[0], capable[1], False, capable[3], False]
    assert local.aboard.tolist() == [False, True, False, False, False]
    assert (local.start.tolist(), local.start_time, local.left) == (
        [2.0, 3.0],
        4.0,
        7.0,
    )
    assert local.vehicle.tasks == 5


@virtual
async def test_no_robot_is_capable_of_a_task_at_an_unreachable_place(clock):
    outside, above = (
        Task(20, 0, False, (2.0, 2.0), (99.0, 3.0)),
        Task(21, 0, False, (0.0, -0.8), (1.0, 1.0)),
    )
    fallen = Task(22, 0, False, (1.0, 1.0), (2.0, 2.0))
    tasks, mine = (*TASKS[:1], outside, above, fallen, fallen), (False,) * 5
    pickup = (*(task.pickup for task in tasks[:3]), (0.0, -0.8), (0.0, -0.8))
    goods = PlannedGoods(tasks, pickup, mine, (True,) * 5, (None, None, None, 0, 1))
    capable = {
        i: robot(clock, i)._problem(goods, np.zeros(2), 0.0, 9.0).capable.tolist()
        for i in (1, 2)
    }
    for i, found in capable.items():
        assert found == [
            MISSION.hooks.instance(CONFIG).local(i).capable[0],
            False,
            False,
            True,
            False,
        ], i


def test_what_is_left_alone_is_said_with_the_reason(caplog):
    @virtual
    async def test(clock):
        guidance = robot(clock)
        limited = Task(23, 0, False, (1.0, 1.0), (2.0, 2.0))
        bad = {
            20: (
                Task(20, 0, False, (2.0, 2.0), (99.0, 3.0)),
                "its delivery [99, 3] is outside the fence",
            ),
            21: (
                Task(21, 0, False, (1.0, 1.0), (2.0, 2.0), 5.0),
                "its load 5 is more than any drone can carry",
            ),
            22: (
                Task(22, 0, False, (1.0, 1.0), (2.0, 2.0), 1.0, (4,)),
                "drone 4, which alone can serve it, does not",
            ),
            23: (limited, "has enough left of its route_length_limit"),
        }
        guidance.news.book.hear(Record(4, 1, 2, (0.0, 0.0), out=True))
        book = TaskBook([*TASKS, *(task for task, _ in bad.values())])
        for _ in range(2):
            guidance.commitments.begin([])
            guidance._adopt(PlanShare((), tuple(bad), book, False, {}))
        for j, (_, why) in bad.items():
            assert why in guidance.outcome()["unserved"][str(j)]
            assert caplog.text.count(f"task {j} is left alone") == 1, (
                "once, not at every planning"
            )

    test()


@virtual
async def test_a_robot_that_does_not_know_where_it_is_stays_where_it_was(clock):
    guidance = robot(clock)
    seen = []
    for p in (
        [1.0, 2.0, 0.5],
        [float("nan"), 2.0, 0.5],
        [1e9, 0.0, 0.0],
        [1.5, 2.0, 0.5],
    ):
        guidance.member.pilot.state = SimpleNamespace(p=np.array(p))
        seen.append(guidance.news.here())
    assert seen == [(1.0, 2.0), (1.0, 2.0), (1.0, 2.0), (1.5, 2.0)]


@virtual
async def test_a_robot_is_not_idle_while_events_are_to_come(clock):
    guidance = robot(clock)
    guidance.options = replace(guidance.options, until=0.0)
    late = TaskEvent(0.0, Task(20, 0, False, (2.0, 2.0), (3.0, 3.0)))
    guidance.source.events = (late,)
    await guidance._rest()
    assert not guidance.news.record.idle
    await guidance.source.hear()
    await guidance._rest()
    assert guidance.news.record.idle
