import pytest

from crazychoir.errors import SolverError
from crazychoir.routing.distributed.master import PartitionProblem, find_partition
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.arc_flow import solve_compact
from crazychoir.routing.pricing.route_table import RouteTable

CASES = [
    (2, 2, 0, {}),
    (3, 3, 1, {"capable": 0.6}),
    (3, 3, 7, {"room": (3, 3, 2), "capable": 0.5}),
    (4, 3, 5, {"route_length_limit": 30.0}),
    (3, 3, 6, {"capacities": (3, 3), "loads": (2, 3)}),
]


@pytest.mark.parametrize(("robots", "tasks", "seed", "options"), CASES)
def test_arcs_and_columns_have_the_same_optimum(robots, tasks, seed, options):
    instance = random_instance(robots, tasks, seed, InstanceShape(**options))
    plan = solve_compact(instance)
    assert check_plan(instance, plan) == []
    tables = [RouteTable(instance.local(i).vehicle) for i in range(robots)]
    columns = [
        (i, table.column(c))
        for i, table in enumerate(tables)
        for c in range(1, len(table))
    ]
    assert find_partition(
        PartitionProblem(columns, tasks), seed=0, nodes=10_000
    ).cost == pytest.approx(plan.cost, abs=1e-6)


def test_no_plan_is_an_error():
    raw = {
        "pickup": [[1.0, 0.0], [9.0, 0.0]],
        "delivery": [[1.0, 0.0], [9.0, 0.0]],
        "load": [1.0, 1.0],
    }
    alone = Instance.parse(
        raw | {"home": [[5.0, 0.0]], "capacity": [1.0], "route_length_limit": 9.0}
    )
    with pytest.raises(SolverError, match="Infeasible"):
        solve_compact(alone)
