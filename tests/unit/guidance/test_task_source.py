"""TaskSource: events in time, an operator's tasks, and what is refused."""

import asyncio

import pytest
from virtual_time import virtual

from crazychoir.bus.local import Bus
from crazychoir.errors import Refused
from crazychoir.guidance.task_book import Task
from crazychoir.guidance.task_source import ADDED, Event, TaskSource
from crazychoir.guidance.team_news import TeamNews
from crazychoir.swarm.communicator import Communicator
from crazychoir.swarm.config import SwarmConfig
from crazychoir.swarm.graph import named

FIRST = Task(0, 0, False, (1.0, 0.0), (2.0, 0.0), 1.0)
HOMES = [{"id": i, "home": [float(i), -2.0, 0.0]} for i in range(2)]
CONFIG = SwarmConfig.of({"name": "lab", "drones": HOMES, "fence": {"min": [-3, -3, 0], "max": [3, 3, 2]}})
WHERE = {"pickup": [1.0, 1.0], "delivery": [2.0, 1.0]}


def source(clock, i=1):
    news = TeamNews(Communicator(Bus(clock).port(i), named("complete", 2)), (FIRST,), lambda: (0.0, 0.0), False)
    return TaskSource(news, CONFIG, 0.4)


@virtual
async def test_events_are_heard_in_time_by_those_who_hear_them(clock):
    one = source(clock)
    one.news.communicator.port.bus.impairment.begin(clock.now())
    later, other, gone = (Task(j, 0, False, (0.0, 0.0), (1.0, 0.0)) for j in (5, 6, 7))
    cancelled = Event(4.0, Task(7, 0, True, gone.pickup, gone.delivery))
    events = [Event(2.0, later, (1,)), Event(2.5, other, (0,)), Event(3.0000001, gone), cancelled]
    job = asyncio.ensure_future(one.hear(events))
    for t, known in ((1.9, [0]), (2.1, [0, 5]), (3.2, [0, 5, 7])):
        await clock.sleep(t - clock.now())
        assert sorted(one.news.book.tasks) == known
    assert not one.news.book.tasks[7].cancelled
    await job
    assert one.news.book.tasks[7].cancelled


@virtual
async def test_an_added_task_has_an_id_that_no_other_robot_gives(clock):
    one, other = source(clock, 1), source(clock, 0)
    assert [one.asked("task_add", WHERE)["id"] for _ in range(2)] == [ADDED + 1, 2 * ADDED + 1]
    assert other.asked("task_add", WHERE | {"load": 2.0, "robots": [1]})["id"] == ADDED
    assert other.news.book.tasks[ADDED] == Task(ADDED, 0, False, (1.0, 1.0), (2.0, 1.0), 2.0, (1,))
    assert one.asked("task_cancel", {"id": ADDED + 1}) == {"id": ADDED + 1}
    assert one.news.book.tasks[ADDED + 1].cancelled


@pytest.mark.parametrize(
    ("verb", "arguments", "said"),
    [
        ("task_add", {"pickup": [1.0, 1.0]}, "task"),
        ("task_add", WHERE | {"pickup": [1.0]}, "length 2"),
        ("task_add", WHERE | {"pickup": [float("nan"), 0.0]}, "task"),
        ("task_add", WHERE | {"load": -1.0}, ">= 0"),
        ("task_add", WHERE | {"weight": 1.0}, "unknown: weight"),
        ("task_add", WHERE | {"delivery": [9.0, 0.0]}, "outside the fence"),
        ("task_add", WHERE | {"delivery": [1.2, -2.1]}, "within 0.4 m of the home of drone 1"),
        ("task_cancel", {"id": 77}, "there is no 77; there are 0"),
        ("task_cancel", {}, "there is no None"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(verb, arguments, said):
    @virtual
    async def test(clock):
        one = source(clock)
        with pytest.raises(Refused, match=said):
            one.asked(verb, arguments)
        assert one.news.book.tasks == {0: FIRST}

    test()


@virtual
async def test_a_mission_that_is_over_takes_no_tasks(clock):
    one = source(clock)
    one.news.say(ended=True)
    with pytest.raises(Refused, match="over"):
        one.asked("task_add", WHERE)
