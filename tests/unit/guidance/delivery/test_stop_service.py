"""StopService: what a robot may pick up, how long it stays at a stop, and when it may leave."""

import asyncio

import pytest
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.config.tables import FlightTable
from crazychoir.guidance.delivery.commitments import Commitments
from crazychoir.guidance.delivery.route_forecast import RouteForecast
from crazychoir.guidance.delivery.stop_service import StopService
from crazychoir.guidance.tasks.task_book import Deed, Record, Task
from crazychoir.guidance.tasks.team_news import TeamNews
from crazychoir.routing.instance.plan import Stop
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import graph_from_name

TASKS = [Task(j, 0, False, (1.0 * j, 1.0), (1.0 * j, 4.0)) for j in range(4)]
PICK, DROP = "pickup", "delivery"


def serving(clock):
    """Robot 0 of five; it has news of all five, and knows the tasks 0 to 3."""
    communicator = Communicator(Bus(clock).port(0), graph_from_name("complete", 5))
    news = TeamNews(communicator, tuple(TASKS), lambda: (0.0, 0.0), False)
    for j in range(1, 5):
        news.book.hear(Record(j, 1, 1, (0.0, 0.0)))
    commitments = Commitments(news)
    forecast = RouteForecast(commitments, FlightTable(), 1.0)
    return StopService(commitments, forecast, 1.0, False)


def cut_off(service):
    service.news.count()
    service.news.communicator.graph = graph_from_name("complete", (0,))


def stops(*pairs):
    return [Stop(j, kind) for j, kind in pairs]


@virtual
async def test_a_pickup_waits_while_it_may_be_given_to_another_robot(clock):
    service = serving(clock)
    commitments = service.commitments
    commitments.route, commitments.planning = stops((1, PICK), (1, DROP)), True
    waits = asyncio.ensure_future(service.wait_for_permission(Stop(1, PICK)))
    await clock.sleep(1.0)
    assert not waits.done()
    commitments.planning = False
    await clock.sleep(0.1)
    assert waits.result()
    assert service.longest_wait == pytest.approx(1.0, abs=0.1)
    commitments.planning, commitments.bound = True, {1: None}
    assert await service.wait_for_permission(Stop(1, PICK))
    cut_off(service)
    waits = asyncio.ensure_future(service.wait_for_permission(Stop(1, PICK)))
    await clock.sleep(1.0)
    service.commitments.route = stops((2, PICK), (2, DROP))
    await clock.sleep(0.1)
    assert not waits.result(), "it has another route now"
    service.commitments.route = stops((2, DROP))
    assert await service.wait_for_permission(Stop(2, DROP)), (
        "what is aboard may always be delivered"
    )


@virtual
async def test_a_drone_leaves_a_stop_when_more_than_half_know_of_it(clock):
    service = serving(clock)
    service.commitments.route = stops((1, PICK), (1, DROP))
    serves = asyncio.ensure_future(service.serve(Stop(1, PICK)))
    await clock.sleep(3.0)
    assert service.commitments.aboard() == {1: None}
    assert service.commitments.route == stops((1, DROP))
    assert not service.served
    number = service.news.record.number
    for j, news in ((1, number), (2, number - 1), (3, number)):
        assert not serves.done()
        service.news.book.hear(Record(j, 1, 2, (0.0, 0.0), seen=((0, 1, news),)))
        await clock.sleep(0.1)
    assert serves.done()
    assert service.served == [{"task": 1, "kind": PICK, "place": (0.0, 0.0)}]


@virtual
async def test_a_stop_takes_its_time_though_all_know(clock):
    service = serving(clock)
    for j in (1, 2, 3, 4):
        service.news.book.hear(Record(j, 1, 2, (0.0, 0.0), seen=((0, 1, 1 << 40),)))
    service.commitments.route = stops((1, PICK), (1, DROP))
    await service.serve(Stop(1, PICK))
    assert clock.now() == pytest.approx(service.service_time)


@pytest.mark.parametrize("kind", [PICK, DROP])
def test_a_robot_cut_off_at_a_stop_leaves_the_goods_there(kind):
    @virtual
    async def test(clock):
        service = serving(clock)
        service.news.say(deeds=() if kind == PICK else (Deed(1, PICK, 1),))
        service.commitments.route = stops(
            (1, kind), *([(1, DROP)] if kind == PICK else []), (2, DROP)
        )
        serves = asyncio.ensure_future(service.serve(Stop(1, kind)))
        await clock.sleep(2.0)
        cut_off(service)
        await serves
        assert service.commitments.aboard() == {}
        assert service.commitments.route == stops((2, DROP)), (
            "what stays there is not delivered either"
        )
        assert len(service.news.record.deeds) == (0 if kind == PICK else 2)

    test()
