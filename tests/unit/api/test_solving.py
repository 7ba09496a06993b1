"""Instances solved from Python."""

import pytest

from crazychoir.api import solve
from crazychoir.errors import ConfigError
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS
from crazychoir.routing.instance.generate import random_instance
from crazychoir.routing.instance.instance import Instance

NO_TASKS = {"pickup": [], "delivery": [], "load": []}
SMALL = random_instance(2, 2, seed=1)


def test_an_instance_is_solved_and_loss_changes_no_plan():
    plan = solve(SMALL)
    assert plan["feasible"]
    lossy = solve(SMALL, loss=0.3, seed=2)
    assert lossy["plan_digest"] == plan["plan_digest"]
    assert (plan["lost"], lossy["lost"] > 0) == (0, True)


def test_a_file_is_solved_as_its_instance(tmp_path):
    path = tmp_path / "small.json"
    path.write_text(__import__("json").dumps(SMALL.to_json()))
    assert solve(path)["plan_digest"] == solve(SMALL)["plan_digest"]


@pytest.mark.parametrize("method", PLANNING_METHODS)
@pytest.mark.parametrize("robots", [1, 3])
def test_no_tasks_are_a_plan_of_nothing(method, robots):
    team = {
        "home": [[float(i), 0.0] for i in range(robots)],
        "capacity": [1.0] * robots,
    }
    plan = solve(Instance.parse(team | NO_TASKS), method=method)
    assert (plan["cost"], plan["feasible"], plan["trips"]) == (0.0, True, [])
    assert (plan["lower_bound"], plan["bound_exact"]) == (0.0, True)


def test_seconds_end_the_search_with_a_plan_and_its_curve():
    plan = solve(random_instance(3, 12, seed=1), seconds=0.1, graph="complete")
    assert plan["ended_by"] == "seconds"
    assert plan["curve"][-1][1] == pytest.approx(plan["cost"])
    assert len(plan["curve"]) == len(plan["work_curve"])


def test_a_budget_is_refused_by_a_method_that_ends_by_itself():
    with pytest.raises(ConfigError, match=r"^work: found a budget for the method cbba"):
        solve(SMALL, method="cbba", work=1)


@pytest.mark.parametrize(
    ("values", "said"), [({"loss": 1.0}, "loss"), ({"graph": "rong"}, "graph")]
)
def test_wrong_values_are_refused(values, said):
    with pytest.raises(ConfigError, match=f"^{said}: found"):
        solve(SMALL, **values)
