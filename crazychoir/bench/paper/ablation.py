"""Influence of loss, graph, size and method on a team that solves pickup and delivery.

All runs are in virtual time. Only CPU figures depend on the machine; rounds, bytes, plans and
the time of communication are functions of the seed.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

from crazychoir.bench.significance import spread
from crazychoir.config.network import link_effects
from crazychoir.config.tables import LinkTable
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS
from crazychoir.routing.distributed.plain_loop import (
    compile_routing_kernels,
    join_solutions,
    make_team,
)
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import graph_from_name

ABLATION_GRAPHS: dict[str, Callable[[int], str]] = {
    "path": lambda n: "path",
    "ring": lambda n: "ring",
    "4-regular": lambda n: "k-regular:4",
    "Erdos-Renyi": lambda n: f"erdos-renyi:{min(1.0, 2.0 * math.log(n) / n):.2f}",
    "geometric": lambda n: (
        f"geometric:{min(1.4, math.sqrt(3.0 * math.log(n) / (math.pi * n))):.2f}"
    ),
    "complete": lambda n: "complete",
}
"""Name of the graph for n robots, by the name in the table.

The random graphs are two and three times as dense as needed to be connected.
"""


@dataclass(frozen=True, slots=True)
class AblationSettings:
    """Settings of the ablation study: its instances, its networks and the figures of its summary."""

    losses: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    """Shares of messages that are lost."""
    burst_lengths: tuple[None, float] = (None, 4.0)
    """Mean number of messages lost in a row; None: each message is lost independently."""
    team_sizes: tuple[int, ...] = (6, 10, 20, 30, 50, 100)
    """Numbers of robots."""
    message_delay: float = 0.002
    """Delay of a message, s."""
    route_length_limit: float = 25.0
    """Largest length of a route, m."""
    largest_repeated_team: int = 30
    """Largest number of robots with several seeds and with a complete graph. On a complete graph
    each round of 50 robots would need 2450 messages.
    """
    summary_figures: tuple[str, ...] = (
        "cost",
        "rounds",
        "communication_s",
        "bytes_a_robot",
        "resent_a_robot",
        "cpu_s_a_robot",
        "critical_path_s",
    )
    """Figures of the summary."""


ABLATION_STUDY = AblationSettings()


@dataclass(frozen=True)
class AblationCase:
    """One run of a team."""

    study: str
    """Study that the run belongs to: "loss", "size" or "method"."""
    robots: int
    """Number of robots, equal to the number of tasks."""
    graph: str
    """Communication graph, a key of ABLATION_GRAPHS."""
    method: str
    """Method of the team."""
    loss: float
    """Share of messages that is lost."""
    burst: float | None
    """Mean number of messages lost in a row; None: each message is lost independently."""
    seed: int
    """Seed of the instance, the graph and the network."""


def list_cases(quick: bool = False, seeds: int = 3) -> list[AblationCase]:
    """Return the cases of three studies.

    They are loss by graph and pattern, size by graph, and method by size.
    """
    if quick:
        return [
            *_loss_cases(6, ("ring", "complete"), (0.0, 0.3), 1),
            *_size_cases((6, 8), ("ring",), 1),
            *_method_cases((6,), 1),
        ]
    return [
        *_loss_cases(10, ABLATION_GRAPHS, ABLATION_STUDY.losses, seeds),
        *_size_cases(ABLATION_STUDY.team_sizes, ABLATION_GRAPHS, seeds),
        *_method_cases(ABLATION_STUDY.team_sizes[:3], seeds),
    ]


def _loss_cases(
    robots: int, graphs: Iterable[str], losses: Iterable[float], seeds: int
) -> list[AblationCase]:
    combinations = product(graphs, ABLATION_STUDY.burst_lengths, losses, _seeds(seeds))
    return [
        AblationCase(
            "loss",
            robots,
            graph,
            PLANNING_METHODS[0],
            loss,
            burst if loss else None,
            seed,
        )
        for graph, burst, loss, seed in combinations
        if loss or burst is None
    ]


def _size_cases(
    sizes: Iterable[int], graphs: Iterable[str], seeds: int
) -> list[AblationCase]:
    return [
        AblationCase("size", n, graph, PLANNING_METHODS[0], 0.1, None, s)
        for n, graph, s in product(sizes, graphs, _seeds(seeds))
        if n <= ABLATION_STUDY.largest_repeated_team or (s == 1 and graph != "complete")
    ]


def _method_cases(sizes: Iterable[int], seeds: int) -> list[AblationCase]:
    return [
        AblationCase("method", n, "ring", method, 0.1, None, s)
        for n, method, s in product(sizes, PLANNING_METHODS, _seeds(seeds))
    ]


def _seeds(count: int) -> range:
    return range(1, count + 1)


def instance_of(case: AblationCase) -> Instance:
    """Return the instance of a case, which depends on its size and seed only."""
    return random_instance(
        case.robots,
        case.robots,
        case.seed,
        InstanceShape(route_length_limit=ABLATION_STUDY.route_length_limit),
    )


def run_case(case: AblationCase) -> dict[str, Any]:
    """Run a case and return its row: the case and its figures."""
    links = graph_from_name(
        ABLATION_GRAPHS[case.graph](case.robots), case.robots, case.seed
    )
    instance = instance_of(case)
    n = case.robots
    compile_routing_kernels(instance.local(0), case.method)
    agents = make_team(
        instance, {i: list(links.neighbors(i)) for i in links.ids}, case.method
    )
    link = LinkTable(
        loss=case.loss or None, burst=case.burst, delay=ABLATION_STUDY.message_delay
    )
    history = simulate(
        agents,
        links,
        network=link_effects(link),
        seed=case.seed,
        record=(),
        channel="pickup_delivery",
    )
    solution = join_solutions(instance, [agent.solution for agent in agents.values()])
    return asdict(case) | {
        "diameter": links.diameter(),
        "edges": len(links.edges()),
        "cost": solution.cost,
        "feasible": solution.feasible,
        "lower_bound": solution.lower_bound,
        "rounds": history.rounds,
        "communication_s": history.simulated_s,
        "bytes_a_robot": history.bytes / n,
        "messages_a_robot": history.messages / n,
        "lost_a_robot": history.lost / n,
        "resent_a_robot": history.resent / n,
        "cpu_s_a_robot": sum(float(sum(cpu)) for cpu in history.cpu.values()) / n,
        "critical_path_s": history.critical_path_s,
        "plan_digest": solution.plan_digest,
    }


def run(
    of: list[AblationCase], say: Callable[[str], None] = lambda text: None
) -> list[dict[str, Any]]:
    """Run all cases and return their rows.

    Loss must not change a plan. The key `same_plan` says whether the plan equals that of the first
    run with the same robots, graph, method and seed.
    """
    rows = []
    for number, case in enumerate(of):
        say(
            f"{number + 1}/{len(of)}: {case.study}: {case.robots} robots, {case.graph}, {case.loss:.0%} lost"
        )
        rows.append(run_case(case))
    plans: dict[tuple[Any, ...], str] = {}
    for row in rows:
        key = (row["robots"], row["graph"], row["method"], row["seed"])
        row["same_plan"] = (
            plans.setdefault(key, row["plan_digest"]) == row["plan_digest"]
        )
    return rows


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row a cell: median, quartiles, least and largest of each figure over the seeds."""
    keys = ("study", "robots", "graph", "method", "loss", "burst")
    cells: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        cells.setdefault(tuple(row[key] for key in keys), []).append(row)
    found = []
    for cell, mine in cells.items():
        row = dict(zip(keys, cell, strict=True)) | {
            "seeds": len(mine),
            "same_plans": all(r["same_plan"] for r in mine),
        }
        for figure in ABLATION_STUDY.summary_figures:
            row |= {
                f"{figure}_{name}": value
                for name, value in spread([r[figure] for r in mine]).items()
            }
        found.append(row)
    return found
