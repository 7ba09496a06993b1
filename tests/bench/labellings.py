"""Plans of small teams without route limits: in several labellings, and beside VROOM with the same CPU time.

    python tests/bench/labellings.py [--instances 1-200] [--robots 2-6] [--tasks 5-40] [FILE.json ...]

A labelling is an order of the robots and tasks in the instance file. Each row has, for one instance:

- cost: m, the least over the labellings
- spread: %, the largest over the least cost of the labellings
- vroom: %, VROOM's cost over the least. VROOM restarts until it has had the CPU time of one labelling.
- best: %, the least cost over the best known plan: of all labellings, of VROOM, and of a search with
  `--reference` search steps if that is given
- cpu: s, mean of a labelling
"""

import argparse
import importlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from crazychoir.bench.peers.routing import Problem
from crazychoir.bench.peers.vroom_peer import run_vroom
from crazychoir.optimization.rounds.budget import BudgetSettings
from crazychoir.routing.distributed.member import RoutingSettings
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.solve.solve_options import SolveOptions
from crazychoir.solve.solving import solve_here

MOST_EXPLORATION = 5
MOST_RUNS_WITHOUT_PLAN = 20
ROBOT_FIELDS = ("home", "capacity", "capability")
TASK_FIELDS = ("pickup", "delivery", "load")
CAPACITIES = (3, 8)
TOLERANCE = 0.5  # %: largest spread, and largest cost over the best known
EQUAL = 1e-6  # %: VROOM's cost may be less than ours by rounding


@dataclass
class Measurement:
    """What the labellings of one instance cost."""

    name: str
    costs: list[float] = field(default_factory=list)
    """m, of each labelling."""
    seconds: list[float] = field(default_factory=list)
    """s of CPU, of each labelling."""
    vroom: float = np.inf
    """m."""
    reference: float = np.inf
    """m."""

    @property
    def spread(self) -> float:
        """%."""
        return percent_over(max(self.costs), min(self.costs))

    @property
    def vroom_gap(self) -> float:
        """%, negative if VROOM's plan costs less than the worst labelling."""
        return percent_over(self.vroom, max(self.costs))

    @property
    def best_gap(self) -> float:
        """%, of the worst labelling."""
        best = min(*self.costs, self.vroom, self.reference)
        return percent_over(max(self.costs), best)


def percent_over(cost: float, least: float) -> float:
    """Return by how many % `cost` exceeds `least`."""
    return 100.0 * (cost / least - 1.0)


def parse_range(text: str) -> tuple[int, int]:
    """Return both ends of a range such as "2-6"."""
    first, _, last = text.partition("-")
    return int(first), int(last or first)


def draw_instance(
    seed: int, robots: tuple[int, int], tasks: tuple[int, int]
) -> Instance:
    """Return a random instance without route limits, with at least two different capacities."""
    draw = np.random.default_rng([seed, 7])
    n = int(draw.integers(*robots, endpoint=True))
    m = int(draw.integers(*tasks, endpoint=True))
    capacities = draw.integers(*CAPACITIES, size=n, endpoint=True)
    while n > 1 and len(set(capacities.tolist())) == 1:
        capacities = draw.integers(*CAPACITIES, size=n, endpoint=True)
    fields = {"capacity": capacities.astype(float).tolist()}
    return random_instance(n, m, seed, InstanceShape(fields=fields))


def relabel(instance: Instance, robots: list[int], tasks: list[int]) -> Instance:
    """Return the instance with its robots and tasks in another order."""
    raw = instance.to_json()
    raw |= {name: [raw[name][i] for i in robots] for name in ROBOT_FIELDS}
    raw |= {name: [raw[name][j] for j in tasks] for name in TASK_FIELDS}
    raw["capability"] = [[row[j] for j in tasks] for row in raw["capability"]]
    return Instance.parse(raw)


def draw_labellings(instance: Instance, count: int) -> Iterator[Instance]:
    """Yield the instance, and then with robots and tasks in random orders."""
    yield instance
    draw = np.random.default_rng(1)
    for _ in range(count - 1):
        robots = draw.permutation(instance.robots).tolist()
        tasks = draw.permutation(len(instance.tasks)).tolist()
        yield relabel(instance, robots, tasks)


def solve_with_vroom(instance: Instance, seconds: float, exploration: int) -> float:
    """Return VROOM's least cost in m, of restarts in random orders for some seconds of CPU; inf for no plan.

    It runs at least once, which takes minutes with 200 tasks and the highest exploration level.
    """
    vroom = importlib.import_module("vroom")
    problem = Problem.parse(instance.to_json())
    draw = np.random.default_rng(1)
    began = time.process_time()
    least = np.inf
    runs = 0
    while (least == np.inf and runs < MOST_RUNS_WITHOUT_PLAN) or (
        time.process_time() - began < seconds
    ):
        runs += 1
        routes = run_vroom(vroom, problem, draw, exploration, 1)
        if problem.serves_all(routes):
            least = min(least, problem.cost(routes))
    return least


def measure(
    name: str, instance: Instance, labellings: int, reference: int, exploration: int
) -> Measurement:
    """Return what the labellings of an instance cost.

    reference: search steps of a long search.
    exploration: level of VROOM.
    """
    found = Measurement(name)
    for one in draw_labellings(instance, labellings):
        began = time.process_time()
        found.costs.append(solve_here(one)["cost"])
        found.seconds.append(time.process_time() - began)
    found.vroom = solve_with_vroom(instance, float(np.mean(found.seconds)), exploration)
    if reference:
        settings = RoutingSettings(budget=BudgetSettings(work=reference))
        found.reference = solve_here(instance, SolveOptions(settings=settings))["cost"]
    return found


def main() -> None:
    """Measure the instances of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--instances", type=parse_range, default=(1, 200))
    parser.add_argument("--robots", type=parse_range, default=(2, 6))
    parser.add_argument("--tasks", type=parse_range, default=(5, 40))
    parser.add_argument("--labellings", type=int, default=6)
    parser.add_argument("--reference", type=int, default=0)
    parser.add_argument("--exploration", type=int, default=MOST_EXPLORATION)
    parser.add_argument("files", nargs="*")
    asked = parser.parse_args()
    solve_here(random_instance(2, 3, 0))  # compiled before anything is measured
    cases = [(path, Instance.load(path)) for path in asked.files]
    if not cases:
        first, last = asked.instances
        for seed in range(first, last + 1):
            cases.append((str(seed), draw_instance(seed, asked.robots, asked.tasks)))
    print("  robots tasks      cost  spread   vroom    best    cpu  instance")
    rows = []
    for name, instance in cases:
        row = measure(
            name, instance, asked.labellings, asked.reference, asked.exploration
        )
        rows.append(row)
        print(
            f"{instance.robots:8d} {len(instance.tasks):5d} {min(row.costs):9.3f} "
            f"{row.spread:7.3f} {row.vroom_gap:7.3f} {row.best_gap:7.3f} "
            f"{np.mean(row.seconds):6.2f}  {row.name}",
            flush=True,
        )
    print(
        f"{len(rows)} instances: largest spread {max(r.spread for r in rows):.3f} %, "
        f"largest cost over the best known {max(r.best_gap for r in rows):.3f} % "
        f"({sum(r.best_gap > TOLERANCE for r in rows)} over {TOLERANCE} %), "
        f"worse than VROOM: {sum(r.vroom_gap < -EQUAL for r in rows)}"
    )


if __name__ == "__main__":
    main()
