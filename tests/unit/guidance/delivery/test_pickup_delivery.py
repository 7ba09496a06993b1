"""PDVRPGuidance: the states that a robot goes through, as its status tells them, and how two share a stop."""

from itertools import groupby

import numpy as np
import pytest

from crazychoir.agent.agent import Agent
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.guidance.delivery.pickup_delivery import PDVRPGuidance
from crazychoir.guidance.member import Member
from crazychoir.guidance.mission import load_mission
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Stop
from crazychoir.runtime.clock import run_virtual
from crazychoir.runtime.mailbox import Call

BRISK = {
    "takeoff_height": 0.5,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.8,
}
# Two robots face to face with their goods between them, and a third robot; no task is worth its way.
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
    mission = load_mission("pickup_delivery")
    drones = [{"id": i, "home": [*home, 0.0]} for i, home in enumerate(THREE["home"])]
    config = mission.swarm(None).replace(
        drones=drones,
        flight=BRISK,
        fence={"min": [-3, -3, 0], "max": [12, 12, 3]},
        network={"delay": 0.3},
    )

    class Missions:
        @staticmethod
        def guidance(i, config):
            return PDVRPGuidance(instance.local(i), service_time=SERVICE)

    async def main(clock):
        agent = Agent(clock, config, Missions, config.ids)
        told, track, ahead = ({i: [] for i in config.ids} for _ in range(3))
        agent.bus.port(PORT_ADDRESSES.first_observer)
        for i in config.ids:
            agent.bus.subscribe(
                DRONE_TOPICS.status,
                i,
                PORT_ADDRESSES.first_observer,
                Call(clock, lambda s, age, i=i: told[i].append((s.phase, s.task))),
            )
            agent.bus.subscribe(
                DRONE_TOPICS.state,
                i,
                PORT_ADDRESSES.first_observer,
                Call(clock, lambda s, age, i=i: track[i].append(s.p.copy())),
            )

            def look(status, age, i=i):
                ahead[i].append([p.tolist() for p in agent.drones[i].guidance.route()])

            agent.bus.subscribe(
                DRONE_TOPICS.status, i, PORT_ADDRESSES.first_observer, Call(clock, look)
            )
        return (
            await agent.run(),
            told,
            {i: np.array(p) for i, p in track.items()},
            ahead,
        )

    return instance, config, *run_virtual(main)


def states(told):
    """The states in their order."""
    return [
        state
        for state, _ in groupby(task.split(":")[0].split("/")[0] for _, task in told)
    ]


def test_a_robot_plans_flies_lands_and_is_done(flown):
    *_, told, _, _ = flown
    for i in (0, 1):
        assert states(told[i]) == [
            "waiting for the others",
            "planning",
            "flying",
            "landing",
            "done",
        ]
        flights = list(
            dict.fromkeys(task for _, task in told[i] if task.startswith("flying"))
        )
        assert flights == [f"flying: {n}/2 stops" for n in range(3)]
        assert told[i][-1] == ("on ground", "done: 2 stops")


def test_a_robot_without_stops_stays_at_home_and_succeeds(flown):
    _, _, results, told, track, _ = flown
    assert results[2]["success"]
    assert results[2]["served"] == results[2]["route"]["stops"] == []
    assert {phase for phase, _ in told[2]} == {"on ground"}
    assert told[2][-1] == ("on ground", "done: 0 stops")
    assert np.ptp(track[2], axis=0).max() < 0.01


def test_its_route_is_over_the_stops_that_are_left_to_where_it_ends(flown):
    *_, ahead = flown
    for i, x in ((0, 0.5), (1, 1.5)):
        home = [*THREE["home"][i], 0.5]
        whole = [[x, 0.0, 0.5], [1.0, 0.0, 0.5], home]
        assert [route for route, _ in groupby(ahead[i])] == [
            [],
            whole,
            whole[1:],
            whole[2:],
            [],
        ]
    assert ahead[2] == [[]] * len(ahead[2])


def test_what_is_served_is_the_route_and_everybody_has_the_same_plan(flown):
    _, config, results, *_ = flown
    for i in (0, 1):
        assert results[i]["served"] == results[i]["route"]["stops"]
        assert [stop["kind"] for stop in results[i]["served"]] == ["pickup", "delivery"]
    assert len({results[i]["plan_digest"] for i in config.ids}) == 1
    assert [results[i]["cost"] for i in config.ids] == pytest.approx([4.0] * 3)
    assert [results[i]["objective"] for i in config.ids] == [["total"]] * 3


def test_a_place_of_the_plane_is_visited_at_take_off_height_one_of_space_at_its_own():
    raw = {**THREE, "home": [[*p, 0.0] for p in THREE["home"]]}
    raw |= {
        "pickup": [[0.5, 0.0, 0.9], [1.5, 0.0, 0.9]],
        "delivery": [[1.0, 0.0, 1.1], [1.0, 0.0, 1.1]],
    }
    config = load_mission("pickup_delivery").swarm(None).replace(flight=BRISK)
    for instance, heights in (
        (Instance.parse(THREE), (0.5, 0.5)),
        (Instance.parse(raw), (0.9, 1.1)),
    ):
        guidance = PDVRPGuidance(instance.local(0))
        guidance.member = Member(0, config, None, None, None)
        assert guidance.place(Stop(0, "pickup")) == pytest.approx(
            [0.5, 0.0, heights[0]]
        )
        assert guidance.place(Stop(0, "delivery")) == pytest.approx(
            [1.0, 0.0, heights[1]]
        )


def test_two_take_off_at_once_and_serve_the_same_stop_one_after_the_other(flown):
    """At each stop a drone stands for the service time, at the last one while the other waits near it."""
    *_, track, _ = flown
    there = {
        i: np.linalg.norm(track[i] - [1.0, 0.0, 0.5], axis=1) < 0.1 for i in (0, 1)
    }
    for i, x in ((0, 0.5), (1, 1.5)):
        pickup = np.linalg.norm(track[i] - [x, 0.0, 0.5], axis=1) < 0.05
        assert pickup.sum() * 0.01 >= SERVICE
        assert there[i].sum() * 0.01 >= SERVICE
    n = min(len(track[0]), len(track[1]))
    risen = [int(np.argmax(track[i][:, 2] > 0.1)) for i in (0, 1)]
    assert abs(risen[0] - risen[1]) < 20, "ticks of 0.01 s"
    assert not (there[0][:n] & there[1][:n]).any()
    assert np.linalg.norm(track[0][:n] - track[1][:n], axis=1).min() > 0.24, (
        "two semi-axes"
    )
