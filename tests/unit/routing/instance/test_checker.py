import math
from dataclasses import replace

import numpy as np

from crazychoir.routing.instance.checker import check_plan, check_team_plan
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Route, RoutePlan, Stop

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
    return check_plan(instance, RoutePlan(routes))


def test_a_good_plan_has_no_violations():
    assert wrong(LONG, SHORT) == []
    assert RoutePlan((LONG, SHORT)).cost == 12.0


def test_a_task_left_out_or_served_twice():
    assert wrong(LONG) == ["task 2 is served 0 times, not once"]
    twice = Route.from_nodes(1, [0, 3, 2, 5], 3, 4 + 2 + 4 + 2)
    assert "task 0 is served 2 times, not once" in wrong(LONG, twice)


def test_delivery_before_pickup():
    assert "robot 1: delivers task 2 without having it on board" in wrong(
        LONG, Route.from_nodes(1, [5, 2], 3, 4.0)
    )
    assert "robot 1: comes home with task(s) 2 on board" in wrong(
        LONG, Route.from_nodes(1, [2], 3, 2.0)
    )


def test_a_delivery_by_another_robot():
    routes = (
        Route.from_nodes(0, [0, 1, 3, 4], 3, 8.0),
        Route.from_nodes(1, [2], 3, 2.0),
    )
    assert any("on board" in text for text in wrong(*routes))


def test_capacity_along_the_route():
    tight = Instance.parse(RAW | {"capacity": [2.5, 2.0]})
    assert wrong(LONG, SHORT, instance=tight) == [
        "robot 0: carries 3 after picking up task 1, capacity 2.5"
    ]
    one_by_one = Route.from_nodes(0, [0, 3, 1, 4], 3, 3 + 1 + 2 + 4)
    free = Instance.parse(RAW | {"capacity": [2.5, 2.0], "route_length_limit": None})
    assert wrong(one_by_one, SHORT, instance=free) == []


def test_capability():
    deaf = Instance.parse(
        RAW
        | {
            "capability": [[True, True, True], [True, True, True]],
            "route_length_limit": None,
        }
    )
    route = Route.from_nodes(0, [0, 1, 3, 4, 2, 5], 3, 14.0)
    assert wrong(route, instance=deaf) == []
    assert "robot 0: is not capable of task 2" in wrong(route)


def test_length_is_flown_again():
    assert wrong(replace(LONG, length=7.9), SHORT) == [
        "robot 0: states a length of 7.900000 m but flies 8.000000 m"
    ]
    assert wrong(replace(LONG, length=math.nan), SHORT)
    short = Instance.parse(RAW | {"route_length_limit": 7.99, "capability": None})
    assert (
        wrong(LONG, SHORT, instance=short)[0]
        == "robot 0: flies 8.000000 m, limit 7.99 m"
    )


def test_robots_and_tasks_that_do_not_exist():
    assert "robot 2 does not exist; there are 0 to 1" in wrong(
        LONG, SHORT, replace(SHORT, robot=2)
    )
    ghost = Route(1, (Stop(9, "pickup"), Stop(9, "delivery"), *SHORT.stops), 4.0)
    assert "robot 1: task 9 does not exist" in wrong(LONG, ghost)
    odd = Route(1, (Stop(2, "pickup"), Stop(2, "drop")), 4.0)
    assert "robot 1: does 'drop' with task 2, neither pickup nor delivery" in wrong(
        LONG, odd
    )


def test_two_routes_of_one_robot():
    assert "robot 1 has two routes" in wrong(LONG, SHORT, SHORT)


def goods(**changes):
    """The instance without limit and capability, with changes."""
    return Instance.parse(
        RAW | {"route_length_limit": None, "capability": None} | changes
    )


def test_windows_services_and_releases_are_kept():
    window = {"time_windows": {"delivery": [[0, 5], None, None]}}
    late = goods(**window, release=[2.5, 0.0, 0.0], service_time={"pickup": 0.5})
    assert wrong(LONG, SHORT, instance=goods(**window, service_time=1.0)) == []
    assert wrong(LONG, SHORT, instance=late) == [
        "robot 0: begins the delivery of task 0 at 5.500000 s, its window ends at 5 s"
    ]
    early = goods(time_windows={"home": [[2, 9.5], None]})
    assert wrong(LONG, SHORT, instance=early) == [
        "robot 0: is done at 10.000000 s, its window ends at 9.5 s"
    ]


def test_the_finish_is_flown_again():
    slow = goods(speed=[0.5, 1.0], service_time=1.0)
    assert wrong(replace(LONG, finish=20.0), SHORT, instance=slow) == []
    assert wrong(replace(LONG, finish=19.0), SHORT, instance=slow) == [
        "robot 0: states to be done at 19.000000 s but is at 20.000000 s"
    ]


def test_an_initial_load_takes_room():
    assert wrong(
        LONG, SHORT, instance=goods(capacity=[3.5, 2.0], initial_load=[1.0, 0.0])
    ) == ["robot 0: carries 4 after picking up task 1, capacity 3.5"]


def test_open_tours_and_other_ends():
    assert (
        wrong(
            replace(LONG, length=4.0),
            replace(SHORT, length=2.0),
            instance=goods(open_tours=True),
        )
        == []
    )
    assert (
        wrong(replace(LONG, length=5.0), SHORT, instance=goods(end=[[5.0, 0.0], None]))
        == []
    )


def test_a_matrix_is_flown_in_its_direction():
    line = (0, 5, 1, 2, 6, 3, 4, 7)
    matrix = [[abs(a - b) + (0.5 if a > b else 0.0) for b in line] for a in line]
    assert (
        wrong(
            replace(LONG, length=8.5),
            replace(SHORT, length=4.5),
            instance=goods(distance=matrix),
        )
        == []
    )


def test_trips_have_the_limit_each_and_nothing_on_board_between():
    two = goods(route_length_limit=8.0, recharge=2, capacity=[2.0, 2.0])
    route = Route.from_nodes(0, [0, 3, 7, 1, 4], 3, 3 + 3 + 4 + 4)
    assert wrong(route, SHORT, instance=two) == []
    whole = Route.from_nodes(0, [0, 3, 1, 4, 2, 5], 3, 16.0)
    assert wrong(whole, instance=two) == ["robot 0: flies 16.000000 m, limit 8 m"]
    loaded = Route.from_nodes(0, [0, 7, 3, 1, 4], 3, 1 + 1 + 3 + 1 + 2 + 4)
    assert "robot 0: recharges with task(s) 0 on board" in wrong(
        loaded, SHORT, instance=two
    )
    many = Route.from_nodes(0, [0, 3, 7, 1, 4, 7, 2, 5], 3, 6 + 8 + 14.0)
    assert "robot 0: makes 3 trips, at most 2" in wrong(many, instance=two)


def test_refusals_cost_their_penalty():
    may = goods(penalty=[None, None, 2.5], fixed_cost=1.0)
    assert may.plan([LONG]).cost == 8.0 + 1.0 + 2.5
    assert check_plan(may, may.plan([LONG])) == []
    assert check_plan(may, RoutePlan((LONG,), fixed_cost=1.0)) == [
        "the plan states a cost of 9.000000 but costs 11.500000"
    ]
    assert check_plan(goods(penalty=[None, 1.0, None]), RoutePlan((LONG,))) == [
        "task 2 is served 0 times, not once"
    ]


def test_the_makespan_is_that_of_the_last():
    last = goods(objective=["makespan", "total"], speed=[1.0, 0.25])
    plan = last.plan([replace(LONG, finish=8.0), replace(SHORT, finish=16.0)])
    assert plan.values == (16.0, 12.0)
    assert check_plan(last, plan) == []
    assert RoutePlan.from_json(plan.to_json()) == plan


def test_in_flight_a_robot_begins_where_it_is_and_delivers_what_it_carries():
    team = [INSTANCE.local(0), INSTANCE.local(1)]
    team[1] = replace(
        team[1],
        start=np.array([6.0, 0.0]),
        start_time=4.0,
        left=3.5,
        aboard=np.array([False, False, True]),
    )
    route = Route.from_nodes(1, [5], 3, 3.0, 4.0 + 3.0)
    assert check_team_plan(team, RoutePlan((LONG, route))) == []
    assert check_team_plan(
        [team[0], replace(team[1], left=2.5)], RoutePlan((LONG, route))
    ) == ["robot 1: flies 3.000000 m, limit 2.5 m"]
    empty = [team[0], INSTANCE.local(1)]
    assert "robot 1: delivers task 2 without having it on board" in check_team_plan(
        empty, RoutePlan((LONG, route))
    )
