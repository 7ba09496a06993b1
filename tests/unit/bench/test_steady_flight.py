import pytest

from crazychoir.bench.steady_flight import fly_steadily
from crazychoir.bench.swarms import FlightCase, build_bench_swarm
from crazychoir.errors import Refused
from crazychoir.guidance.mission import load_mission
from crazychoir.safety.rules.modes import Mode

MISSION = load_mission("bearing_formation")


def test_the_measurement_sees_all_followers_in_the_law():
    async def list_modes(agent):
        await agent.clock.sleep(0.1)
        return {i: drone.pilot.mode for i, drone in agent.drones.items()}

    config = build_bench_swarm(FlightCase(6), 2.0)
    followers = [drone.id for drone in config.drones if not drone.leader]
    modes = fly_steadily(config, MISSION, list_modes)
    assert followers
    assert {modes[i] for i in followers} == {Mode.FOLLOW}


def test_a_law_that_ends_during_the_measurement_is_refused():
    async def wait(agent):
        await agent.clock.sleep(1.0)

    config = build_bench_swarm(FlightCase(6), 0.8)
    with pytest.raises(Refused, match=r"drones \[1, 4\] do not fly the law"):
        fly_steadily(config, MISSION, wait)


def test_a_flight_that_ends_before_the_measurement_is_refused():
    async def wait(agent):
        await agent.clock.sleep(60.0)

    config = build_bench_swarm(FlightCase(6), 0.8)
    with pytest.raises(Refused, match="it ended before: all drones have landed"):
        fly_steadily(config, MISSION, wait)
