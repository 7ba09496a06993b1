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
from crazychoir.solve.interruption import Interruption
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
    interruption: Interruption | None = None,
) -> dict[str, Any]:
    """Solve the instance together, and return what `crazychoir solve --json` prints.

    The result contains these times:

    - startup_s: s until all laws are loaded, and compiled if necessary
    - wall_s: s from the end of the start-up until all robots have the plan
    - critical_path_s: s, sum over the rounds of the slowest robot's CPU time
    - curve: [[s, m], ...], the cost of each better plan over time

    instance: the pickup-and-delivery problem
    options: method, network and seed
    watch: called with the agents after each step
    run: run_virtual, or run_wall for real time
    interruption: ends the computation with the best plan, None if nothing can
    Raises InstanceError, SolverError or ConfigError.
    """
    began = time.perf_counter()
    links = graph_from_name(options.graph, instance.robots, options.seed)
    compile_routing_kernels(instance.local(0), options.method)
    neighbors = {i: list(links.neighbors(i)) for i in links.ids}
    agents = make_team(instance, neighbors, options.method, options.settings)
    started = time.perf_counter() - began
    bursts = {} if options.burst is None else {"burst": options.burst}
    clocked = _ClockedTeam(agents, watch)
    with (interruption or Interruption()).telling(clocked.interrupt):
        history = simulate(
            agents,
            links,
            loss=options.loss,
            network=bursts,
            seed=options.seed,
            record=(),
            watch=clocked.look,
            run=run,
            channel="pickup_delivery",
        )
    solution = join_solutions(instance, [agent.solution for agent in agents.values()])
    figures = ("messages", "lost", "resent", "bytes", "wall_s", "critical_path_s")
    measured = {name: getattr(history, name) for name in figures} | {
        "startup_s": started,
        "curve": clocked.curve,
    }
    return solution.to_json() | summarise_plan(instance, solution.routes) | measured


class _ClockedTeam:
    """The team with the clock of its budget, and the times of its plans."""

    def __init__(self, team: Team, watch: Callable[[Team], None]) -> None:
        self._team = team
        self._watch = watch
        self._began = time.perf_counter()
        self._one = next(iter(team.values()))
        self.curve: list[list[float]] = []
        """[[s, m], ...], see solve_here."""
        for agent in team.values():
            agent.start_clock(time.perf_counter)

    def interrupt(self) -> None:
        """Let the team end with its best plan."""
        for agent in self._team.values():
            agent.interrupt()

    def look(self, team: Team) -> None:
        """Keep the time of a better plan, which all robots know in the same round."""
        for _, cost in self._one.work_curve[len(self.curve) :]:
            self.curve.append([time.perf_counter() - self._began, cost])
        self._watch(team)
