"""What the search finds, and in which time: clusters, whole fleets, and Li & Lim files named on the command line.

python tests/bench/search.py [lc101.txt ...] prints cost in m, vehicles that leave, CPU seconds.
"""

import sys
import time

from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.search.search import SearchOptions, search_plan

CASES = [(8, 16, 6_000, 2), (20, 40, 40_000, 2), (50, 100, 300_000, 3)]
"""Robots, tasks, steps, rounds."""
LIMIT = 25.0
SEEDS = (1, 2, 3)


def run(instance: Instance, steps: int, rounds: int) -> tuple[float, int, float]:
    """Cost, vehicles that leave, CPU seconds."""
    team = [instance.local(i).vehicle for i in range(instance.robots)]
    start = time.process_time()
    found = search_plan(
        team,
        [[]] * len(team),
        instance.tasks.penalty,
        steps,
        1,
        options=SearchOptions(rounds=rounds),
    )
    return found.total, sum(map(bool, found.routes)), time.process_time() - start


if __name__ == "__main__":
    run(random_instance(2, 3, 0), 10, 1)  # compiled before anything is measured
    instances = {
        f"{n} robots, {m} tasks, seed {seed}": (
            random_instance(n, m, seed, InstanceShape(route_length_limit=LIMIT)),
            steps,
            rounds,
        )
        for n, m, steps, rounds in CASES
        for seed in SEEDS
    }
    instances |= {path: (Instance.load(path), 40_000, 2) for path in sys.argv[1:]}
    for name, (instance, steps, rounds) in instances.items():
        cost, vehicles, seconds = run(instance, steps, rounds)
        print(f"{cost:12.2f} m  {vehicles:3d} vehicles  {seconds:6.2f} s  {name}")
