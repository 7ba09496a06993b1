"""What may stand in [mission_options] and in the `options` of drones: everything else is refused by name."""

import pytest

from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.mission import check_before_flight, load_mission

FORMATIONS = ("bearing_formation", "containment", "distance_formation")
MISSIONS = (
    *FORMATIONS,
    "aggregative",
    "mpc",
    "targets",
    "goto",
    "head_on",
    "drawn_path",
    "crossing",
    "integrators",
    "unicycles",
)


def refused(name, said, **changes):
    """Whether the mission's own swarm with these changes is refused in these words."""
    mission = load_mission(name)
    with pytest.raises(ConfigError, match=said):
        check_before_flight(mission, mission.swarm(None).replace(**changes))


@pytest.mark.parametrize("name", MISSIONS)
def test_the_missions_own_swarms_may_fly(name):
    mission = load_mission(name)
    check_before_flight(mission, mission.swarm(None))


@pytest.mark.parametrize("name", MISSIONS)
def test_a_key_that_there_is_not_is_named(name):
    refused(
        name,
        r"mission_options\.bogus = 1: there is no such key",
        mission_options={"bogus": 1},
    )


@pytest.mark.parametrize("name", MISSIONS)
def test_an_option_of_a_drone_that_there_is_not_is_named(name):
    drones = [
        {"id": d.id, "home": d.home, "leader": d.leader, "uri": d.uri}
        for d in load_mission(name).swarm(None).drones
    ]
    drones[-1]["options"] = {"hight": 1.0}
    refused(
        name,
        rf"drone {drones[-1]['id']}: options\.hight = 1.0: there is no such key",
        drones=drones,
    )


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
        (
            "bearing_formation",
            "shape",
            {"0": [0.0, 0.0, 1.0]},
            "one for each drone, 0 to 3",
        ),
        ("bearing_formation", "scatter", [1.0, 1.0], "three lengths"),
        ("containment", "leaders", "square", '"still", "circle" or "drawn"'),
        ("containment", "edges", "some", '"static" or "random"'),
        ("containment", "share", 0.0, "a share, above 0"),
        ("containment", "kp", -1, "a gain, above 0"),
        ("containment", "laps", 0, "a number of laps"),
        ("distance_formation", "k", "stiff", "a gain, above 0"),
        ("distance_formation", "kv", 0.0, "a gain, above 0"),
        ("distance_formation", "kv", -1.2, "a gain, above 0"),
        ("distance_formation", "begin", -1, "0 to 600"),
        ("aggregative", "legs", -1, "a number of legs, 1 to 100"),
        ("aggregative", "leg", 0, "a time in s, above 0"),
        ("aggregative", "step_size", -1, "a share"),
        ("aggregative", "round_rate", True, "a rate in Hz"),
        (
            "aggregative",
            "weights",
            [0, 0, 1],
            "intruder \\+ target above 0 and intruder \\+ team above 0",
        ),
        (
            "aggregative",
            "weights",
            [0, 1, 0],
            "intruder \\+ target above 0 and intruder \\+ team above 0",
        ),
        ("aggregative", "weights", [-1, 2, 2], "each 0 to 1000"),
        ("aggregative", "target", [1e9, 0.0], "within 1000 m"),
        ("mpc", "horizon", 100_000, "3 steps or more, to start and to stop, to 50"),
        ("mpc", "step", 0.001, "a time in s, 0.1 to 2"),
        ("mpc", "speed", 0, "a speed in m/s, above 0"),
        ("mpc", "jerk", "soft", "a jerk in m/s3"),
        ("mpc", "reach", 0.05, "more than 0.05"),
        ("targets", "targets", [], "one place"),
        ("targets", "targets", [[0.0, 1.0]], "one place"),
        ("goto", "goals", {}, "one row"),
        ("goto", "goals", {"0": []}, "one row"),
        ("goto", "goals", {"0": [[5.0, 0.0, 1.0]]}, "one row"),
        ("goto", "goals", {"zero": [[5.0, 0.0, 1.0, 1.0]]}, "one row"),
        ("goto", "goals", {"0": [[5.0, 0.0, 1.0, 1.0]]}, "one for each drone, 0 to 3"),
        ("head_on", "goals", {"0": [[-5.0, 0.0, 1.0, 1.0]]}, "above 0"),
        ("drawn_path", "timing", "odd", '"even" or "drawn"'),
        ("drawn_path", "yaw", "across", 'or "along"'),
        ("drawn_path", "lift", -0.1, "a length in m, 0 to 10"),
        ("drawn_path", "scale", 0, "a factor"),
        ("crossing", "pattern", "around", '"antipodal"'),
        ("crossing", "speed", 0, "a speed in m/s, above 0"),
        ("crossing", "radius", "x", "a length in m"),
        ("crossing", "low", 2.5, "at most high = 2.2"),
    ],
)
def test_a_value_that_is_not_allowed_is_named_with_what_is(name, key, value, allowed):
    refused(name, rf"mission_options\.{key}.*{allowed}", mission_options={key: value})


@pytest.mark.parametrize(
    ("key", "value"), [("speed", "fast"), ("speed", 0), ("goal", [1.0, 2.0, 3.0])]
)
def test_the_options_of_a_drone_of_mpc_are_checked(key, value):
    drones = [{"id": 0, "home": [0, 0, 0], "options": {key: value}}]
    refused(
        "mpc",
        rf"drone 0: options\.{key}: found .*; allowed: a (speed|place)",
        drones=drones,
        graph="empty",
    )


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("bogus", 1, "there is no such key"),
        ("figure", "nine", '"circle" or "eight"'),
        ("size", 0, "a length in m"),
        ("laps", 1e9, "a number of laps"),
        ("period", "short", "a time in s"),
        ("yaw", True, 'or "along"'),
    ],
)
def test_the_options_of_a_figure_are_checked(key, value, allowed):
    mission, config = load_mission("figure"), load_mission("drawn_path").swarm(None)
    with pytest.raises(ConfigError, match=rf"mission_options\.{key}.*{allowed}"):
        mission.check(config.replace(mission="figure", mission_options={key: value}))


def test_integrators_without_leaders_are_refused_by_name():
    mission = load_mission("integrators")
    robots = [
        {"id": r.id, "home": r.home, "uri": r.uri} for r in mission.swarm(None).drones
    ]
    with pytest.raises(Refused, match=r"drones \[0, 1, 2, 3, 4, 5\] hear no leader"):
        check_before_flight(mission, mission.swarm(None).replace(drones=robots))


def test_a_drones_height_is_a_height():
    drones = [
        {"id": i, "home": [i, 0, 0], "options": {"height": "high"}} for i in range(4)
    ]
    refused(
        "bearing_formation",
        r"drone 0: options\.height: found \"high\"; allowed: a height",
        drones=drones,
    )
