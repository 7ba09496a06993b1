"""PDVRPGuidance: the states that a robot goes through, as its status tells them, and the path that it announces."""

from itertools import groupby

import numpy as np
import pytest

from crazychoir.agent import Agent
from crazychoir.bus.local import OBSERVER
from crazychoir.bus.topics import STATE, STATUS
from crazychoir.guidance.member import Member
from crazychoir.guidance.mission import load
from crazychoir.guidance.pickup_delivery import PDVRPGuidance
from crazychoir.guidance.separation import STEP
from crazychoir.routing.instance import Instance
from crazychoir.routing.plan import Route
from crazychoir.runtime.clock import run_virtual
from crazychoir.runtime.mailbox import Call

BRISK = {"takeoff_height": 0.5, "speed_limit": 2.0, "acceleration_limit": 4.0, "landing_speed": 0.8}
# Two robots face to face, whose goods lie between them, and a third that carries nothing worth its way.
THREE = {
    "home": [[0.0, 0.0], [2.0, 0.0], [9.0, 9.0]],
    "capacity": [1.0, 1.0, 1.0],
    "pickup": [[0.5, 0.0], [1.5, 0.0]],
    "delivery": [[1.0, 0.0], [1.0, 0.0]],
    "load": [1.0, 1.0],
    "capability": [[True, False], [False, True], [True, True]],
}
SERVICE = 0.5


@pytest.fixture(scope="module")
def flown():
    """The three fly in virtual time: results, tasks of each robot's statuses in order, positions (T, 3) of each."""
    instance = Instance.parse(THREE)
    mission = load("pickup_delivery")
    drones = [{"id": i, "home": [*home, 0.0]} for i, home in enumerate(THREE["home"])]
    config = mission.swarm(None).replace(
        drones=drones, flight=BRISK, fence={"min": [-3, -3, 0], "max": [12, 12, 3]}, network={"delay": 0.3}
    )

    class Missions:
        @staticmethod
        def guidance(i, config):
            return PDVRPGuidance(instance.local(i), service_time=SERVICE)

    async def main(clock):
        agent = Agent(clock, config, Missions, config.ids)
        told, track = {i: [] for i in config.ids}, {i: [] for i in config.ids}
        agent.bus.port(OBSERVER)
        for i in config.ids:
            agent.bus.subscribe(STATUS, i, OBSERVER, Call(clock, lambda s, age, i=i: told[i].append((s.phase, s.task))))
            agent.bus.subscribe(STATE, i, OBSERVER, Call(clock, lambda s, age, i=i: track[i].append(s.p.copy())))
        return await agent.run(), told, {i: np.array(p) for i, p in track.items()}

    return instance, config, *run_virtual(main)


def states(told):
    """The states in their order."""
    return [state for state, _ in groupby(task.split(":")[0].split("/")[0] for _, task in told)]


def test_a_robot_plans_agrees_waits_flies_lands_and_is_done(flown):
    *_, told, _ = flown
    start = ["waiting for the others", "planning", "agreeing on start times"]
    assert states(told[0]) == [*start, "flying", "landing", "done"]
    wait = next(task for _, task in told[1] if "for its start" in task)
    assert states(told[1]) == [*start, wait, "flying", "landing", "done"]
    for i in (0, 1):
        flights = list(dict.fromkeys(task for _, task in told[i] if task.startswith("flying")))
        assert flights == [f"flying: {n}/2 stops" for n in range(3)]
        assert not [phase for phase, task in told[i] if phase == "on ground" and task.startswith("flying")]
        assert told[i][-1] == ("on ground", "done: 2 stops")


def test_one_of_two_that_would_meet_waits_on_the_ground_for_its_start(flown):
    *_, told, _ = flown
    waits = {i: [(phase, task) for phase, task in told[i] if "for its start" in task] for i in (0, 1)}
    assert not [task for _, task in waits[0] if task != "waiting 0 s for its start"]
    assert waits[1]
    assert {phase for phase, _ in waits[1]} == {"on ground"}


def test_a_robot_without_stops_stays_at_home_and_succeeds(flown):
    _, _, results, told, track = flown
    assert results[2]["success"]
    assert results[2]["served"] == results[2]["route"]["stops"] == []
    assert {phase for phase, _ in told[2]} == {"on ground"}
    assert told[2][-1] == ("on ground", "done: 0 stops")
    assert np.ptp(track[2], axis=0).max() < 0.01


def test_what_is_served_is_the_route_and_everybody_has_the_same_plan(flown):
    _, config, results, *_ = flown
    for i in (0, 1):
        assert results[i]["served"] == results[i]["route"]["stops"]
        assert [stop["kind"] for stop in results[i]["served"]] == ["pickup", "delivery"]
    assert len({results[i]["plan_digest"] for i in config.ids}) == 1
    assert [results[i]["cost"] for i in config.ids] == pytest.approx([4.0] * 3)


def test_the_drones_keep_the_distance_that_their_delays_promise(flown):
    *_, track = flown
    n = min(len(track[0]), len(track[1]))
    assert np.linalg.norm(track[0][:n] - track[1][:n], axis=1).min() > 0.3


def test_the_path_that_it_announces_is_the_one_that_it_flies(flown):
    instance, config, results, _, track = flown
    guidance = PDVRPGuidance(instance.local(0), service_time=SERVICE)
    guidance.member = Member(0, config, None, None, None)
    path = guidance.timed_path(Route.from_json(results[0]["route"]))
    above = guidance.above_home()
    assert path[0] == pytest.approx([0.0, 0.0, 0.0])
    assert path[-1] == pytest.approx([0.0, 0.0, 0.0])
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 1.1 * BRISK["speed_limit"] * STEP
    for place in ([0.5, 0.0, 0.5], [1.0, 0.0, 0.5], above):
        assert np.linalg.norm(path - place, axis=1).min() < 1e-9
    far = [np.linalg.norm(path - p, axis=1).min() for p in track[0]]
    assert max(far) < 0.15
    up, announced = (track[0][:, 2] > 0.05).sum() * 0.01, (path[:, 2] > 0.05).sum() * STEP
    assert up == pytest.approx(announced, abs=0.5), "the time in the air, pauses included"


def test_one_who_stays_announces_its_home_alone(flown):
    instance, config, *_ = flown
    guidance = PDVRPGuidance(instance.local(2))
    guidance.member = Member(2, config, None, None, None)
    assert guidance.timed_path(Route(2, (), 0.0)) == pytest.approx(np.array([[9.0, 9.0, 0.0]]))


def test_a_place_of_the_plane_is_visited_at_take_off_height_one_of_space_at_its_own():
    raw = {**THREE, "home": [[*p, 0.0] for p in THREE["home"]]}
    raw |= {"pickup": [[0.5, 0.0, 0.9], [1.5, 0.0, 0.9]], "delivery": [[1.0, 0.0, 1.1], [1.0, 0.0, 1.1]]}
    config = load("pickup_delivery").swarm(None).replace(flight=BRISK)
    for instance, heights in ((Instance.parse(THREE), (0.5, 0.5)), (Instance.parse(raw), (0.9, 1.1))):
        guidance = PDVRPGuidance(instance.local(0))
        guidance.member = Member(0, config, None, None, None)
        assert guidance.place(0, "pickup") == pytest.approx([0.5, 0.0, heights[0]])
        assert guidance.place(0, "delivery") == pytest.approx([1.0, 0.0, heights[1]])


def test_a_stop_is_served_for_its_time(flown):
    """At each stop the drone stands for the service time."""
    *_, track = flown
    for place in ([0.5, 0.0, 0.5], [1.0, 0.0, 0.5]):
        there = np.linalg.norm(track[0] - place, axis=1) < 0.05
        assert there.sum() * 0.01 >= SERVICE
