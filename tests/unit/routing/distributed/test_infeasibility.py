"""An infeasible instance names the constraint in the way, and whether that is proven."""

import pytest

from crazychoir.errors import SolverError
from crazychoir.routing.distributed.plain_loop import solve_in_loop
from crazychoir.routing.instance.instance import Instance

RAW = {
    "home": [[0.0, 0.0]],
    "pickup": [[1.0, 0.0], [0.0, 1.0]],
    "delivery": [[2.0, 0.0], [0.0, 2.0]],
    "load": [1.0, 1.0],
    "capacity": [1.0],
}
"""The route with both tasks takes 8 m."""
WINDOWS = {"time_windows": {"pickup": [[0, 1.5], [0, 1.5]]}}
LATE_HOME = {"time_windows": {"home": [[0, 6.0]]}}


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (WINDOWS, "time_windows"),
        (LATE_HOME, "time_windows"),
        ({"route_length_limit": 6.0}, "route_length_limit"),
        (WINDOWS | {"route_length_limit": 30.0}, "time_windows"),
    ],
)
@pytest.mark.parametrize(
    ("objective", "proof"), [("total", "(proven)"), ("makespan", "not proven")]
)
def test_the_constraint_that_keeps_tasks_from_service_is_named(
    graph, change, cause, objective, proof
):
    instance = Instance.parse(RAW | change | {"objective": objective})
    with pytest.raises(SolverError) as caught:
        solve_in_loop(instance, graph("ring", 1))
    text = str(caught.value)
    assert "infeasible" in text
    assert proof in text
    assert f"without {cause} all could be served" in text
