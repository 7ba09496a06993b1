"""The bound of a large team with subset rows."""

import pytest

from crazychoir.routing.distributed import large_bound
from crazychoir.routing.distributed.large_bound import BoundPasses, LargeBound
from crazychoir.routing.distributed.plain_loop import solve_in_loop
from crazychoir.routing.distributed.robot_profile import introduce_robots
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.pricing.route_table import RouteColumn, RouteTable
from tests.unit.routing.distributed.test_distributed_columns import members, run_all

POOR_PLAN = [(0, RouteColumn(90.0, (0, 1)))]
"""It costs so much that the bound could be far above the optimum and still below this plan."""


def bound_of(instance, links):
    team = members(instance, links)
    run_all([introduce_robots(member) for member in team], links)
    found = [LargeBound(member, POOR_PLAN) for member in team]
    run_all([one.run() for one in found], links)
    assert len({one.value for one in found}) == 1
    return found[0].bound


def test_rows_raise_the_bound_but_never_above_the_optimum(graph, monkeypatch):
    links = graph("ring", 4)
    raised = 0
    for seed in range(12):
        shape = InstanceShape(route_length_limit=30.0, capacities=(2, 4))
        instance = random_instance(4, 8, seed, shape)
        best = solve_in_loop(instance, links)
        assert best.lower_bound == pytest.approx(best.cost, abs=1e-3)
        with_rows = bound_of(instance, links)
        with monkeypatch.context() as patch:
            patch.setattr(large_bound, "BOUND_PASSES", BoundPasses(cut_passes=0))
            without = bound_of(instance, links)
        assert without.value - 1e-9 <= with_rows.value <= best.cost + 1e-6
        raised += with_rows.value > without.value + 1e-3
        plan = {route.robot: route.tasks for route in best.routes}
        excess = 0.0
        for i in range(4):
            column = RouteTable(instance.local(i).vehicle).find(plan.get(i, ()))
            excess += with_rows.excess(i, column)
        left = with_rows.value + excess
        assert left <= best.cost + 1e-6, "each column costs at least its excess more"
    assert raised >= 3, raised
