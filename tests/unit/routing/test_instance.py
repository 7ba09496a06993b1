import json
import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.errors import ConfigError, InstanceError
from crazychoir.routing.instance import Instance

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
        assert (instance.robots, len(instance.tasks)) == (len(raw["home"]), len(raw["load"]))


def test_defaults_are_no_limit_and_everybody_capable():
    instance = Instance.parse(GOOD)
    assert instance.route_length_limit == math.inf
    assert instance.capability.all()


def test_json_round_trip_keeps_everything():
    capability = [[True, False, True], [True, True, True]]
    instance = Instance.parse(with_change(capability=capability, route_length_limit=20.0))
    again = Instance.parse(json.loads(json.dumps(instance.to_json())))
    assert again.to_json() == instance.to_json()
    assert again.capability.tolist() == capability


def test_a_robot_sees_its_own_part_and_the_public_goods():
    instance = Instance.parse(with_change(capability=[[True, True, False], [True, True, True]], capacity=[3.0, 5.0]))
    local = instance.local(0)
    assert (local.robot, local.robots, local.capacity) == (0, 2, 3.0)
    assert local.home.tolist() == [0.0, 0.0]
    assert local.servable.tolist() == [0, 1]
    assert not any(other is value for value in vars(local).values() for other in (instance.home, instance.capacity))


def test_distances_are_euclidean_in_three_dimensions():
    raw = with_change(home=[[0, 0, 0]], pickup=[[1, 2, 2]], delivery=[[1, 2, 5]], load=[1], capacity=[1])
    np.testing.assert_allclose(Instance.parse(raw).local(0).distance, [[0, 3, 3], [3, 0, 30**0.5], [3, 30**0.5, 0]])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"capability": [[True, True, False]] * 2},
         "task 2: found no robot that is capable of it; allowed: at least one. Look at column 2 of capability."),
        ({"capacity": [2.0, 2.5]}, "task 2: found load 3; allowed: at most 2.5, the largest capacity of the robots"),
        ({"capacity": [2.0, 9.0], "capability": [[True] * 3, [True, True, False]]},
         "task 2: found load 3; allowed: at most 2, the largest capacity of the robots capable of it. Look at load[2]"),
        ({"route_length_limit": 5.0}, "a tour of 6.0645 m for it alone, by robot 0, the shortest of those that can"),
        ({"route_length_limit": 5.0}, "allowed: at most 5 m, the route_length_limit. Look at route_length_limit, home"),
    ],
)  # fmt: skip
def test_a_task_that_nobody_can_serve_names_the_limit(change, said):
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
]


@pytest.mark.parametrize(("change", "key"), BAD, ids=[f"{key}-{n}" for n, (_, key) in enumerate(BAD)])
def test_what_is_wrong_is_named(change, key):
    with pytest.raises(InstanceError) as caught:
        Instance.parse({**GOOD, **change}, "goods.json")
    assert str(caught.value).startswith(f"goods.json: {key}: found ")
    assert "allowed: " in str(caught.value)
    assert caught.value.do


@pytest.mark.parametrize("key", ["home", "pickup", "delivery", "load", "capacity"])
def test_a_missing_key_is_named(key):
    raw = {k: v for k, v in GOOD.items() if k != key}
    with pytest.raises(InstanceError, match=rf"goods\.json: {key}: found nothing"):
        Instance.parse(raw, "goods.json")


def test_annotations_are_accepted_and_an_unknown_key_lists_them():
    Instance.parse(with_change(optimum=1.0, seed=3, assignment=[], status="x", cost="y", N=2, M=3, note="n"))
    with pytest.raises(InstanceError, match="route_length_limit, capability; as annotations N, M, name"):
        Instance.parse(with_change(limit=3))


@pytest.mark.parametrize("text", ["[]", "{", "", "1", '{"load": [1], "load": [2]}', '{"a": 1e999}'])
def test_a_file_that_is_no_instance(tmp_path, text):
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(InstanceError, match=r"bad\.json"):
        Instance.load(path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.json"):
        Instance.load(tmp_path / "none.json")


values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-3, 3) | st.text(max_size=2),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=2), inner, max_size=2),
    max_leaves=8,
)


@given(st.sampled_from([*GOOD, "route_length_limit", "capability", "N"]), values)
def test_any_value_of_a_key_loads_or_is_refused(key, value):
    with suppress(InstanceError):
        instance = Instance.parse({**GOOD, key: value})
        assert np.isfinite(instance.home).all()
