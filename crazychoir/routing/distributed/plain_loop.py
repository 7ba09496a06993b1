"""All robots of an instance in one plain loop: the same messages, without clock and network."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from crazychoir.bus.codec import decode, encode
from crazychoir.errors import ConfigError, SolverError
from crazychoir.routing.distributed.member import RoutingSettings
from crazychoir.routing.distributed.pickup_delivery import (
    PLANNING_METHODS,
    PickupDelivery,
)
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance, LocalProblem
from crazychoir.routing.instance.plan import Solution

Graph = Mapping[int, Sequence[int]]
"""Neighbours of each robot."""


def solve_in_loop(
    instance: Instance,
    graph: Graph,
    method: str = PLANNING_METHODS[0],
    settings: RoutingSettings | None = None,
    carry: Callable[[Any], Any] = lambda message: message,
) -> Solution:
    """Solve the instance with all robots and return the team's solution, with all routes.

    instance: the problem of the team.
    graph: neighbours of each robot 0..N-1, connected, undirected.
    method: one of PLANNING_METHODS.
    settings: constants that all robots share.
    carry: applied to each message on its way, such as encode and decode.
    """
    agents = make_team(instance, graph, method, settings)
    while not all(agent.done for agent in agents.values()):
        messages = {i: agent.message() for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.step({j: carry(messages[j]) for j in sorted(graph[i])})
    return join_solutions(instance, [agent.solution for agent in agents.values()])


def compile_routing_kernels(
    problem: LocalProblem, method: str = PLANNING_METHODS[0]
) -> None:
    """Compile or load the kernels that such a problem needs, before a clock starts; only once."""
    _solve_small_instance(
        method,
        problem.objective,
        2 if problem.vehicle.timed or problem.vehicle.trips > 1 else 1,
    )


@cache
def _solve_small_instance(method: str, objective: tuple[str, ...], trips: int) -> None:
    """Solve a small instance.

    Messages pass the codec, because decoded arrays have another type for a kernel.
    """
    changes = {"objective": list(objective), "recharge": trips}
    small = Instance.parse(
        random_instance(
            2, 4, seed=0, shape=InstanceShape(route_length_limit=60.0)
        ).to_json()
        | changes
    )
    solve_in_loop(
        small, {0: [1], 1: [0]}, method, carry=lambda message: decode(encode(message))
    )


def make_team(
    instance: Instance,
    graph: Graph,
    method: str = PLANNING_METHODS[0],
    settings: RoutingSettings | None = None,
) -> dict[int, PickupDelivery]:
    """Return one PickupDelivery for each robot; each has only its own part of the instance."""
    span = compute_diameter(graph)
    if sorted(graph) != list(range(instance.robots)):
        raise ConfigError(
            "graph",
            sorted(graph),
            f"the robots 0 to {instance.robots - 1} of {instance.name}",
        )
    return {
        i: make_member(instance, graph, i, span, method, settings)
        for i in range(instance.robots)
    }


def make_member(
    instance: Instance,
    graph: Graph,
    i: int,
    span: int,
    method: str = PLANNING_METHODS[0],
    settings: RoutingSettings | None = None,
) -> PickupDelivery:
    """Return robot i of the team, with its own part of the instance.

    span: diameter of the graph, hops.
    The other arguments are those of `solve_in_loop`.
    """
    return PickupDelivery(
        instance.local(i),
        neighbors=sorted(graph[i]),
        n=instance.robots,
        diameter=span,
        degree_of={j: len(graph[j]) for j in graph[i]},
        method=method,
        settings=settings,
    )


def join_solutions(instance: Instance, solutions: Iterable[Solution]) -> Solution:
    """Return the team's solution from the solutions of the robots.

    `feasible` is the result of the independent checker.
    Raises SolverError if the robots' digests differ, or if the routes do not match the digest.
    """
    parts = list(solutions)
    plan = instance.plan(
        {route.robot: route for part in parts for route in part.routes}.values()
    )
    found = plan.digest
    for digest in [part.plan_digest for part in parts]:
        if digest != found:
            raise SolverError(
                "joining the robots' routes",
                f"digest {digest[:12]} announced, {found[:12]} found",
            )
    sent = Counter[str]()
    for part in parts:
        sent.update(part.bytes_by_kind)
    return replace(
        parts[0],
        routes=plan.routes,
        feasible=not check_plan(instance, plan),
        bytes_by_kind=dict(sent),
    )


def compute_diameter(graph: Graph) -> int:
    """Return the largest number of hops between two robots.

    Raises ConfigError if the graph is not connected or not undirected.
    """
    for i in sorted(graph):
        for j in graph[i]:
            if j not in graph or i not in graph[j]:
                raise ConfigError(
                    f"graph[{i}]",
                    f"the one-way edge {i} -> {j}",
                    "edges that both ends list",
                )
    return max(_compute_eccentricity(graph, i) for i in sorted(graph))


def _compute_eccentricity(graph: Graph, source: int) -> int:
    hops = {source: 0}
    queue = [source]
    for i in queue:
        for j in graph[i]:
            if j not in hops:
                hops[j] = hops[i] + 1
                queue.append(j)
    if len(hops) < len(graph):
        missing = [j for j in sorted(graph) if j not in hops]
        raise ConfigError(
            "graph",
            f"no path from {source} to {missing}",
            "a connected graph",
            "Add edges.",
        )
    return max(hops.values())
