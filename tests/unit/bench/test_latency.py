from crazychoir.agent.agent import Agent
from crazychoir.bench.latency import CommandStopwatch, HoldMission
from crazychoir.config.swarm_config import default_swarm
from crazychoir.runtime.clock import run_virtual

LAW_TIME = 0.5  # s
LAW_TICKS = 50
DRONES = 2


def test_stopwatch_counts_each_drone_in_each_tick_of_its_law():
    elapsed_ns = []

    async def main(clock):
        ids = tuple(range(DRONES))
        agent = Agent(clock, default_swarm(DRONES), HoldMission(LAW_TIME), ids)
        CommandStopwatch(agent.drones[0].pilot.tick, agent.owners[0], elapsed_ns)
        return await agent.run()

    results = run_virtual(main)
    assert all(result["success"] for result in results.values())
    # A law may end in the tick after its last step.
    assert abs(len(elapsed_ns) - DRONES * LAW_TICKS) <= 2 * DRONES
    assert set(elapsed_ns) == {0}, "no time passes within a tick in virtual time"
