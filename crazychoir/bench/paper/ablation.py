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
from crazychoir.config.network import changes
from crazychoir.routing.distributed.pickup_delivery import METHODS
from crazychoir.routing.distributed.plain_loop import joined, team, warm
from crazychoir.routing.instance.generate import random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import named

GRAPHS: dict[str, Callable[[int], str]] = {
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
LOSSES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
"""Shares of messages that are lost."""
BURSTS = (None, 4.0)
"""Mean number of messages lost in a row; None: each message is lost independently."""
SIZES = (6, 10, 20, 30, 50, 100)
"""Numbers of robots."""
DELAY = 0.002
"""Delay of a message, s."""
LIMIT = 25.0
"""Largest length of a route, m."""
LARGE = 30
"""Number of robots above which there is only one seed and no complete graph.

On a complete graph each round of 50 robots would need 2450 messages.
"""
FIGURES = (
    "cost",
    "rounds",
    "communication_s",
    "bytes_a_robot",
    "resent_a_robot",
    "cpu_s_a_robot",
    "critical_path_s",
)
"""Figures of the summary."""


@dataclass(frozen=True)
class Case:
    """One run of a team."""

    study: str
    """Study that the run belongs to: "loss", "size" or "method"."""
    robots: int
    """Number of robots, equal to the number of tasks."""
    graph: str
    """Communication graph, a key of GRAPHS."""
    method: str
    """Method of the team."""
    loss: float
    """Share of messages that is lost."""
    burst: float | None
    """Mean number of messages lost in a row; None: each message is lost independently."""
    seed: int
    """Seed of the instance, the graph and the network."""


def cases(quick: bool = False, seeds: int = 3) -> list[Case]:
    """Return the cases of three studies.

    They are loss by graph and pattern, size by graph, and method by size.
    """
    if quick:
        return [
            *_loss(6, ("ring", "complete"), (0.0, 0.3), 1),
            *_size((6, 8), ("ring",), 1),
            *_method((6,), 1),
        ]
    return [
        *_loss(10, GRAPHS, LOSSES, seeds),
        *_size(SIZES, GRAPHS, seeds),
        *_method(SIZES[:3], seeds),
    ]


def _loss(
    robots: int, graphs: Iterable[str], losses: Iterable[float], seeds: int
) -> list[Case]:
    combinations = product(graphs, BURSTS, losses, _seeds(seeds))
    return [
        Case("loss", robots, graph, METHODS[0], loss, burst if loss else None, seed)
        for graph, burst, loss, seed in combinations
        if loss or burst is None
    ]


def _size(sizes: Iterable[int], graphs: Iterable[str], seeds: int) -> list[Case]:
    return [
        Case("size", n, graph, METHODS[0], 0.1, None, s)
        for n, graph, s in product(sizes, graphs, _seeds(seeds))
        if n <= LARGE or (s == 1 and graph != "complete")
    ]


def _method(sizes: Iterable[int], seeds: int) -> list[Case]:
    return [
        Case("method", n, "ring", method, 0.1, None, s)
        for n, method, s in product(sizes, METHODS, _seeds(seeds))
    ]


def _seeds(count: int) -> range:
    return range(1, count + 1)


def instance_of(case: Case) -> Instance:
    """Return the instance of a case, which depends on its size and seed only."""
    return random_instance(
        case.robots, case.robots, case.seed, route_length_limit=LIMIT
    )


def measured(case: Case) -> dict[str, Any]:
    """Run a case and return its row: the case and its figures."""
    links = named(GRAPHS[case.graph](case.robots), case.robots, case.seed)
    instance = instance_of(case)
    n = case.robots
    warm(instance.local(0), case.method)
    agents = team(
        instance, {i: list(links.neighbors(i)) for i in links.ids}, case.method
    )
    losses = changes({"loss": case.loss, "burst": case.burst}) if case.loss else {}
    network = {
        "delay": DELAY,
        **{name: value for name, value in losses.items() if value is not None},
    }
    history = simulate(
        agents,
        links,
        network=network,
        seed=case.seed,
        record=(),
        channel="pickup_delivery",
    )
    solution = joined(instance, [agent.solution for agent in agents.values()])
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
    of: list[Case], say: Callable[[str], None] = lambda text: None
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
        rows.append(measured(case))
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
        for figure in FIGURES:
            row |= {
                f"{figure}_{name}": value
                for name, value in spread([r[figure] for r in mine]).items()
            }
        found.append(row)
    return found
