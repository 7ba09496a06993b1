"""Plans from the relaxation, one route after the other."""

import numpy as np
import pytest

from crazychoir.routing.distributed.diving import Dive
from crazychoir.routing.distributed.large_bound import LargeBound
from crazychoir.routing.distributed.plain_loop import solve_in_loop
from crazychoir.routing.distributed.robot_profile import introduce_robots
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.pricing.route_table import RouteColumn, RouteTable
from tests.unit.routing.distributed.test_distributed_columns import members, run_all

POOR_PLAN = [(0, RouteColumn(90.0, (0, 1)))]
"""It costs 90 m, and says nothing about other tasks."""


def draw_instance(seed):
    shape = InstanceShape(route_length_limit=30.0)
    return random_instance(4, 8, seed, shape)


def dive(instance, links, fixed, below=np.inf):
    """Return the plans that all robots get, and the bound."""
    team = members(instance, links)
    run_all([introduce_robots(member) for member in team], links)
    bounds = [LargeBound(member, POOR_PLAN) for member in team]
    run_all([bound.run() for bound in bounds], links)
    dives = [
        Dive(member, bound.pool, bound.halves, fixed, below).run()
        for member, bound in zip(team, bounds, strict=True)
    ]
    return run_all(dives, links), bounds[0].value


@pytest.mark.parametrize("seed", range(3))
def test_a_dive_finds_a_plan_of_all_tasks_near_the_bound(graph, seed):
    instance, links = draw_instance(seed), graph("ring", 4)
    plans, bound = dive(instance, links, [])
    assert all(plan == plans[0] for plan in plans)
    assert sorted(j for tasks in plans[0].values() for j in tasks) == list(range(8))
    tables = {i: RouteTable(instance.local(i).vehicle) for i in range(4)}
    cost = sum(tables[i].find(tasks).length for i, tasks in plans[0].items())
    best = solve_in_loop(instance, links)
    assert best.lower_bound == pytest.approx(best.cost, abs=1e-3)
    assert bound <= best.cost + 1e-6 <= cost + 2e-6
    assert cost <= 1.2 * best.cost
    assert dive(instance, links, [])[0][0] == plans[0], "the same again"


def test_a_dive_keeps_the_fixed_routes(graph):
    instance, links = draw_instance(1), graph("ring", 4)
    table = RouteTable(instance.local(2).vehicle)
    own = table.find((0, 5)) or table.find((0,))
    plans, _ = dive(instance, links, [(2, own)])
    assert plans[0][2] == own.tasks
    served = sorted(j for tasks in plans[0].values() for j in tasks)
    assert served == list(range(8))
