"""TaskSource: events in time, an operator's tasks, when they are taken, and what is refused."""

import asyncio
from contextlib import asynccontextmanager

import pytest
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.guidance.tasks.task_book import Deed, Fate, Record, Task
from crazychoir.guidance.tasks.task_source import (
    COMMAND_PATIENCE,
    FIRST_ADDED_ID,
    TaskEvent,
    TaskSource,
)
from crazychoir.guidance.tasks.team_news import NEWS_TIMING, TeamNews
from crazychoir.routing.instance.instance import Instance
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import graph_from_name

FIRST = Task(0, 0, False, (1.0, 0.0), (2.0, 0.0), 1.0)
HOMES = [{"id": i, "home": [float(i), -2.0, 0.0]} for i in range(3)]
CONFIG = SwarmConfig.of(
    {"name": "lab", "drones": HOMES, "fence": {"min": [-3, -3, 0], "max": [3, 3, 2]}}
)
WHERE = {"pickup": [1.0, 1.0], "delivery": [2.0, 1.0]}
CREW = Instance.parse(
    {
        "home": [drone["home"][:2] for drone in HOMES],
        "pickup": [[1.0, 0.0]],
        "delivery": [[2.0, 0.0]],
        "load": [1.0],
        "capacity": [2.0, 3.0, 3.0],
    }
)
SITE = DeliverySite(CONFIG, 0.4, CREW)


def source(bus, i=1, events=(), may_end=lambda: False):
    news = TeamNews(
        Communicator(bus.port(i), graph_from_name("complete", 3)),
        (FIRST,),
        lambda: (0.0, 0.0),
        False,
    )
    return TaskSource(news, SITE, events, may_end)


@asynccontextmanager
async def talking(*sources):
    jobs = [asyncio.ensure_future(one.news.gossip()) for one in sources]
    try:
        await sources[0].news.clock.sleep(5 * NEWS_TIMING.period)
        yield sources
    finally:
        for job in jobs:
            job.cancel()
        await asyncio.gather(*jobs, return_exceptions=True)


@virtual
async def test_an_addressed_robot_hears_of_events_in_time(clock):
    later, other, gone = (Task(j, 0, False, (0.0, 0.0), (1.0, 0.0)) for j in (5, 6, 7))
    cancelled = TaskEvent(4.0, Task(7, 0, True, gone.pickup, gone.delivery))
    one = source(
        Bus(clock),
        1,
        [
            TaskEvent(2.0, later, (1,)),
            TaskEvent(2.5, other, (0,)),
            TaskEvent(3.0000001, gone),
            cancelled,
        ],
    )
    one.news.communicator.port.bus.impairment.begin(clock.now())
    job = asyncio.ensure_future(one.hear())
    for t, known in ((1.9, [0]), (2.1, [0, 5]), (3.2, [0, 5, 7])):
        await clock.sleep(t - clock.now())
        assert sorted(one.news.book.tasks) == known
        assert not one.heard_all
    assert not one.news.book.tasks[7].cancelled
    await job
    assert one.heard_all
    assert one.news.book.tasks[7].cancelled


@virtual
async def test_an_added_task_has_an_id_that_no_other_robot_gives(clock):
    bus = Bus(clock)
    async with talking(source(bus, 1), source(bus, 0), source(bus, 2)) as (
        one,
        other,
        _,
    ):
        assert [(await one.asked("task_add", WHERE))["id"] for _ in range(2)] == [
            FIRST_ADDED_ID + 1,
            2 * FIRST_ADDED_ID + 1,
        ]
        assert await other.asked("task_add", WHERE | {"load": 2.0, "robots": [1]}) == {
            "id": FIRST_ADDED_ID
        }
        assert other.news.book.tasks[FIRST_ADDED_ID] == Task(
            FIRST_ADDED_ID, 0, False, (1.0, 1.0), (2.0, 1.0), 2.0, (1,)
        )
        assert await one.asked("task_cancel", {"id": FIRST_ADDED_ID + 1}) == {
            "id": FIRST_ADDED_ID + 1
        }
        assert one.news.book.tasks[FIRST_ADDED_ID + 1].cancelled


@virtual
async def test_the_list_says_of_each_task_where_it_lies_and_what_has_become_of_it(
    clock,
):
    bus = Bus(clock)
    async with talking(source(bus, 1), source(bus, 0), source(bus, 2)) as (one, _, _):
        await one.asked("task_add", WHERE)
        await one.asked("task_cancel", {"id": FIRST_ADDED_ID + 1})
        one.news.say(deeds=(Deed(0, "pickup", 1),))
        first = {
            "id": 0,
            "pickup": [1.0, 0.0],
            "delivery": [2.0, 0.0],
            "load": 1.0,
            "fate": "aboard",
            "robot": 1,
        }
        second = WHERE | {
            "id": FIRST_ADDED_ID + 1,
            "load": 1.0,
            "fate": "cancelled",
            "robot": None,
        }
        assert await one.asked("task_list", {}) == {"tasks": [first, second]}


@virtual
async def test_what_is_accepted_is_known_to_more_than_half_of_the_team(clock):
    bus = Bus(clock)
    async with talking(source(bus, 1), source(bus, 0), source(bus, 2)) as (
        one,
        *others,
    ):
        j = (await one.asked("task_add", WHERE))["id"]
        assert any(j in other.news.book.tasks for other in others)
        await one.asked("task_cancel", {"id": j})
        assert any(
            other.news.book.tasks[j].cancelled
            for other in others
            if j in other.news.book.tasks
        )


@virtual
async def test_a_robot_that_no_other_hears_notes_it_in_its_answer(clock):
    bus = Bus(clock)
    async with talking(source(bus, 1), source(bus, 0), source(bus, 2)) as (one, *_):
        pass
    began = clock.now()
    said = await one.asked("task_add", WHERE)
    assert (said["id"], clock.now() - began) == (
        FIRST_ADDED_ID + 1,
        pytest.approx(COMMAND_PATIENCE, abs=0.1),
    )
    assert "less than half of the team has received it" in said["note"]


@virtual
async def test_a_restarted_robot_gives_no_task_number_twice(clock):
    """It would: its book is empty until it hears the others', and of two tasks of one number one is lost."""
    bus = Bus(clock)
    async with talking(source(bus, 1), source(bus, 0), source(bus, 2)) as (one, *_):
        first = (await one.asked("task_add", WHERE))["id"]
    bus.close(1)
    again = source(bus, 1)
    again.news.record = Record(1, 2, 1, (0.0, 0.0))
    with pytest.raises(Refused, match="heard from too few other drones"):
        await again.asked("task_add", WHERE)
    assert again.news.book.tasks == {0: FIRST}
    bus.close(0)
    bus.close(2)
    async with talking(again, *(restarted(bus, one, i) for i in (0, 2))):
        assert (await again.asked("task_add", WHERE))["id"] not in (first, 0)


def restarted(bus, knows, i):
    other = source(bus, i)
    other.news.book.merge(knows.news.book)
    other.news.record = Record(i, 2, 1, (0.0, 0.0))
    return other


@virtual
async def test_nothing_is_taken_while_the_team_decides_that_its_mission_is_over(clock):
    bus, deciding = Bus(clock), [True]
    async with talking(
        source(bus, 1, may_end=lambda: deciding[0]), source(bus, 0), source(bus, 2)
    ) as (one, *_):
        for ended in (False, True):
            deciding[:] = [True]
            asked = asyncio.ensure_future(one.asked("task_add", WHERE))
            await clock.sleep(0.5)
            assert not asked.done()
            before = dict(one.news.book.tasks)
            deciding[:] = [False]
            if ended:
                one.news.say(ended=True)
                with pytest.raises(Refused, match="over"):
                    await asked
                assert one.news.book.tasks == before
            else:
                assert (await asked)["id"] == FIRST_ADDED_ID + 1


@virtual
async def test_a_task_for_an_absent_drone_waits_and_the_answer_says_so(clock):
    bus = Bus(clock)
    async with talking(source(bus, 1), source(bus, 0), source(bus, 2)) as (
        one,
        _,
        gone,
    ):
        gone.news.say(out=True)
        await clock.sleep(5 * NEWS_TIMING.period)
        said = await one.asked("task_add", WHERE | {"robots": [2]})
        assert said == {
            "id": FIRST_ADDED_ID + 1,
            "note": "it waits: drone 2, which alone can serve it, does not fly",
        }
        assert one.news.standings()[FIRST_ADDED_ID + 1].fate is Fate.OPEN
        with pytest.raises(Refused, match="this drone has landed; ask another drone"):
            await gone.asked("task_add", WHERE)


@pytest.mark.parametrize(
    ("verb", "arguments", "said"),
    [
        ("task_add", {"pickup": [1.0, 1.0]}, "`delivery`"),
        ("task_add", WHERE | {"pickup": [1.0]}, "length 2.*`pickup`.*allowed: places"),
        ("task_add", WHERE | {"pickup": [float("nan"), 0.0]}, "`pickup|places"),
        ("task_add", WHERE | {"load": -1.0}, ">= 0.*`load`"),
        ("task_add", WHERE | {"load": float("nan")}, "`load`"),
        (
            "task_add",
            WHERE | {"load": 3.5},
            "its load 3.5 is more than any drone can carry: 3",
        ),
        (
            "task_add",
            WHERE | {"load": 2.5, "robots": [0]},
            "more than drone 0, which alone may serve it, can carry: 2",
        ),
        (
            "task_add",
            WHERE | {"robots": [0, 77]},
            "there is no drone 77; this swarm has 0 to 2",
        ),
        (
            "task_add",
            WHERE | {"weight": 1.0},
            "unknown: weight; there are pickup, delivery, load, robots",
        ),
        (
            "task_add",
            WHERE | {"delivery": [9.0, 0.0]},
            r"its delivery \[9, 0\] is outside the fence, \[-3, -3\] to",
        ),
        (
            "task_add",
            WHERE | {"delivery": [1.2, -2.1]},
            "0.22 m from the home of drone 1.*clearance is 0.4 m",
        ),
        ("task_cancel", {"id": 77}, "there is no 77; there are 0"),
        ("task_cancel", {}, "there is no None"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(verb, arguments, said):
    @virtual
    async def test(clock):
        bus = Bus(clock)
        async with talking(source(bus, 1), source(bus, 0), source(bus, 2)) as (one, *_):
            with pytest.raises(Refused, match=said):
                await one.asked(verb, arguments)
            assert one.news.book.tasks == {0: FIRST}

    test()


PICKED, DELIVERED = Deed(0, "pickup", 1), Deed(0, "delivery", 1)


@pytest.mark.parametrize(
    ("done", "gone", "said"),
    [
        (
            (PICKED,),
            False,
            {"id": 0, "note": "it is on board drone 2, which will still deliver it"},
        ),
        ((PICKED,), True, "0 is lost, with drone 2 that had it aboard"),
        ((PICKED, DELIVERED), False, "drone 2 has delivered 0 already"),
    ],
)
def test_the_answer_to_a_cancel_says_what_has_become_of_the_task(done, gone, said):
    @virtual
    async def test(clock):
        bus = Bus(clock)
        async with talking(source(bus, 1), source(bus, 0), source(bus, 2)) as (
            one,
            _,
            carrier,
        ):
            carrier.news.say(deeds=done, out=gone)
            await clock.sleep(5 * NEWS_TIMING.period)
            if isinstance(said, dict):
                assert await one.asked("task_cancel", {"id": 0}) == said
            else:
                with pytest.raises(Refused, match=said):
                    await one.asked("task_cancel", {"id": 0})
                assert not one.news.book.tasks[0].cancelled

    test()


@virtual
async def test_cancelling_twice_is_no_harm_and_said(clock):
    bus = Bus(clock)
    async with talking(source(bus, 1), source(bus, 0), source(bus, 2)) as (one, *_):
        assert await one.asked("task_cancel", {"id": 0}) == {"id": 0}
        assert await one.asked("task_cancel", {"id": 0}) == {
            "id": 0,
            "note": "it was cancelled already",
        }


@virtual
async def test_a_mission_that_is_over_takes_no_tasks(clock):
    one = source(Bus(clock))
    one.news.say(ended=True)
    with pytest.raises(Refused, match="over"):
        await one.asked("task_add", WHERE)
