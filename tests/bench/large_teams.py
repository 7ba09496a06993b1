"""Plans of large teams with a route limit, beside VROOM and OR-tools with the same CPU time.

    python tests/bench/large_teams.py [--sizes 100/200,200/400] [--seeds 1-3]

A size is a number of robots and a number of tasks. Each row has, for one instance:

- cost: m, of our plan, from one process
- vroom, ortools: %, how much more their plans cost. VROOM runs at least once, with its highest
  exploration level, and restarts until it has had our CPU time. OR-tools gets our CPU time for its
  first plan with parallel cheapest insertion.
- cpu: s, ours
- memory: MB, largest resident memory of this process until then, without the peers of this row
"""

import argparse
import resource
import time

from labellings import (
    MOST_EXPLORATION,
    parse_range,
    percent_over,
    solve_with_vroom,
)

from crazychoir.bench.peers.ortools_peer import ORTOOLS_SETTINGS, search
from crazychoir.bench.peers.routing import BestPlan, Problem
from crazychoir.bench.routing import ROUTING_BENCH
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.solve.solving import solve_here

KILOBYTES_IN_MEGABYTE = 1000.0


def solve_with_ortools(instance: Instance, seconds: float) -> float:
    """Return the least cost in m that OR-tools finds in some seconds of CPU, inf for no plan."""
    problem = Problem.parse(instance.to_json())
    first = ORTOOLS_SETTINGS.first_strategies[0]
    return search(problem, first, seconds, BestPlan(problem))


def main() -> None:
    """Measure the instances of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="100/200,200/400")
    parser.add_argument("--seeds", type=parse_range, default=(1, 3))
    parser.add_argument("--exploration", type=int, default=MOST_EXPLORATION)
    asked = parser.parse_args()
    shape = InstanceShape(route_length_limit=ROUTING_BENCH.route_length_limit)
    solve_here(random_instance(2, 3, 0, shape))  # compiled before anything is measured
    print("  robots tasks seed      cost   vroom ortools     cpu  memory")
    first, last = asked.seeds
    for size in asked.sizes.split(","):
        robots, _, tasks = size.partition("/")
        for seed in range(first, last + 1):
            instance = random_instance(int(robots), int(tasks), seed, shape)
            began = time.process_time()
            cost = solve_here(instance)["cost"]
            seconds = time.process_time() - began
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            vroom = solve_with_vroom(instance, seconds, asked.exploration)
            ortools = solve_with_ortools(instance, seconds)
            gaps = [percent_over(other, cost) for other in (vroom, ortools)]
            print(
                f"{robots:>8s} {tasks:>5s} {seed:4d} {cost:9.3f} {gaps[0]:7.2f} {gaps[1]:7.2f} "
                f"{seconds:7.1f} {memory / KILOBYTES_IN_MEGABYTE:7.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
