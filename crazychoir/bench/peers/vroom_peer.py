"""VROOM, restarted from random orders of robots and tasks, and random scales of its whole numbers.

The best result counts.
"""

import importlib
from typing import Any

import numpy as np

from crazychoir.bench.peers.routing import BestPlan, Problem, Routes, answer

VROOM_SCALE_RANGE = (100.0, 10_000.0)
"""Range of the scale of VROOM's whole numbers, 1/m; its plans depend on it by some per cent."""


def solve(spec: dict[str, Any], problem: Problem, best: BestPlan) -> str:
    """Run until `seconds` are over, and at least `restarts` times.

    Returns a note with the number of runs, and of runs that left a task unserved.
    """
    vroom = importlib.import_module("vroom")
    draw = np.random.default_rng(spec["seed"])
    runs = unserved = 0
    while runs < spec["restarts"] or best.elapsed() < spec["seconds"]:
        routes = run_vroom(vroom, problem, draw, spec["exploration"], spec["threads"])
        unserved += not problem.serves_all(routes)
        runs += 1
        best.offer(routes)
    return f"{runs} runs" + (f", {unserved} left tasks unserved" if unserved else "")


def run_vroom(
    vroom: Any,
    problem: Problem,
    draw: np.random.Generator,
    exploration: int,
    threads: int,
) -> Routes:
    """Run VROOM once.

    vroom: its module
    problem: the instance
    draw: random generator
    exploration: exploration level
    threads: number of threads
    """
    n = problem.robots
    m = problem.tasks
    low, high = np.log(VROOM_SCALE_RANGE)
    scale = float(np.exp(draw.uniform(low, high)))
    data = vroom.Input()
    data.set_durations_matrix("car", problem.whole(scale).astype(np.uint32))
    longest = problem.longest(scale)
    for i in draw.permutation(n).tolist():
        able = {int(j) for j in np.flatnonzero(problem.capability[i])}
        load = [int(problem.capacity[i])]
        data.add_vehicle(
            vroom.Vehicle(
                i, start=i, end=i, capacity=load, skills=able, max_travel_time=longest
            )
        )
    for j in draw.permutation(m).tolist():
        pickup = vroom.ShipmentStep(j, n + j)
        delivery = vroom.ShipmentStep(j, n + m + j)
        data.add_job(
            vroom.Shipment(pickup, delivery, amount=[int(problem.load[j])], skills={j})
        )
    steps = data.solve(exploration_level=exploration, nb_threads=threads).to_dict()[
        "routes"
    ]
    return {route["vehicle"]: _stops(route["steps"], m) for route in steps}


def _stops(steps: list[dict[str, Any]], tasks: int) -> list[int]:
    kinds = {"pickup": 0, "delivery": tasks}
    return [kinds[step["type"]] + step["id"] for step in steps if step["type"] in kinds]


if __name__ == "__main__":
    answer(solve)
