import json
from dataclasses import replace

import pytest

from crazychoir.routing.instance.plan import (
    Route,
    RoutePlan,
    Solution,
    Stop,
    combine_digests,
)

ROUTE = Route.from_nodes(2, [1, 0, 3, 4], 3, 7.25)
OTHER = Route.from_nodes(0, [2, 5], 3, 1.5)


def test_nodes_become_stops():
    assert ROUTE.stops == (
        Stop(1, "pickup"),
        Stop(0, "pickup"),
        Stop(0, "delivery"),
        Stop(1, "delivery"),
    )
    assert ROUTE.tasks == (0, 1)


def test_the_order_of_routes_and_idle_robots_do_not_change_a_plan():
    plan = RoutePlan((ROUTE, OTHER, Route(1, (), 0.0)))
    assert plan == RoutePlan((OTHER, ROUTE))
    assert (plan.cost, [r.robot for r in plan.routes]) == (8.75, [0, 2])


def test_json_round_trip_and_digest():
    plan = RoutePlan((ROUTE, OTHER))
    again = RoutePlan.from_json(json.loads(json.dumps(plan.to_json())))
    assert (again, again.digest) == (plan, plan.digest)
    assert plan.digest == combine_digests({2: ROUTE.digest, 0: OTHER.digest})
    assert len(plan.digest) == 64


def test_any_change_changes_the_digest():
    plan = RoutePlan((ROUTE, OTHER))
    swapped = replace(ROUTE, stops=(ROUTE.stops[1], ROUTE.stops[0], *ROUTE.stops[2:]))
    others = [
        RoutePlan((swapped, OTHER)),
        RoutePlan((replace(ROUTE, length=7.2500001), OTHER)),
        RoutePlan((ROUTE,)),
    ]
    assert (
        len(
            {
                plan.digest,
                *(p.digest for p in others),
                RoutePlan((replace(ROUTE, robot=1), OTHER)).digest,
            }
        )
        == 5
    )


def test_a_solution_is_one_json_object():
    plan = RoutePlan((ROUTE, OTHER))
    solution = Solution(
        8.75,
        True,
        None,
        False,
        "resource",
        ("task prices",),
        9,
        plan.digest,
        plan.routes,
    )
    raw = json.loads(json.dumps(solution.to_json()))
    assert raw["lower_bound"] is None
    assert raw["gap"] is None
    assert replace(solution, lower_bound=7.0).gap == pytest.approx(0.2)
    assert Solution.from_json(replace(solution, lower_bound=7.0).to_json()).gap == (
        pytest.approx(0.2)
    )
    assert raw["routes"][1]["stops"][0] == {"task": 1, "kind": "pickup"}
    assert solution.plan == plan
