"""crazychoir solve: what people see of a plan, on a terminal of 80 columns."""

import io

import pytest
from rich.console import Console

from crazychoir.cli.compute import solve
from crazychoir.routing.instance.instance import Instance
from crazychoir.solve.solving import solve_here

RAW = {
    "home": [[0.0, 0.0], [0.0, 8.0]],
    "pickup": [[1.0, 0.0], [2.0, 0.0]],
    "delivery": [[1.0, 1.0], [2.0, 1.0]],
    "load": [1.0, 1.0],
    "capacity": [1.0, 1.0],
}


@pytest.fixture
def shown():
    """The lines of the tables of an instance, changed, when it is solved; or of a result of it that is changed."""

    def lines(change, **result):
        console = Console(file=io.StringIO(), width=80)
        console.print(solve._tables(solve_here(Instance.parse(RAW | change)) | result))
        found = console.file.getvalue().splitlines()
        assert max(map(len, found)) <= 80
        return [" ".join(line.replace("│", " ").split()) for line in found]

    return lines


def test_a_plain_plan_shows_neither_times_nor_trips(shown):
    lines = shown({})
    assert "cost 6.65028 m" in lines
    assert "lower_bound 6.65028 m" in lines
    assert "gap 0.00 %" in lines
    assert not [
        line for line in lines if line.startswith(("makespan_s", "refused", "total_m"))
    ]
    assert "0 6.650 +0 -0 +1 -1" in lines
    assert "+3: picks task 3 up, -3: delivers it" in lines


def test_trips_are_rows_and_no_stop_to_recharge_is_a_task(shown):
    lines = shown(
        {
            "recharge": 2,
            "route_length_limit": 5.5,
            "capability": [[True, True], [False, False]],
        }
    )
    assert "0 1 3.414 +0 -0" in lines or "0 1 5.236 +1 -1" in lines
    assert "0 2 5.236 +1 -1" in lines or "0 2 3.414 +0 -0" in lines
    assert not [line for line in lines if "--1" in line]


def test_where_times_matter_each_service_has_its_own(shown):
    lines = shown(
        {
            "time_windows": {"pickup": [[5, 9], None]},
            "penalty": [None, 0.5],
            "service_time": 2.0,
        }
    )
    assert "makespan_s 11.4142 s" in lines
    assert "0 3.414 11.41 +0@5.00 -0@8.00" in lines
    assert "refused task 1 (penalty 0.5)" in lines
    assert "cost 3.91421" in lines, "with penalties it has no unit"
    assert "total_m 3.41421 m" in lines


def test_the_cost_of_a_makespan_is_in_seconds(shown):
    lines = shown({"objective": "makespan", "speed": 0.5})
    assert [line for line in lines if line.startswith("cost ") and line.endswith(" s")]
    assert "lower_bound none" in lines


def test_a_plan_without_routes_says_so(shown):
    assert "No robot leaves home." in shown({"penalty": [0.1, 0.1]})


def test_a_plan_that_is_not_feasible_says_what_is_wrong(shown):
    lines = shown({}, feasible=False, violations=["robot 0: carries 2 [of] 1"])
    assert "not feasible" in lines
    assert "wrong robot 0: carries 2 [of] 1" in lines


def test_the_progress_states_the_gap_as_soon_as_there_is_a_bound():
    console = Console(file=io.StringIO(), width=80)
    progress = {0: ("clusters", 9, 8.0, None), 1: ("partition", 40, 8.0, 7.0)}
    console.print(solve._progress_table(progress))
    first, second = console.file.getvalue().splitlines()[3:5]
    assert "%" not in first
    assert second.replace("│", " ").split()[-3:] == ["7.000", "12.50", "%"]
