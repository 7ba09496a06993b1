"""Solve the whole problem as one arc-flow MILP in HiGHS."""

import contextlib
import json
import sys
import time

from crazychoir.bench.peers.peers import end_with_parent
from crazychoir.bench.peers.routing import say_plan
from crazychoir.errors import SolverError
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import RoutePlan
from crazychoir.routing.pricing.arc_flow import solve_compact


def main() -> None:
    """Solve until the plan is proven optimal, or the limit of nodes is reached."""
    end_with_parent()
    spec = json.loads(sys.argv[1])
    instance = Instance.load(spec["instance"])
    began = time.perf_counter()
    cpu = time.process_time()
    plan = RoutePlan(())
    note = f"no proof within {spec['nodes']} nodes"
    with contextlib.suppress(SolverError):
        plan = solve_compact(instance, spec["nodes"])
        note = "proven optimal"
    m = len(instance.tasks)
    stops = {
        route.robot: [s.task + m * (s.kind == "delivery") for s in route.stops]
        for route in plan.routes
    }
    say_plan(stops, note, began, cpu)


if __name__ == "__main__":
    main()
