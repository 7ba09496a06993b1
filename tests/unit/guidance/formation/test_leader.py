"""Leaders' paths before they fly, and graphs that are the same in the check and in the law."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.agent.agent import Agent
from crazychoir.agent.command_arguments import path_message
from crazychoir.bus.commands import ANSWER_TEXTS, Commander
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.feedback import LAW_TASK
from crazychoir.guidance.formation.leader import LeaderOptions, path_of
from crazychoir.guidance.mission import load_mission
from crazychoir.planning.spline import fit_spline
from crazychoir.runtime.clock import run_virtual
from crazychoir.types import State

FORMATIONS = ("bearing_formation", "containment", "distance_formation")


def swarm(name, **options):
    """A mission, and its own swarm with these options besides."""
    mission = load_mission(name)
    config = mission.swarm(None)
    return mission, config.replace(mission_options=config.mission_options | options)


@pytest.mark.parametrize("name", FORMATIONS)
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"radius": 50.0, "period": 100.0},
            r"mission_options\.leaders: drone 0: trajectory: set-point.*fence",
        ),
        (
            {"period": 1.0, "ramp": 1.0},
            r"mission_options\.leaders: drone 0: trajectory at .* s: (speed|acceleration)",
        ),
    ],
)
def test_paths_that_leaders_cannot_fly_are_refused(name, options, said):
    mission, config = swarm(name, leaders="circle", **options)
    with pytest.raises(ConfigError, match=said):
        mission.check(config)


@pytest.mark.parametrize("name", FORMATIONS)
def test_a_circle_inside_the_fence_may_be_flown(name):
    mission, config = swarm(name, leaders="circle")
    assert mission.check(config) == []


def test_a_drawing_that_is_not_named_is_asked_for():
    mission, config = swarm("containment", leaders="drawn")
    with pytest.raises(
        ConfigError,
        match=r"mission_options\.drawing: found nothing; allowed: a CSV file",
    ):
        mission.check(config)


def test_a_drone_that_would_hover_outside_the_fence_is_named():
    mission, config = swarm("containment")
    drones = [
        {
            "id": d.id,
            "home": d.home,
            "leader": d.leader,
            "options": {"height": 2.0 + d.id},
        }
        for d in config.drones
    ]
    with pytest.raises(ConfigError, match=r"drone 2: hovers.*4\.0.*within the fence"):
        mission.check(config.replace(drones=drones))


def test_a_follower_in_a_directed_graph_flies_by_the_drones_that_it_hears():
    mission, config = swarm("bearing_formation")
    edges = [[0, 2], [1, 2], [3, 2], [0, 3], [1, 3]]
    config = config.replace(edges=edges, directed=True)
    assert (
        tuple(mission.guidance(3, config).weights)
        == mission.hooks.neighbors(config)[3]
        == (0, 1)
    )


def test_a_directed_graph_of_distances_is_refused():
    mission, config = swarm("distance_formation")
    with pytest.raises(
        ConfigError, match="a directed graph; allowed: an undirected one"
    ):
        mission.check(config.replace(directed=True))


def test_a_share_with_too_strong_rare_ticks_is_refused():
    mission, config = swarm("containment", edges="random")
    assert mission.check(config) == []
    with pytest.raises(
        Refused,
        match=r"kp = 0.8, kv = 1.6 over share\^2 = 0.04 are unstable.*or raise share",
    ):
        mission.check(swarm("containment", edges="random", share=0.2)[1])
    assert mission.check(swarm("containment", share=0.2)[1]) == [], (
        "of static edges it says nothing"
    )


def test_where_all_are_leaders_nothing_is_contained():
    mission, config = swarm("containment")
    drones = [{"id": d.id, "home": d.home, "leader": True} for d in config.drones]
    with pytest.raises(Refused, match="every drone is a leader"):
        mission.check(config.replace(drones=drones))


def test_a_tick_that_one_drone_has_missed_changes_no_random_edge():
    mission, config = swarm("containment", edges="random")
    ends = mission.guidance(4, config), mission.guidance(5, config)
    at = {i: State.at((float(i), 0.0, 1.0)) for i in (4, 5)}
    same = []
    for k in range(200):
        now = SimpleNamespace(epoch_ns=0, now_ns=lambda k=k: 10_000_000 * k + 300_000)
        for law in ends:
            law.member = SimpleNamespace(clock=now)
        mine = ends[0].step(at[4], {5: at[5]}).a
        if k % 7:  # a tick that drone 5 misses
            same.append(
                np.allclose(mine[0] != 0.0, ends[1].step(at[5], {4: at[4]}).a[0] != 0.0)
            )
    assert all(same)


def test_leaders_take_a_path_that_an_operator_has_drawn_into_their_mission(repository):
    """Side by side from where they are; the formation follows, and a second path goes on from there."""
    config = SwarmConfig.load(repository / "deploy" / "formation_drawn.toml")
    config = config.replace(mission_options={"leaders": "still", "duration": 60.0})
    mission = load_mission(config.mission)
    places = np.array([[5.0, 5.0, 2.0], [5.5, 5.0, 2.0], [5.5, 5.5, 2.0]])
    path = path_message(fit_spline([0.0, 4.0, 8.0], places, degree=7))
    far = path_message(
        fit_spline([0.0, 30.0], [[0.0, 0.0, 0.0], [0.0, 9.0, 0.0]], degree=7)
    )

    async def main(clock):
        agent = Agent(clock, config, mission, config.ids)
        commander = Commander(agent.bus.port(PORT_ADDRESSES.first_observer, 0xF1))
        flight = asyncio.create_task(agent.run())
        while any(drone.status().task != LAW_TASK for drone in agent.drones.values()):
            await clock.sleep(0.1)
        await clock.sleep(8.0)
        seen = [{i: drone.pilot.state.p.copy() for i, drone in agent.drones.items()}]
        for _ in range(2):
            answers = [await commander.request(i, "fly", **path) for i in (0, 1)]
            assert all(
                answer.kind == ANSWER_TEXTS.done and "leads along it" in answer.detail
                for answer in answers
            ), answers
            await clock.sleep(16.0)
            seen.append(
                {i: drone.pilot.state.p.copy() for i, drone in agent.drones.items()}
            )
        refused = [
            await commander.request(i, "fly", **one) for i, one in ((2, path), (0, far))
        ]
        assert [answer.kind for answer in refused] == [
            ANSWER_TEXTS.refused,
            ANSWER_TEXTS.refused,
        ]
        assert "its mission controls it" in refused[0].detail
        assert "fence" in refused[1].detail
        for drone in agent.drones.values():
            drone.pilot.land("enough")
        agent.land_all("enough")
        await flight
        return seen

    before, between, after = run_virtual(main)
    for i in config.ids:
        assert between[i] - before[i] == pytest.approx([0.5, 0.5, 0.0], abs=0.05), i
        assert after[i] - before[i] == pytest.approx([1.0, 1.0, 0.0], abs=0.05), i


def test_leaders_fly_an_svg_picture(tmp_path):
    file = tmp_path / "arc.svg"
    file.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg"><path d="M0 0a200 200 0 01400 0"/></svg>'
    )
    _, config = swarm("containment", leaders="drawn", drawing=str(file))
    path = path_of(config, LeaderOptions(leaders="drawn", drawing=str(file)))
    places = path.samples(np.linspace(0.0, path.duration, 100))[:, 0:2]
    assert places.max(axis=0) == pytest.approx((0.4, 0.2), abs=0.01)
    assert places.min(axis=0) == pytest.approx((0.0, 0.0), abs=0.01)
