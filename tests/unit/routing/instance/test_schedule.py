"""What becomes of a plan when it is flown."""

import math

import pytest

from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Route
from crazychoir.routing.instance.schedule import (
    is_timed,
    split_into_trips,
    summarise_plan,
)

RAW = {
    "home": [[0.0, 0.0], [0.0, 8.0]],
    "pickup": [[1.0, 0.0], [2.0, 0.0]],
    "delivery": [[1.0, 1.0], [2.0, 1.0]],
    "load": [1.0, 1.0],
    "capacity": [1.0, 1.0],
}
NODES = [0, 2, 5, 1, 3]
"""Task 0, a recharge, task 1."""


def route(instance, nodes, robot=0):
    vehicle = instance.local(robot).vehicle
    return Route.from_nodes(robot, nodes, 2, vehicle.length(nodes))


def test_a_recharge_parts_a_route_into_trips():
    instance = Instance.parse(
        RAW | {"recharge": 2, "end": [[0.0, 3.0], None], "speed": 0.5}
    )
    one, two = split_into_trips(instance, route(instance, NODES))
    first, second = 1 + 1 + math.hypot(1, 2), math.hypot(2, 3) + 1 + math.hypot(2, 2)
    assert (one.number, two.number) == (1, 2)
    assert (one.length, two.length) == (pytest.approx(first), pytest.approx(second))
    assert [stop.task for stop in one.stops + two.stops] == [0, 0, 1, 1]
    assert one.begins == pytest.approx((2.0, 4.0))
    assert one.end == pytest.approx(2 * first)
    assert two.begins == pytest.approx(
        (2 * first + 2 * math.hypot(2, 3), 2 * first + 2 * math.hypot(2, 3) + 2)
    )
    assert two.end == pytest.approx(2 * (first + second))
    assert two.to_json()["stops"] == ["+1", "-1"]


def test_services_wait_for_their_windows_and_take_their_time():
    windows = {"time_windows": {"pickup": [[5, 9], None]}, "service_time": 2.0}
    instance = Instance.parse(RAW | windows)
    (only,) = split_into_trips(instance, route(instance, [0, 2]))
    assert only.begins == (5.0, 8.0)
    assert only.end == pytest.approx(10 + math.hypot(1, 1))
    assert only.end == instance.local(0).vehicle.finish([0, 2])


@pytest.mark.parametrize(
    ("change", "matter"),
    [
        ({}, False),
        ({"speed": 0.5, "service_time": 1.0}, False),
        ({"objective": "makespan"}, True),
        ({"objective": ["total", "makespan"]}, True),
        ({"release": [0.0, 1.0]}, True),
        ({"time_windows": {"delivery": [None, [0, 50]]}}, True),
        ({"time_windows": {"home": [None, [1, None]]}}, True),
        ({"time_windows": {"home": [[0, 50], None]}}, True),
    ],
)
def test_times_matter_where_something_asks_for_them(change, matter):
    assert is_timed(Instance.parse(RAW | change)) is matter


def test_the_outcome_names_what_is_refused_and_what_is_wrong():
    instance = Instance.parse(RAW | {"penalty": [None, 4.0], "priority": [0, 3]})
    found = summarise_plan(instance, [route(instance, [0, 2])])
    assert found["refused"] == [{"task": 1, "penalty": 4.0, "priority": 3}]
    assert found["penalties"] == 4.0
    assert found["violations"] == []
    assert (
        found["total_m"] == found["makespan_s"] == pytest.approx(2 + math.hypot(1, 1))
    )
    wrong = summarise_plan(instance, [route(instance, [1, 3])])
    assert wrong["refused"] == []
    assert wrong["violations"] == ["task 0 is served 0 times, not once"]
    nothing = summarise_plan(Instance.parse(RAW | {"penalty": [1.0, 4.0]}), [])
    assert (nothing["trips"], nothing["makespan_s"], nothing["penalties"]) == (
        [],
        0.0,
        5.0,
    )
