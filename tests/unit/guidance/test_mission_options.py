"""What may stand in [mission_options] and in the `options` of drones: everything else is refused by name."""

import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import load, look_before

FORMATIONS = ("bearing_formation", "containment", "distance_formation")
MISSIONS = FORMATIONS


def refused(name, said, **changes):
    """Whether the mission's own swarm with these changes is refused in these words."""
    mission = load(name)
    with pytest.raises(ConfigError, match=said):
        look_before(mission, mission.swarm(None).replace(**changes))


@pytest.mark.parametrize("name", MISSIONS)
def test_the_missions_own_swarms_may_fly(name):
    mission = load(name)
    look_before(mission, mission.swarm(None))


@pytest.mark.parametrize("name", MISSIONS)
def test_a_key_that_there_is_not_is_named(name):
    refused(name, r"mission_options\.bogus = 1: there is no such key", mission_options={"bogus": 1})


@pytest.mark.parametrize("name", MISSIONS)
def test_an_option_of_a_drone_that_there_is_not_is_named(name):
    drones = [{"id": d.id, "home": d.home, "leader": d.leader, "uri": d.uri} for d in load(name).swarm(None).drones]
    drones[-1]["options"] = {"hight": 1.0}
    refused(name, rf"drone {drones[-1]['id']}: options\.hight = 1.0: there is no such key", drones=drones)


@pytest.mark.parametrize(
    ("name", "key", "value", "allowed"),
    [
        ("bearing_formation", "lwa", "paper", "Did you mean law"),
        ("bearing_formation", "law", "papr", '"normalised" or "paper"'),
        ("bearing_formation", "kp", "fast", "a gain, above 0"),
        ("bearing_formation", "kp", -1, "a gain, above 0"),
        ("bearing_formation", "kv", 0, "a gain, above 0"),
        ("bearing_formation", "in_height", 2.0, "a share"),
        ("bearing_formation", "duration", -1, "a time in s, above 0"),
        ("bearing_formation", "radius", "x", "a length in m"),
        ("bearing_formation", "letter", "Q", '"S" or "C"'),
        ("bearing_formation", "letter", "S", "one for each drone, 0 to 3"),
        ("bearing_formation", "shape", {"0": [0.0, 0.0]}, "drone ids and places"),
        ("bearing_formation", "shape", {"0": [0.0, 0.0, 1.0]}, "one for each drone, 0 to 3"),
        ("bearing_formation", "scatter", [1.0, 1.0], "three lengths"),
        ("containment", "leaders", "square", '"still", "circle" or "drawn"'),
        ("containment", "edges", "some", '"static" or "random"'),
        ("containment", "share", 0.0, "a share, above 0"),
        ("containment", "kp", -1, "a gain, above 0"),
        ("containment", "laps", 0, "a number of laps"),
        ("distance_formation", "k", "stiff", "a gain, above 0"),
        ("distance_formation", "begin", -1, "0 to 600"),
    ],
)
def test_a_value_that_is_not_allowed_is_named_with_what_is(name, key, value, allowed):
    refused(name, rf"mission_options\.{key}.*{allowed}", mission_options={key: value})


def test_a_drones_height_is_a_height():
    drones = [{"id": i, "home": [i, 0, 0], "options": {"height": "high"}} for i in range(4)]
    refused("bearing_formation", r"drone 0: options\.height: found \"high\"; allowed: a height", drones=drones)
