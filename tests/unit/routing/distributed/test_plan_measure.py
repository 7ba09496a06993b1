import numpy as np
import pytest

from crazychoir.routing.distributed.plan_measure import PlanMeasure, is_better
from crazychoir.routing.instance.instance import Instance

PLACES = {
    "home": [[0.0, 0.0], [10.0, 0.0]],
    "pickup": [[1.0, 0.0], [9.0, 0.0]],
    "delivery": [[2.0, 0.0], [8.0, 0.0]],
    "load": [1.0, 1.0],
    "capacity": [1.0, 1.0],
}
EACH_ITS_OWN = {0: [0, 2], 1: [1, 3]}
ONE_FOR_BOTH = {0: [0, 2, 1, 3], 1: []}
VEHICLES_FIRST = {"objective": ["vehicles", "total"]}


def measure_of(**more):
    instance = Instance.parse(PLACES | more)
    robots = {i: instance.local(i) for i in range(2)}
    weight = instance.vehicle_weight if "vehicles" in instance.objective else 0.0
    return PlanMeasure(robots, weight)


def test_the_worth_is_missing_tasks_then_the_objectives_in_order():
    assert measure_of().compute_worth(EACH_ITS_OWN)[:2] == pytest.approx([0.0, 8.0])
    assert measure_of().compute_worth({0: [0, 2]})[:2] == pytest.approx([1.0, 4.0])
    last = measure_of(objective="makespan", speed=[1.0, 0.5])
    assert last.compute_worth(EACH_ITS_OWN)[1] == pytest.approx(8.0)


def test_only_tasks_of_a_cluster_count_as_left_out():
    worth = measure_of().compute_worth({0: [0, 2]}, tasks=[0])
    assert worth[0] == 0.0


def test_a_refused_task_adds_its_refusal_to_the_first_objective():
    measure = measure_of(penalty=[None, 3.0])
    assert measure.compute_worth({0: [0, 2]})[:2] == pytest.approx([0.0, 7.0])
    assert measure.list_missing_tasks({0: [0, 2]}) == []
    assert measure.list_missing_tasks({1: [1, 3]}) == [0]


def test_without_vehicles_first_all_costs_are_alike():
    measure = measure_of()
    assert measure.compute_weighed_cost(EACH_ITS_OWN) == pytest.approx(8.0)
    assert measure.compute_shown_cost(EACH_ITS_OWN) == pytest.approx(8.0)
    assert measure.convert_cost(8.0, 2) == [0, 8.0]


def test_vehicles_first_count_before_lengths_and_with_their_weight_in_the_relaxations():
    weight = Instance.parse(PLACES | VEHICLES_FIRST).vehicle_weight
    measure = measure_of(**VEHICLES_FIRST)
    assert measure.compute_worth(EACH_ITS_OWN) == pytest.approx([0.0, 2.0, 8.0])
    assert measure.compute_worth(ONE_FOR_BOTH) == pytest.approx([0.0, 1.0, 18.0])
    assert measure.compute_shown_cost(ONE_FOR_BOTH) == pytest.approx(18.0)
    weighed = measure.compute_weighed_cost(ONE_FOR_BOTH)
    assert weighed == pytest.approx(weight + 18.0)
    assert measure.convert_cost(weighed, 1) == pytest.approx([0.0, 1.0, 18.0])


def test_a_route_is_measured_once(monkeypatch):
    measure = measure_of()
    cost = measure.measure_flight(0, (0, 2))
    monkeypatch.setattr(
        "crazychoir.routing.distributed.plan_measure.measure_route",
        lambda local, stops: pytest.fail("measured again"),
    )
    assert measure.measure_flight(0, (0, 2)) == cost


def test_worths_are_compared_at_the_first_difference():
    assert is_better([0.0, 5.0], [1.0, 4.0])
    assert not is_better([0.0, 5.0], [0.0, 5.0 + 1e-12])
    assert is_better([0.0, 5.0, 1.0], [0.0, 5.0 + 1e-12, 2.0])
    assert not is_better([np.inf], [3.0])


def test_a_plan_that_is_changed_in_place_is_measured_anew():
    measure = measure_of()
    routes = {0: [0, 2], 1: [1, 3]}
    both = measure.compute_worth(routes)
    both[0] = 7.0  # a caller's own list
    assert measure.compute_worth(routes)[0] == 0.0
    routes[1].clear()
    assert measure.compute_worth(routes)[:2] == pytest.approx([1.0, 4.0])
    assert measure.compute_worth(routes, tasks=[0])[0] == 0.0
