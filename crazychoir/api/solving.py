"""Solve a pickup-and-delivery instance by a team of robots, without flight."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from crazychoir.errors import ConfigError
from crazychoir.numerics.compiling import KERNEL_QUEUE
from crazychoir.optimization.rounds.budget import BudgetSettings
from crazychoir.routing.distributed.pickup_delivery import choose_routing_settings
from crazychoir.routing.instance.instance import Instance
from crazychoir.solve.solve_options import DEFAULT_SOLVE_OPTIONS, SolveOptions
from crazychoir.solve.solving import solve_here
from crazychoir.solve.team import solve_in_processes
from crazychoir.team.graph import graph_from_name


def solve(
    instance: str | Path | Instance,
    *,
    method: str = DEFAULT_SOLVE_OPTIONS.method,
    loss: float = DEFAULT_SOLVE_OPTIONS.loss,
    graph: str = DEFAULT_SOLVE_OPTIONS.graph,
    seed: int = DEFAULT_SOLVE_OPTIONS.seed,
    processes: int | None = None,
    prove: bool = False,
    seconds: float | None = None,
    work: int | None = None,
) -> dict[str, Any]:
    """Solve a pickup-and-delivery instance by a team of robots; return what `solve --json` prints.

    instance: file (JSON, or of Li and Lim) or instance
    method: name of the distributed method
    loss: share of the messages that is lost, below 1
    graph: name of the communication graph, as "ring"
    seed: seed of the graph and of the losses
    processes: number of processes, in real time over Zenoh; None: in this process, in virtual time
    prove: whether to prove the plan optimal, or a bound for large teams, whatever it costs
    seconds: s that the team searches for better plans; None: the method ends by itself
    work: search steps in place of seconds: the same number gives the same plan on every machine
    Raises InstanceError, SolverError or ConfigError.
    """
    problem = (
        instance if isinstance(instance, Instance) else Instance.load(Path(instance))
    )
    chosen = choose_solve_options(problem, method, loss, graph, seed)
    budget = BudgetSettings(seconds, work)
    chosen = replace(chosen, settings=choose_routing_settings(method, budget, prove))
    KERNEL_QUEUE.compile()
    if processes is None:
        return solve_here(problem, chosen)
    return solve_in_processes(problem, processes, chosen)


def choose_solve_options(
    problem: Instance, method: str, loss: float, graph: str, seed: int
) -> SolveOptions:
    """Return how to solve an instance.

    Raises ConfigError for a loss or a graph that is not allowed.
    """
    if loss >= 1.0:
        allowed = "less than 1: robots that hear nothing of each other agree on nothing"
        raise ConfigError("loss", loss, allowed)
    graph_from_name(graph, problem.robots, seed)
    return SolveOptions(method, loss, graph, seed)
