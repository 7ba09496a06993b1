"""What a drone costs in steady flight, in counts that are the same on every machine.

A swarm flies in virtual time. One second of its law is counted for messages, bytes and memory, and
the next one for Python calls, because counting calls needs memory itself.
"""

import gc
import sys
from collections import Counter
from dataclasses import dataclass
from types import CodeType

from crazychoir.agent.agent import Agent
from crazychoir.bench import steady_flight
from crazychoir.bench.steady_flight import SETTLING_TIME, fly_steadily
from crazychoir.bench.swarms import FlightCase, build_bench_swarm
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import Mission, load_mission

WINDOW = 1.0
"""s: virtual time that is counted; all periodic work of a drone happens within it.

Before that, the law flies for as long: messages are reported once a second.
"""
COUNTING_FILES = (__file__, steady_flight.__file__)
"""Files with the functions that count; their own calls do not count."""
COMPREHENSIONS = ("<listcomp>", "<dictcomp>", "<setcomp>")
"""Calls that do not count, because only Python 3.11 makes them."""


@dataclass(frozen=True)
class TickCost:
    """What a drone costs in steady flight.

    drones: number of drones
    calls: {function: Python calls a drone and tick}
    messages: messages a drone and second, divided by the mean number of drones that it hears,
        because drones at the border of a lattice hear fewer
    bytes: bytes of these messages
    blocks: blocks of memory that stay allocated, a drone and second
    """

    drones: int
    calls: dict[CodeType, float]
    messages: float
    bytes: float
    blocks: float

    @property
    def calls_per_tick(self) -> float:
        """Python calls a drone and tick."""
        return sum(self.calls.values())


def measure_lattice(
    drones: int, more_calls: int = 0, network: dict[str, float] | None = None
) -> TickCost:
    """Count the cost of the bearing law on a lattice of lightweight drones.

    more_calls: further Python calls a drone and tick, which must be seen
    network: [network], the simulated network; None: a perfect one
    """
    duration = SETTLING_TIME + 3.0 * WINDOW + 0.5
    config = build_bench_swarm(FlightCase(drones), duration)
    if network is not None:
        config = config.replace(network=network)
    return measure_cost(config, load_mission("bearing_formation"), more_calls)


def measure_cost(
    config: SwarmConfig, mission: Mission, more_calls: int = 0
) -> TickCost:
    """Fly a swarm, and count its cost when all drones but the leaders fly its law.

    more_calls: further Python calls a drone and tick, which must be seen
    """
    drones = len(config.ids)
    graph = config.graph()
    heard = max(1, sum(len(graph.in_neighbors(i)) for i in graph.ids))
    ticks = round(WINDOW * config.mocap.rate)

    async def measure(agent: Agent) -> TickCost:
        await agent.clock.sleep(WINDOW)
        messages, size = count_messages(agent)
        blocks = count_blocks()
        await agent.clock.sleep(WINDOW)
        kept = count_blocks() - blocks
        later_messages, later_size = count_messages(agent)
        for k in range(ticks if more_calls else 0):
            at_ns = agent.clock.now_ns() + round(1e9 * WINDOW * (k + 0.5) / ticks)
            agent.clock.call_at(at_ns, call_often, more_calls * drones)
        calls = await count_calls(agent)
        return TickCost(
            drones,
            {code: count / (drones * ticks) for code, count in calls.items()},
            (later_messages - messages) / (heard * WINDOW),
            (later_size - size) / (heard * WINDOW),
            kept / (drones * WINDOW),
        )

    return fly_steadily(config, mission, measure)


async def count_calls(agent: Agent) -> Counter[CodeType]:
    """Count the calls of each Python function during WINDOW; a resumed coroutine is a call."""
    calls: Counter[CodeType] = Counter()

    def count(frame, event, arg):
        if event == "call":
            calls[frame.f_code] += 1

    sys.setprofile(count)
    try:
        await agent.clock.sleep(WINDOW)
    finally:
        sys.setprofile(None)
    return Counter({code: n for code, n in calls.items() if counts(code)})


def counts(code: CodeType) -> bool:
    """Return whether the calls of a function count."""
    is_own = code.co_filename in COUNTING_FILES and code is not do_nothing.__code__
    return not is_own and code.co_name not in COMPREHENSIONS


def count_messages(agent: Agent) -> tuple[int, int]:
    """Return the messages that all drones have sent so far, and their bytes."""
    counters = [agent.bus.ports[i].counters for i in agent.ids]
    return sum(one.sent for one in counters), sum(one.bytes for one in counters)


def count_blocks() -> int:
    """Return the blocks of memory that Python holds, without garbage."""
    gc.collect()
    return sys.getallocatedblocks()


def call_often(times: int) -> None:
    for _ in range(times):
        do_nothing()


def do_nothing() -> None:
    pass
