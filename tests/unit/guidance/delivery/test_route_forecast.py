"""RouteForecast: where stops are, how long a route takes, and whether the robot is late."""

from types import SimpleNamespace

import pytest

from crazychoir.config.tables import FlightTable
from crazychoir.guidance.delivery.route_forecast import RouteForecast
from crazychoir.guidance.tasks.task_book import Task
from crazychoir.routing.instance.plan import Stop

TASKS = {j: Task(j, 0, False, (1.0 * j, 0.0), (1.0 * j, 4.0)) for j in range(4)}
ROUTE = [Stop(1, "pickup"), Stop(1, "delivery"), Stop(3, "pickup")]


@pytest.fixture
def forecast():
    """Return the forecast of a robot at the origin at 10 s; it may begin every task but task 2."""
    news = SimpleNamespace(
        book=SimpleNamespace(tasks=TASKS),
        standings=lambda: {
            j: SimpleNamespace(pickup=task.pickup) for j, task in TASKS.items()
        },
        here=lambda: (0.0, 0.0),
        clock=SimpleNamespace(now=lambda: 10.0),
    )
    commitments = SimpleNamespace(
        news=news, route=list(ROUTE), allow=lambda stop: stop.task != 2
    )
    return RouteForecast(commitments, FlightTable(), 1.5)


def test_goods_are_fetched_where_they_lie_now(forecast):
    assert forecast.place(Stop(2, "pickup")).tolist() == [2.0, 0.0]
    assert forecast.place(Stop(2, "delivery")).tolist() == [2.0, 4.0]
    moved = {2: SimpleNamespace(pickup=(9.0, 9.0))}
    forecast.news.standings = lambda: moved
    assert forecast.place(Stop(2, "pickup")).tolist() == [9.0, 9.0]


def test_a_route_takes_its_flights_and_its_services(forecast):
    assert forecast.seconds([]) == 0.0
    flights = [
        forecast.seconds(ROUTE[: n + 1]) - forecast.seconds(ROUTE[:n]) for n in range(3)
    ]
    assert all(seconds > forecast.service_time for seconds in flights)
    assert flights[0] < flights[1], "1 m, and 4 m"
    forecast.serving_until = 10.5
    assert forecast.seconds([]) == 0.5


def test_a_robot_is_bound_to_its_next_stop_and_those_within_the_horizon(forecast):
    first = forecast.seconds(ROUTE[:1])
    assert forecast.head(0.5 * first)[0] == ROUTE[:1]
    head, place, seconds = forecast.head(1.5 * first)
    assert head == ROUTE[:2]
    assert place.tolist() == [1.0, 4.0]
    assert seconds == forecast.seconds(ROUTE[:2])
    assert forecast.head(1e9)[0] == ROUTE


def test_a_robot_is_not_bound_to_a_stop_that_it_may_not_begin(forecast):
    forecast.commitments.route.insert(1, Stop(2, "pickup"))
    assert forecast.head(1e9)[0] == ROUTE[:1]


def test_a_robot_is_late_when_it_breaks_its_promise_by_more_than_is_allowed(forecast):
    assert not forecast.is_late(0.0), "it has promised nothing yet"
    forecast.promise()
    assert forecast.promised == 10.0 + forecast.seconds(ROUTE)
    assert not forecast.is_late(0.0)
    forecast.news.clock.now = lambda: 13.0
    assert forecast.is_late(2.9)
    assert not forecast.is_late(3.1)
    forecast.commitments.route = []
    assert not forecast.is_late(0.0), "it has nothing to do"
