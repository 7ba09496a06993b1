import json
import math
import pickle
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.errors import ConfigError, InstanceError
from crazychoir.routing.distributed.plain_loop import solve_in_loop
from crazychoir.routing.instance.fields import INSTANCE_KEYS
from crazychoir.routing.instance.generate import random_instance
from crazychoir.routing.instance.instance import Instance

GOOD = {
    "home": [[0.0, 0.0], [4.0, 0.0]],
    "pickup": [[1.0, 0.0], [3.0, 0.0], [2.0, 1.0]],
    "delivery": [[1.0, 1.0], [3.0, 1.0], [2.0, 2.0]],
    "load": [1, 2.0, 3.0],
    "capacity": [3.0, 3.0],
}


def with_change(**changes):
    return json.loads(json.dumps(GOOD | changes))


def test_every_data_file_loads(reference_data):
    files = sorted(reference_data("pdvrp").glob("*.json"))
    assert len(files) >= 7
    for path in files:
        raw = json.loads(path.read_text())
        instance = Instance.load(path)
        assert (instance.robots, len(instance.tasks)) == (
            len(raw["home"]),
            len(raw["load"]),
        )


def test_defaults_are_no_limit_and_everybody_capable():
    instance = Instance.parse(GOOD)
    assert instance.route_length_limit == math.inf
    assert instance.capability.all()


def test_json_round_trip_keeps_everything():
    capability = [[True, False, True], [True, True, True]]
    instance = Instance.parse(
        with_change(capability=capability, route_length_limit=20.0)
    )
    again = Instance.parse(json.loads(json.dumps(instance.to_json())))
    assert again.to_json() == instance.to_json()
    assert again.capability.tolist() == capability


EVERYTHING = {
    "end": [None, [1.0, 2.0]],
    "speed": [0.5, 2.0],
    "service_time": {"pickup": 1.0, "delivery": [0.0, 2.0, 3.0]},
    "time_windows": {"pickup": [None, [2, 50], [7, None]], "home": [[1, 90], None]},
    "release": [3.0, 0.0, 5.0],
    "initial_load": [0.0, 1.5],
    "penalty": [None, 4.0, 6.0],
    "priority": [0, 0, 1],
    "objective": ["makespan", "total"],
    "recharge": 2,
    "fixed_cost": 3.0,
    "route_length_limit": 30.0,
}


@pytest.mark.parametrize(
    "change", [EVERYTHING, {"open_tours": True}, {"distance": [[[1.0] * 8] * 8] * 2}]
)
def test_json_round_trip_keeps_what_is_optional(change):
    instance = Instance.parse(with_change(**change))
    again = Instance.parse(json.loads(json.dumps(instance.to_json())))
    assert again.to_json() == instance.to_json()
    for i in range(2):
        one, two = (
            {**vars(vehicle), "ways": vehicle.distance, "times": vehicle.duration}
            for vehicle in (instance.local(i).vehicle, again.local(i).vehicle)
        )
        assert all(np.array_equal(value, two[name]) for name, value in one.items())


def test_a_vehicle_has_the_fields_of_its_robot():
    v = Instance.parse(with_change(**EVERYTHING)).local(1).vehicle
    at = [(1, 0), (3, 0), (2, 1), (1, 1), (3, 1), (2, 2), (4, 0), (1, 2)]
    np.testing.assert_allclose(v.distance, [[math.dist(a, b) for b in at] for a in at])
    np.testing.assert_allclose(
        v.duration, v.distance / 2.0 + np.array([[1, 1, 1, 0, 2, 3, 0, 0]]).T
    )
    assert v.earliest.tolist() == [3, 2, 7, 0, 0, 0, 0, 0]
    assert v.latest.tolist() == [math.inf, 50, math.inf, *[math.inf] * 5]
    assert (v.capacity, v.limit, v.limit_again, v.fixed, v.trips, v.robot) == (
        1.5,
        30.0,
        30.0,
        3.0,
        2,
        1,
    )


def test_a_route_waits_for_windows_and_serves():
    v = Instance.parse(with_change(**EVERYTHING)).local(1).vehicle
    assert v.length([0, 3]) == pytest.approx(3 + 1 + 1)
    assert v.finish([0, 3]) == pytest.approx(
        3 + 1 + 0.5 + 0 + 0.5
    )  # waits at the pickup until 3 s
    assert v.finish([]) == 0.0


def test_in_flight_a_robot_begins_where_it_is_with_what_it_carries():
    local = replace(
        Instance.parse(GOOD).local(0),
        start=np.array([1.0, 1.0]),
        start_time=5.0,
        left=7.0,
        aboard=np.array([False, True, False]),
    )
    v = local.vehicle
    assert v.length([4]) == pytest.approx(2 + math.hypot(3, 1))
    assert v.finish([4]) == pytest.approx(5 + 2 + math.hypot(3, 1))
    assert v.fixed == pytest.approx(-math.hypot(1, 1))
    assert (v.limit, v.limit_again) == (7.0, math.inf)
    assert v.aboard.tolist() == [False, True, False]


def test_a_matrix_has_rows_of_homes_pickups_deliveries_and_any_direction():
    matrix = np.arange(64.0).reshape(8, 8)
    v = Instance.parse(with_change(distance=matrix.tolist())).local(1).vehicle
    nodes = [2, 3, 4, 5, 6, 7, 1, 1]
    np.testing.assert_array_equal(v.distance, matrix[np.ix_(nodes, nodes)])


def test_an_open_tour_ends_for_nothing():
    v = Instance.parse(with_change(open_tours=True)).local(0).vehicle
    assert v.length([0, 3]) == pytest.approx(2.0)


def test_one_task_of_a_higher_priority_outweighs_all_below():
    tasks = Instance.parse(
        with_change(penalty=[1.0, 2.0, None], priority=[1, 0, 5])
    ).tasks
    assert tasks.refusal[2] == math.inf
    assert tasks.refusal[1] == 2.0
    assert tasks.refusal[0] > tasks.span + 2.0
    equal = Instance.parse(
        with_change(penalty=[1.0, 2.0, 1.5], priority=[1, 2, 1])
    ).tasks.refusal
    assert equal[1] > equal[0] + equal[2]


def test_more_priorities_than_a_number_holds_are_refused():
    many = {key: GOOD[key][:1] * 40 for key in ("pickup", "delivery", "load")}
    with pytest.raises(InstanceError, match="priority: found 40 levels over 40 tasks"):
        Instance.parse(
            with_change(**many, penalty=[1.0] * 40, priority=list(range(40)))
        )


def test_identical_robots_are_of_one_kind():
    raw = with_change(
        home=[[0.0, 0.0], [4.0, 0.0], [0.0, 0.0]], capacity=[3.0, 3.0, 3.0]
    )
    assert Instance.parse(raw).kinds() == [(0, 2), (1,)]
    assert Instance.parse(raw | {"speed": [1.0, 1.0, 2.0]}).kinds() == [
        (0,),
        (1,),
        (2,),
    ]


def test_a_task_that_no_robot_can_serve_may_be_refused():
    instance = Instance.parse(
        with_change(route_length_limit=5.0, penalty=[None, None, 3.0])
    )
    assert all(2 not in instance.local(i).vehicle.servable for i in range(2))
    solution = solve_in_loop(instance, {0: [1], 1: [0]})
    assert sorted(j for route in solution.routes for j in route.tasks) == [0, 1]
    assert solution.cost == pytest.approx(
        sum(route.length for route in solution.routes) + 3.0
    )


def test_a_robot_sees_its_own_part_and_the_public_goods():
    instance = Instance.parse(
        with_change(
            capability=[[True, True, False], [True, True, True]], capacity=[3.0, 5.0]
        )
    )
    local = instance.local(0)
    assert (local.robot, local.robots, local.capacity) == (0, 2, 3.0)
    assert local.home.tolist() == [0.0, 0.0]
    assert local.servable.tolist() == [0, 1]
    assert not any(
        other is value
        for value in vars(local).values()
        for other in (instance.home, instance.capacity)
    )


def test_distances_are_euclidean_in_three_dimensions():
    raw = with_change(
        home=[[0, 0, 0]],
        pickup=[[1, 2, 2]],
        delivery=[[1, 2, 5]],
        load=[1],
        capacity=[1],
    )
    distance = Instance.parse(raw).local(0).vehicle.distance
    np.testing.assert_allclose(
        distance[:3, :3], [[0, 3, 3], [3, 0, 30**0.5], [3, 30**0.5, 0]]
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"capability": [[True, True, False]] * 2},
            "task 2: found no robot that is capable of it; allowed: at least one. Look at column 2 of capability.",
        ),
        (
            {"capacity": [2.0, 2.5]},
            "task 2: found load 3; allowed: at most 2.5, the largest capacity of the robots",
        ),
        (
            {"capacity": [2.0, 9.0], "capability": [[True] * 3, [True, True, False]]},
            "task 2: found load 3; allowed: at most 2, the largest capacity of the robots capable of it. Look at load[2]",  # noqa: E501
        ),
        (
            {"route_length_limit": 5.0},
            "a tour of 6.0645 m for it alone, by robot 0, the shortest of the robots that can",
        ),
        (
            {"route_length_limit": 5.0},
            "allowed: at most 5 m, the route_length_limit. Look at route_length_limit, home",
        ),
    ],
)
def test_an_unservable_task_is_refused_and_the_limit_is_named(change, said):
    with pytest.raises(InstanceError) as error:
        Instance.parse(with_change(**change))
    assert said in str(error.value)


BAD = [
    ({"home": [[0.0, 0.0], [4.0]]}, "home[1]"),
    ({"home": [[0.0, 0.0], [4.0, 0.0, 1.0]]}, "home[1]"),
    ({"home": [[0.0], [4.0]]}, "home[0]"),
    ({"home": "here"}, "home"),
    ({"home": []}, "home"),
    ({"pickup": [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.0, 1.0, 0.0]]}, "pickup[0]"),
    ({"pickup": [[1.0, 0.0], [3.0, 0.0]]}, "pickup"),
    ({"pickup": [[1.0, 0.0], [3.0, None], [2.0, 1.0]]}, "pickup[1][1]"),
    ({"delivery": [[1.0, 1.0], [3.0, 1.0], [2.0, float("nan")]]}, "delivery[2][1]"),
    ({"load": [1.0, -2.0, 3.0]}, "load[1]"),
    ({"load": [1.0, True, 3.0]}, "load[1]"),
    ({"load": [1.0, 10**400, 3.0]}, "load[1]"),
    ({"load": [1.0, 2.0]}, "pickup"),
    ({"capacity": [3.0]}, "capacity"),
    ({"capacity": [3.0, float("inf")]}, "capacity[1]"),
    ({"route_length_limit": -1.0}, "route_length_limit"),
    ({"route_length_limit": "far"}, "route_length_limit"),
    ({"capability": [[True, True, True]]}, "capability"),
    ({"capability": [[True, True], [True, True, True]]}, "capability[0]"),
    ({"capability": [[True, True, 1], [True, True, True]]}, "capability[0][2]"),
    ({"capabilities": []}, "capabilities"),
    ({"N": 3}, "N"),
    ({"M": 2}, "M"),
    ({"capability": [[True, True, False], [True, True, False]]}, "task 2"),
    ({"capacity": [2.0, 2.5]}, "task 2"),
    ({"route_length_limit": 5.0}, "task 2"),
    ({"end": [[0.0, 0.0]]}, "end"),
    ({"end": [None, [0.0]]}, "end[1]"),
    ({"end": [None, None], "open_tours": True}, "end"),
    ({"end": [None, None], "distance": [[1.0] * 8] * 8}, "end"),
    ({"open_tours": 1}, "open_tours"),
    ({"distance": [[1.0] * 8] * 7}, "distance"),
    ({"distance": [[1.0] * 8] * 7 + [[1.0] * 7]}, "distance[7]"),
    ({"distance": [[1.0] * 8] * 7 + [[1.0] * 7 + [-1.0]]}, "distance[7][7]"),
    ({"distance": [[[1.0] * 8] * 8] * 3}, "distance"),
    (
        {"distance": [[[1.0] * 8] * 8, [[1.0] * 8] * 7 + [[1.0] * 7 + [None]]]},
        "distance[1][7][7]",
    ),
    ({"distance": "near"}, "distance"),
    ({"speed": 0.0}, "speed"),
    ({"speed": [1.0]}, "speed"),
    ({"speed": [1.0, -1.0]}, "speed[1]"),
    ({"service_time": [1.0]}, "service_time"),
    ({"service_time": {"pickup": [1.0, 2.0]}}, "service_time.pickup"),
    ({"service_time": {"delivery": [1.0, 2.0, -3.0]}}, "service_time.delivery[2]"),
    ({"service_time": {"dropoff": 1.0}}, "service_time.dropoff"),
    ({"time_windows": [[0, 1]]}, "time_windows"),
    ({"time_windows": {"stops": []}}, "time_windows.stops"),
    ({"time_windows": {"pickup": [[0, 1]]}}, "time_windows.pickup"),
    ({"time_windows": {"home": [[0, 1], 3]}}, "time_windows.home[1]"),
    ({"time_windows": {"pickup": [None, [3, 2], None]}}, "time_windows.pickup[1]"),
    ({"time_windows": {"pickup": [None, [3, 2e7], None]}}, "time_windows.pickup[1][1]"),
    ({"load": [1.0, "2.0", 3.0]}, "load[1]"),
    (
        {"time_windows": {"pickup": [None, [None, 2], None]}},
        "time_windows.pickup[1][0]",
    ),
    ({"time_windows": {"pickup": [None, None, [0, 1]]}}, "task 2"),
    ({"time_windows": {"delivery": [None, [0, 1.5], None]}}, "task 1"),
    ({"time_windows": {"home": [[0, 3], [0, 3]]}}, "task 0"),
    ({"release": [1.0, 2.0]}, "release"),
    (
        {
            "release": [9.0, 0.0, 0.0],
            "time_windows": {"delivery": [[0, 9], None, None]},
        },
        "task 0",
    ),
    ({"initial_load": [0.0, 3.5]}, "initial_load[1]"),
    ({"initial_load": [1.0, 0.5]}, "task 2"),
    ({"penalty": [1.0]}, "penalty"),
    ({"penalty": [1.0, None, -2.0]}, "penalty[2]"),
    ({"priority": [1, 2]}, "priority"),
    ({"priority": [1, 2, 0.5]}, "priority[2]"),
    ({"objective": "cost"}, "objective"),
    ({"objective": ["total", "total"]}, "objective"),
    ({"objective": 3}, "objective"),
    ({"recharge": 0}, "recharge"),
    ({"recharge": 1.5}, "recharge"),
    ({"recharge": 2, "open_tours": True}, "recharge"),
    ({"fixed_cost": -1.0}, "fixed_cost"),
]


@pytest.mark.parametrize(
    ("change", "key"), BAD, ids=[f"{key}-{n}" for n, (_, key) in enumerate(BAD)]
)
def test_what_is_wrong_is_named(change, key):
    with pytest.raises(InstanceError) as caught:
        Instance.parse({**GOOD, **change}, "goods.json")
    assert str(caught.value).startswith(f"goods.json: {key}: found ")
    assert "allowed: " in str(caught.value)
    assert caught.value.do


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"time_windows": {"pickup": [[9, 3], None, None]}},
            "[9, 3]; allowed: [from, to] with to not before from",
        ),
        (
            {"load": ["1", 2.0, 3.0]},
            'load[0]: found "1"; allowed: a number. Write a number, without quotes.',
        ),
        ({"load": [None, 2.0, 3.0]}, "load[0]: found null; allowed: a number."),
    ],
)
def test_what_was_found_is_shown_as_it_is_written(change, said):
    with pytest.raises(InstanceError) as caught:
        Instance.parse({**GOOD, **change}, "goods.json")
    assert said in str(caught.value)


@pytest.mark.parametrize("key", ["home", "pickup", "delivery", "load", "capacity"])
def test_a_missing_key_is_named(key):
    raw = {k: v for k, v in GOOD.items() if k != key}
    with pytest.raises(InstanceError, match=rf"goods\.json: {key}: found nothing"):
        Instance.parse(raw, "goods.json")


def test_annotations_are_accepted_and_an_unknown_key_lists_them():
    Instance.parse(
        with_change(
            optimum=1.0, seed=3, assignment=[], status="x", cost="y", N=2, M=3, note="n"
        )
    )
    with pytest.raises(
        InstanceError, match=r"capability, .*fixed_cost; as annotations N, M, name"
    ):
        Instance.parse(with_change(limit=3))


@pytest.mark.parametrize(
    "text", ["[]", "{", "", "1", '{"load": [1], "load": [2]}', '{"a": 1e999}']
)
def test_a_file_that_is_no_instance(tmp_path, text):
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(InstanceError, match=r"bad\.json"):
        Instance.load(path)


def test_a_swarm_file_is_no_instance(tmp_path):
    path = tmp_path / "swarm.toml"
    path.write_text("home = [[0, 0]]\n")
    with pytest.raises(
        InstanceError,
        match=r"swarm\.toml: found no JSON .*lab6\.json is an instance .*TOML",
    ):
        Instance.load(path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.json"):
        Instance.load(tmp_path / "none.json")


values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-3, 3) | st.text(max_size=2),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=2), inner, max_size=2)
    ),
    max_leaves=8,
)


@given(st.sampled_from([*GOOD, *INSTANCE_KEYS.optional, "N"]), values)
def test_any_value_of_a_key_loads_or_is_refused(key, value):
    with suppress(InstanceError):
        instance = Instance.parse({**GOOD, key: value})
        assert np.isfinite(instance.home).all()


@given(
    st.lists(
        st.tuples(st.sampled_from([0.0, 1.0, 7.5, 300.0]), st.integers(0, 3)),
        min_size=3,
        max_size=3,
    )
)
def test_plans_are_compared_by_refusals_of_each_priority_then_by_cost(rows):
    penalty, priority = zip(*rows, strict=True)
    tasks = Instance.parse(
        with_change(penalty=list(penalty), priority=list(priority))
    ).tasks
    plans = []
    for refused in ([], [0], [1], [2], [0, 1], [0, 2], [1, 2], [0, 1, 2]):
        for flown in (0.0, 20.0, tasks.span):
            counts = [sum(priority[j] == p for j in refused) for p in (3, 2, 1)]
            ranked = (*counts, flown + sum(penalty[j] for j in refused))
            plans.append((ranked, flown + sum(tasks.refusal[j] for j in refused)))
    plans.sort()
    assert all(a[1] <= b[1] + 1e-9 * b[1] for a, b in pairwise(plans))


def test_an_instance_and_a_problem_go_to_another_process_after_their_use():
    local = random_instance(2, 3, seed=0).local(0)
    duration = local.vehicle.duration
    copy = pickle.loads(pickle.dumps(local))  # noqa: S301 - its own bytes
    assert copy.vehicle.duration.tolist() == duration.tolist()
