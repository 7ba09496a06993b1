"""All robots of an instance in this process, over the communicator and its simulated network, in virtual time."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

from crazychoir.bus.impairment import Impairment
from crazychoir.bus.local import Bus
from crazychoir.bus.rules import Rule
from crazychoir.errors import CrazyChoirError
from crazychoir.routing.instance import Instance
from crazychoir.routing.pickup_delivery import PickupDelivery
from crazychoir.routing.solve import joined, team
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.swarm.communicator import Communicator
from crazychoir.swarm.graph import named

Team = dict[int, PickupDelivery]
Run = Callable[[Callable[[Clock], Any]], Any]


def solve_here(
    instance: Instance,
    *,
    method: str = "resource-columns",
    loss: float = 0.0,
    graph: str = "ring",
    seed: int = 0,
    watch: Callable[[Team], None] = lambda team: None,
    run: Run = run_virtual,
) -> dict[str, Any]:
    """Solve it together; returns what `crazychoir solve --json` prints.

    critical_path_s: sum over the rounds of the slowest robot's CPU time;  run: run_virtual, or run_wall.
    Raises InstanceError, SolverError, ConfigError.
    """
    began = time.perf_counter()
    links = named(graph, instance.robots, seed)
    agents = team(instance, {i: list(links.neighbors(i)) for i in links.ids}, method)
    cpu: dict[int, list[float]] = {i: [] for i in agents}

    async def robot(communicator: Communicator, agent: PickupDelivery) -> None:
        clock = communicator.port.bus.clock
        times = cpu[communicator.id]
        while not agent.done:
            heard = await communicator.neighbors_exchange(agent.message(), channel="pickup_delivery")
            times.append(await clock.compute(_timed, agent, heard))
            watch(agents)
        await communicator.close("pickup_delivery")

    async def main(clock: Clock) -> Bus:
        bus = Bus(clock, Impairment(seed, [Rule({"loss": loss})] if loss else []))
        communicators = {i: Communicator(bus.port(i), links) for i in agents}
        try:
            async with asyncio.TaskGroup() as group:
                for i, agent in agents.items():
                    group.create_task(robot(communicators[i], agent), name=f"robot {i}")
        except BaseExceptionGroup as errors:
            raise _first(errors) from errors
        return bus

    bus = run(main)
    solution = joined(instance, [agent.solution for agent in agents.values()])
    counters = [port.counters for port in bus.ports.values()]
    return solution.to_json() | {
        "messages": sum(c.sent for c in counters),
        "lost": sum(c.lost for c in counters),
        "resent": sum(c.resent for c in counters),
        "bytes": sum(c.bytes for c in counters),
        "wall_s": time.perf_counter() - began,
        "critical_path_s": sum(map(max, zip(*cpu.values(), strict=True))),
    }


def _timed(agent: PickupDelivery, heard: dict[int, Any]) -> float:
    """Step; returns the CPU seconds of this thread."""
    began = time.thread_time()
    agent.step(heard)
    return time.thread_time() - began


def _first(errors: BaseExceptionGroup[BaseException]) -> BaseException:
    """The error that says what is wrong: the package's own first."""
    inner = [_first(e) if isinstance(e, BaseExceptionGroup) else e for e in errors.exceptions]
    return next((e for e in inner if isinstance(e, CrazyChoirError)), inner[0])
