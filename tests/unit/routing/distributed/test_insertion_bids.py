"""Bids of cheapest insertions: what they are worth, and the plans that CBBA and the auction make of them."""

import numpy as np
import pytest

from crazychoir.errors import SolverError
from crazychoir.routing.distributed.insertion_bids import (
    BIDDING_METHODS,
    REQUIRED_TASK_WORTH,
    InsertionBids,
)
from crazychoir.routing.distributed.plain_loop import solve_in_loop
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance


def line(**more):
    """A robot at 0 on a line, tasks from 1 to 2 and from 3 to 4."""
    raw = {
        "home": [[0.0, 0.0]],
        "pickup": [[1.0, 0.0], [3.0, 0.0]],
        "delivery": [[2.0, 0.0], [4.0, 0.0]],
        "load": [1.0, 1.0],
        "capacity": [1.0],
    }
    return Instance.parse(raw | more)


def test_a_bid_is_the_worth_less_the_growth_of_the_route():
    bids = InsertionBids(line().local(0))
    assert bids.scores(()) == pytest.approx(
        [REQUIRED_TASK_WORTH - 4.0, REQUIRED_TASK_WORTH - 8.0]
    )
    far = bids.insert((), 1)
    assert far == (1, 3)
    assert bids.scores(far) == pytest.approx([REQUIRED_TASK_WORTH, -np.inf])
    assert bids.insert(far, 0) == (0, 2, 1, 3)


def test_a_task_that_may_be_refused_is_worth_its_penalty_at_most():
    bids = InsertionBids(line(penalty=[5.0, 7.0]).local(0))
    assert bids.scores(()) == pytest.approx([1.0, -np.inf])


def test_what_is_beyond_capacity_limit_or_capability_is_no_bid():
    assert InsertionBids(line(route_length_limit=8.0).local(0)).scores(())[1] > 0.0
    with_two = {
        "home": [[0.0, 0.0], [5.0, 0.0]],
        "capacity": [1.0, 1.0],
        "capability": [[True, False], [True, True]],
    }
    assert InsertionBids(line(**with_two).local(0)).scores(()) == pytest.approx(
        [REQUIRED_TASK_WORTH - 4.0, -np.inf]
    )


@pytest.mark.parametrize("method", BIDDING_METHODS)
@pytest.mark.parametrize("seed", range(6))
def test_plans_are_feasible_and_cost_no_less_than_the_best(graph, method, seed):
    instance = random_instance(
        4, 7, seed, InstanceShape(capable=0.8, route_length_limit=60.0)
    )
    solution = solve_in_loop(
        instance, graph(("ring", "path", "star")[seed % 3], 4), method
    )
    best = solve_in_loop(instance, graph("ring", 4), "resource-columns")
    assert solution.feasible
    assert check_plan(instance, solution.plan) == []
    assert best.cost - 1e-6 <= solution.cost <= 2.0 * best.cost
    assert (solution.lower_bound, solution.bound_exact) == (None, False)
    assert "bids" in solution.bytes_by_kind


@pytest.mark.parametrize("method", BIDDING_METHODS)
def test_every_robot_names_the_task_that_no_route_has_room_for(graph, method):
    """The near robot takes the near task, and cannot reach the far one any more; the other may do the near one only."""
    raw = {
        "load": [1.0, 1.0],
        "home": [[0.0, 0.0], [0.0, 1.0]],
        "capacity": [1.0, 1.0],
        "pickup": [[1.0, 0.0], [0.0, -3.0]],
        "delivery": [[2.0, 0.0], [0.0, -4.0]],
        "route_length_limit": 8.0,
        "capability": [[True, True], [True, False]],
    }
    with pytest.raises(
        SolverError,
        match=rf"robot 0: {method}: .* no route has room for task\(s\) 1",
    ):
        solve_in_loop(Instance.parse(raw), graph("path", 2), method)
    assert solve_in_loop(
        Instance.parse(raw), graph("path", 2), "resource-columns"
    ).feasible
