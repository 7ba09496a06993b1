"""The mission of pickup and delivery: what is refused before a drone flies, what is flown, and what is a success."""

import json

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.delivery.pickup_delivery import PDVRPGuidance
from crazychoir.guidance.member import Member
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Route, Stop

MISSION = load_mission("pickup_delivery")
BRISK = {
    "takeoff_height": 0.5,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.8,
}
RAW = {
    "home": [[0.0, 0.0], [0.0, 2.0]],
    "pickup": [[1.0, 0.0], [-1.0, 0.0]],
    "delivery": [[1.5, 0.0], [-1.5, 0.0]],
    "load": [1.0, 1.0],
    "capacity": [1.0, 1.0],
}
SPACE = {
    "home": [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
    "pickup": [[1.0, 0.0, 0.5], [-1.0, 0.0, 0.5]],
    "delivery": [[1.5, 0.0, 0.5], [-1.5, 0.0, 0.5]],
}


@pytest.fixture
def swarm(tmp_path):
    """The mission's own swarm for RAW with these changes and options."""

    def make(more=(), **options):
        file = tmp_path / "instance.json"
        file.write_text(json.dumps(RAW | dict(more)))
        return MISSION.swarm(None, file).replace(
            flight=BRISK, mission_options={"instance": str(file), **options}
        )

    return make


@pytest.mark.parametrize(
    "more",
    [
        {},
        SPACE,
        {"end": [[2.0, 1.0], None]},
        {"recharge": 2, "route_length_limit": 3.5},
        {"service_time": 2.0},
        {"penalty": [2.0, None]},
        {"fixed_cost": 1.0},
    ],
)
def test_what_is_flown_passes(swarm, more):
    assert MISSION.check(swarm(more)) == []


def test_a_budget_of_work_ends_the_search_of_the_mission(swarm):
    config = swarm(planning_work=0)
    assert MISSION.check(config) == []
    result = fly_fast(config, MISSION)
    assert result["success"]
    assert {own["ended_by"] for own in result["results"].values()} == {"work"}


def test_a_mission_without_tasks_succeeds_on_the_ground(swarm):
    config = swarm({"pickup": [], "delivery": [], "load": []})
    assert MISSION.check(config) == []
    result = fly_fast(config, MISSION)
    assert (result["success"], result["cost"]) == (True, 0.0)
    assert [own["served"] for own in result["results"].values()] == [[], []]


WINDOWS = {"pickup": [[60.0, 90.0], None], "delivery": [None, None]}
SOME = {"penalty": [2.0, None]}


@pytest.mark.parametrize(
    ("more", "options", "said"),
    [
        (
            {},
            {"service_time": "x"},
            r'mission_options\.service_time: found "x"; allowed: a time in s',
        ),
        ({}, {"service_time": -1}, r"mission_options\.service_time: found -1"),
        (
            {},
            {"method": "magic"},
            r'mission_options\.method: found "magic"; allowed: columns, .*auction',
        ),
        (
            {},
            {"methd": "columns"},
            r"mission_options\.methd = .*no such key.*Did you mean method",
        ),
        (SOME, {"method": "resource"}, r"method resource: found a finite penalty"),
        ({}, {"method": "cbba", "planning_work": 9}, r"^work: found a budget"),
        (
            {"pickup": [[50.0, 0.0], [-1.0, 0.0]]},
            {},
            r"instance: pickup\[0\] = .*: outside the fence",
        ),
        (
            {"delivery": [[1.5, 0.0], [-1.5, 9.0]]},
            {},
            r"instance: delivery\[1\] = .*: outside the fence",
        ),
        (
            SPACE | {"pickup": [[1.0, 0.0, 5.0], [0.0, 1.0, 1.0]]},
            {},
            r"pickup\[0\] = .*a height of 5 m, not 0.1 to 2.995",
        ),
        (
            SPACE | {"delivery": [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]]},
            {},
            r"delivery\[0\] = .*at a height of 0 m",
        ),
        ({"end": [None, [0.0, 9.0]]}, {}, r"instance: end\[1\] = .*outside the fence"),
        (
            {"end": [[0.0, 1.8], None]},
            {},
            r"instance: end\[0\] = .*from the home of drone 1",
        ),
        (
            {"end": [[2.0, 1.0], [2.0, 1.3]]},
            {},
            r"end\[0\] = \[2.0, 1.0\]: 0.30 m from the end of drone 1",
        ),
        (
            {"time_windows": WINDOWS},
            {},
            "it has time_windows or release; robots in flight",
        ),
        (
            {"release": [2.0, 0.0]},
            {},
            "it has time_windows or release; robots in flight",
        ),
        ({"open_tours": True}, {}, "it has open_tours; robots in flight"),
        ({"objective": "makespan"}, {}, "it has objective; robots in flight"),
    ],
)
def test_an_instance_that_cannot_be_flown_is_refused_before_any_drone_flies(
    swarm, more, options, said
):
    with pytest.raises(ConfigError, match=said):
        MISSION.check(swarm(more, **options))


@pytest.mark.parametrize(
    ("graph", "said"),
    [
        ({"edges": [[0, 1]], "directed": True}, "graph: found a directed graph"),
        ({"edges": []}, "graph: found a drone that cannot reach all others"),
    ],
)
def test_a_graph_on_which_they_cannot_plan_is_refused(swarm, graph, said):
    with pytest.raises(ConfigError, match=said):
        MISSION.check(swarm().replace(**graph))


@pytest.fixture
def robot():
    raw = RAW | {
        "end": [[2.0, 1.0], None],
        "service_time": {"pickup": [0.0, 0.2], "delivery": [3.0, 0.0]},
    }
    instance, config = Instance.parse(raw), MISSION.swarm(None).replace(flight=BRISK)

    def make(i):
        guidance = PDVRPGuidance(instance.local(i), service_time=0.5)
        guidance.member = Member(i, config, None, None, None)
        return guidance

    return make


def test_it_recharges_where_it_ends(robot):
    assert robot(0).place(Stop(-1, "recharge")) == pytest.approx([2.0, 1.0, 0.5])
    home = MISSION.swarm(None).drone(1).home
    assert robot(1).place(Stop(-1, "recharge")) == pytest.approx([*home[:2], 0.5])


def test_it_stays_as_long_as_the_longer_of_the_two_service_times(robot):
    stops = (
        Stop(0, "pickup"),
        Stop(1, "pickup"),
        Stop(0, "delivery"),
        Stop(1, "delivery"),
        Stop(-1, "recharge"),
    )
    assert [robot(0).seconds(stop) for stop in stops] == [0.5, 0.5, 3.0, 0.5, 0.5]


def test_a_stop_of_an_unknown_kind_is_flown_nowhere(robot):
    with pytest.raises(ConfigError, match="kind of a stop: found wash"):
        robot(0).place(Stop(0, "wash"))


def test_a_trip_is_flown_by_way_of_the_end_and_ends_there(swarm):
    """Drone 0 alone serves both: its route comes to its end between them, and is as long as was planned."""
    end = [0.5, 1.0]
    more = {
        "recharge": 2,
        "route_length_limit": 5.0,
        "capability": [[True, True], [False, False]],
        "end": [end, None],
    }
    config = swarm(more, service_time=0.3)
    assert MISSION.check(config) == []
    result = fly_fast(config, MISSION)
    assert result["success"], result["reasons"]
    kinds = [stop["kind"] for stop in result["results"][0]["served"]]
    assert kinds == ["pickup", "delivery", "recharge", "pickup", "delivery"]
    track = np.array(result["tracks"][0])[:, -3:]
    assert np.linalg.norm(track[-1, :2] - end) < 0.1
    flown, planned = result["flown_m"][0], result["planned_m"][0]
    assert planned < flown < planned + 2.0, "and up and down"


STOPS = [{"task": 0, "kind": "pickup"}, {"task": 0, "kind": "delivery"}]


def told(swarm, served, **route):
    """What the mission reports where each drone has served a task, drone 0 these stops."""
    config = swarm({"home": [[0.0, 0.0], [-2.0, 2.0]]})
    own = {"robot": 0, "stops": STOPS, "length": 3.0} | route
    length = float(np.hypot(1, 2) + 0.5 + np.hypot(0.5, 2))
    other = {
        "robot": 1,
        "stops": [stop | {"task": 1} for stop in STOPS],
        "length": length,
    }
    plan = MISSION.hooks.instance(config).plan(Route.from_json(r) for r in (own, other))
    results = {
        0: {"served": served, "route": own, "plan_digest": plan.digest},
        1: {"served": other["stops"], "route": other, "plan_digest": plan.digest},
    }
    return MISSION.report(config, results)


def test_a_drone_that_serves_all_stops_of_its_route_in_order_succeeds(swarm):
    report = told(swarm, STOPS)
    assert (report["success"], report["reasons"], report["violations"]) == (
        True,
        {},
        [],
    )


@pytest.mark.parametrize(
    ("served", "said"),
    [
        (STOPS[:1], "served pickup 0; its route: pickup 0, delivery 0"),
        (STOPS[1:], "served delivery 0; its route: pickup 0, delivery 0"),
        ([], "served nothing; its route: pickup 0, delivery 0"),
    ],
)
def test_a_drone_that_flies_another_route_fails_and_no_other_drone_does(
    swarm, served, said
):
    report = told(swarm, served)
    assert (report["success"], report["reasons"]) == (False, {0: said})


def test_a_wrong_plan_is_no_success_though_it_was_flown(swarm):
    report = told(swarm, STOPS, length=2.0)
    assert not report["success"]
    assert "states a length of 2" in report["reasons"][0]
