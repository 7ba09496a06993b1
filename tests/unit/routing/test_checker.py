import math
from dataclasses import replace

import pytest

from crazychoir.routing.checker import PlanError, check, require_feasible
from crazychoir.routing.instance import Instance
from crazychoir.routing.plan import Plan, Route, Stop

RAW = {
    "home": [[0.0, 0.0], [5.0, 0.0]],
    "pickup": [[1.0, 0.0], [2.0, 0.0], [6.0, 0.0]],
    "delivery": [[3.0, 0.0], [4.0, 0.0], [7.0, 0.0]],
    "load": [1.0, 2.0, 2.0],
    "capacity": [3.0, 2.0],
    "route_length_limit": 9.0,
    "capability": [[True, True, False], [True, True, True]],
}
INSTANCE = Instance.parse(RAW)
LONG = Route.from_nodes(0, [0, 1, 3, 4], 3, 8.0)
SHORT = Route.from_nodes(1, [2, 5], 3, 4.0)


def wrong(*routes, instance=INSTANCE):
    return check(instance, Plan(routes))


def test_a_good_plan_has_no_violations():
    assert wrong(LONG, SHORT) == []
    require_feasible(INSTANCE, Plan((LONG, SHORT)))
    assert Plan((LONG, SHORT)).cost == 12.0


def test_a_task_left_out_or_served_twice():
    assert wrong(LONG) == ["task 2 is served 0 times, not once"]
    twice = Route.from_nodes(1, [0, 3, 2, 5], 3, 4 + 2 + 4 + 2)
    assert "task 0 is served 2 times, not once" in wrong(LONG, twice)


def test_delivery_before_pickup():
    assert "robot 1: delivers task 2 without having it on board" in wrong(LONG, Route.from_nodes(1, [5, 2], 3, 4.0))
    assert "robot 1: comes home with task(s) 2 on board" in wrong(LONG, Route.from_nodes(1, [2], 3, 2.0))


def test_a_delivery_by_another_robot():
    routes = (Route.from_nodes(0, [0, 1, 3, 4], 3, 8.0), Route.from_nodes(1, [2], 3, 2.0))
    assert any("on board" in text for text in wrong(*routes))


def test_capacity_along_the_route():
    tight = Instance.parse(RAW | {"capacity": [2.5, 2.0]})
    assert wrong(LONG, SHORT, instance=tight) == ["robot 0: carries 3 after picking up task 1, capacity 2.5"]
    one_by_one = Route.from_nodes(0, [0, 3, 1, 4], 3, 3 + 1 + 2 + 4)
    free = Instance.parse(RAW | {"capacity": [2.5, 2.0], "route_length_limit": None})
    assert wrong(one_by_one, SHORT, instance=free) == []


def test_capability():
    deaf = Instance.parse(RAW | {"capability": [[True, True, True], [True, True, True]], "route_length_limit": None})
    route = Route.from_nodes(0, [0, 1, 3, 4, 2, 5], 3, 14.0)
    assert wrong(route, instance=deaf) == []
    assert "robot 0: is not capable of task 2" in wrong(route)


def test_length_is_flown_again():
    assert wrong(replace(LONG, length=7.9), SHORT) == ["robot 0: states a length of 7.900000 m but flies 8.000000 m"]
    assert wrong(replace(LONG, length=math.nan), SHORT)
    short = Instance.parse(RAW | {"route_length_limit": 7.99, "capability": None})
    assert wrong(LONG, SHORT, instance=short)[0] == "robot 0: flies 8.000000 m, limit 7.99 m"


def test_robots_and_tasks_that_do_not_exist():
    assert "robot 2 does not exist; there are 0 to 1" in wrong(LONG, SHORT, replace(SHORT, robot=2))
    ghost = Route(1, (Stop(9, "pickup"), Stop(9, "delivery"), *SHORT.stops), 4.0)
    assert "robot 1: task 9 does not exist" in wrong(LONG, ghost)
    odd = Route(1, (Stop(2, "pickup"), Stop(2, "drop")), 4.0)
    assert "robot 1: does 'drop' with task 2, neither pickup nor delivery" in wrong(LONG, odd)


def test_two_routes_of_one_robot():
    assert "robot 1 has two routes" in wrong(LONG, SHORT, SHORT)


def test_the_error_lists_the_violations():
    with pytest.raises(PlanError, match="task 2 is served 0 times") as caught:
        require_feasible(INSTANCE, Plan((LONG,)))
    assert caught.value.violations == ("task 2 is served 0 times, not once",)
