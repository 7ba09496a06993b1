"""Tasks that are shared out in flight, over lossy links, while robots are lost and operators add and cancel."""

import asyncio

import pytest
from system.online import crash

from crazychoir.agent.agent import Agent
from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.tasks.task_source import FIRST_ADDED_ID
from crazychoir.launch.flight import fly_fast
from crazychoir.launch.flight_observer import FlightScore
from crazychoir.runtime.clock import run_virtual

pytestmark = pytest.mark.system
MISSION = load_mission("task_assignment")
SECOND = 10**9
LONGEST = 200.0


def flown(seed, loss=0.2, prepare=lambda agent: None, **options):
    """The mission in virtual time; prepare: called with the agent. Returns its report, results and score."""
    config = MISSION.swarm(None).replace(
        seed=seed, network={"loss": loss}, mission_options=options
    )
    assert MISSION.check(config, False) == []

    async def main(clock):
        agent = Agent(clock, config, MISSION, config.ids)
        score = FlightScore(agent.bus, config.ids, {})
        agent.services.append(score)
        prepare(agent)
        async with asyncio.timeout(LONGEST):
            results = await agent.run()
        return MISSION.report(config, results), results, score

    return run_virtual(main)


def served(report, results, score, lost=()):
    """Check that all is well except for the lost drones."""
    assert report["success"], report["reasons"]
    assert report["left"] == {}
    assert score.touching == {}
    assert [i for i, result in results.items() if not result["success"]] == list(lost)
    assert report["worst_cost_gap_m"] < 1e-9
    assert sum(report["served_by_generation"]) == report["tasks"]["done"]
    assert report["planning_s"] < 1.0


def test_every_task_is_done_once_at_the_least_cost_though_messages_and_a_robot_are_lost():
    held = []

    def lose(agent):
        held.append(agent.drones[3].guidance.generation.mine)
        crash(agent, 3)

    report, results, score = flown(
        4,
        prepare=lambda agent: agent.clock.call_at(5 * SECOND, lose, agent),
        generations=4,
    )
    served(report, results, score, lost=[3])
    first = report["tables"][0]
    assert (first["number"], first["served"], first["cost"]) == (
        1,
        [4],
        pytest.approx(12.049, abs=0.02),
    )
    assert held == [3]
    assert 3 in [
        task for i, result in results.items() if i != 3 for task, _ in result["done"]
    ], "another has done it"
    assert (
        report["tasks"]["done"]
        == max(max(table["tasks"], default=0) for table in report["tables"]) + 1
    )


def test_operators_add_and_cancel_tasks_in_flight():
    answers = []

    async def ask(agent):
        await agent.clock.sleep(3.0)
        place = {"pickup": [2.5, 2.5], "robots": [1, 4]}
        answers.append(await agent.drones[2].guidance.asked("task_add", place))
        assert "task 2" in agent.drones[0].guidance._doing()
        answers.append(await agent.drones[5].guidance.asked("task_cancel", {"id": 2}))

    asking = []
    report, results, score = flown(
        4,
        0.0,
        lambda agent: asking.append(asyncio.ensure_future(ask(agent))),
        generations=1,
    )
    assert asking[0].exception() is None
    assert [answer["id"] for answer in answers] == [FIRST_ADDED_ID + 2, 2]
    served(report, results, score)
    done = {task: i for i, result in results.items() for task, _ in result["done"]}
    assert sorted(done) == [0, 1, 3, 4, 5, FIRST_ADDED_ID + 2]
    assert done[FIRST_ADDED_ID + 2] in (1, 4)


def test_a_team_without_a_flying_drone_ends_its_mission():
    """Each drone ends when it hears no flying drone any more; it does not wait for the others for ever."""

    def land(agent):
        for drone in agent.drones.values():
            drone.pilot.land("the battery is empty")

    _, results, _ = flown(
        4, 0.1, lambda agent: agent.clock.call_at(6 * SECOND, land, agent)
    )
    for result in results.values():
        assert not result["success"]
        assert (
            "; then no drone that it hears flies any more for 20 s" in result["reason"]
        )


def test_drones_left_alone_by_crashes_end_their_mission():
    """Four of six are lost at once: what is left never agrees on another team."""

    def prepare(agent):
        for i in (0, 1, 2, 3):
            agent.clock.call_at(6 * SECOND, crash, agent, i)

    _, results, _ = flown(4, 0.0, prepare)
    for i in (4, 5):
        assert (
            "cut off from more than half of the team for 20 s" in results[i]["reason"]
        )


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("loss", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(10, 20))
def test_over_many_seeds(seed, loss):
    report, results, score = flown(seed, loss)
    assert report["success"], report["reasons"]
    assert score.touching == {}
    assert all(result["success"] for result in results.values())
    assert all("no robot" in why for why in report["left"].values())
    assert report["worst_cost_gap_m"] < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("until", [11.0, None])
def test_a_part_that_is_cut_off_comes_back_or_goes_home(until):
    cut = {"at": 5.0, "groups": [[1, 4]], **({"until": until} if until else {})}
    config = MISSION.swarm(None).replace(network={"loss": 0.1, "partitions": [cut]})
    result = fly_fast(config, MISSION)
    assert result["min_separation_m"] > SWARM_LIMITS.touching_distance
    assert all(
        not ("touched" in why or "twice" in why) for why in result["reasons"].values()
    )
    ends = {i: one.get("reason", "") for i, one in result["results"].items()}
    assert [i for i, why in ends.items() if "cut off" in why] == (
        [] if until else [1, 4]
    )
    assert result["success"] == (until is not None)
