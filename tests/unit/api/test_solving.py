"""Instances solved from Python."""

import pytest

from crazychoir.api import solve
from crazychoir.errors import ConfigError
from crazychoir.routing.instance.generate import random_instance

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


@pytest.mark.parametrize(
    ("values", "said"), [({"loss": 1.0}, "loss"), ({"graph": "rong"}, "graph")]
)
def test_wrong_values_are_refused(values, said):
    with pytest.raises(ConfigError, match=f"^{said}: found"):
        solve(SMALL, **values)
