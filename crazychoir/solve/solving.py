"""Solve an instance with all robots in this process, in virtual time.

The robots exchange messages over the communicator and its simulated network.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any

from crazychoir.routing.distributed.pickup_delivery import PickupDelivery
from crazychoir.routing.distributed.plain_loop import (
    compile_routing_kernels,
    join_solutions,
    make_team,
)
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.schedule import summarise_plan
from crazychoir.runtime.clock import run_virtual
from crazychoir.solve.networked_team import Run
from crazychoir.solve.simulate import simulate
from crazychoir.solve.solve_options import DEFAULT_SOLVE_OPTIONS, SolveOptions
from crazychoir.team.graph import graph_from_name

Team = Mapping[int, PickupDelivery]


def solve_here(
    instance: Instance,
    options: SolveOptions = DEFAULT_SOLVE_OPTIONS,
    *,
    watch: Callable[[Team], None] = lambda team: None,
    run: Run = run_virtual,
) -> dict[str, Any]:
    """Solve the instance together, and return what `crazychoir solve --json` prints.

    The result contains these times:

    - startup_s: s until all laws are loaded, and compiled if necessary
    - wall_s: s from the end of the start-up until all robots have the plan
    - critical_path_s: s, sum over the rounds of the slowest robot's CPU time

    instance: the pickup-and-delivery problem
    options: method, network and seed
    watch: called with the agents after each step
    run: run_virtual, or run_wall for real time
    Raises InstanceError, SolverError or ConfigError.
    """
    began = time.perf_counter()
    links = graph_from_name(options.graph, instance.robots, options.seed)
    compile_routing_kernels(instance.local(0), options.method)
    neighbors = {i: list(links.neighbors(i)) for i in links.ids}
    agents = make_team(instance, neighbors, options.method, options.settings)
    started = time.perf_counter() - began
    bursts = {} if options.burst is None else {"burst": options.burst}
    history = simulate(
        agents,
        links,
        loss=options.loss,
        network={"delay": 0.0} | bursts,
        seed=options.seed,
        record=(),
        watch=watch,
        run=run,
        channel="pickup_delivery",
    )
    solution = join_solutions(instance, [agent.solution for agent in agents.values()])
    figures = ("messages", "lost", "resent", "bytes", "wall_s", "critical_path_s")
    measured = {name: getattr(history, name) for name in figures} | {
        "startup_s": started
    }
    return solution.to_json() | summarise_plan(instance, solution.routes) | measured
