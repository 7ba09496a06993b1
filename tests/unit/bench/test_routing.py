"""What `bench routing` makes of solvers' answers: rows, gaps, summaries."""

import io
import math
from collections import Counter

import numpy as np
import pytest
from rich.console import Console

from crazychoir.bench import routing as bench_routing
from crazychoir.bench import significance as bench_statistics
from crazychoir.bench.peers import disropt_peer as peers_disropt
from crazychoir.bench.peers import routing as peers_routing
from crazychoir.bench.routing import (
    INSTANCE_SIZES,
    PEER_SOLVERS,
    TEAM_ROW,
    judge_answer,
    measure_peer,
    parse_sizes,
    rate_rows,
    summary,
)
from crazychoir.cli.compute import bench
from crazychoir.errors import ConfigError
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.route_table import RouteColumn
from crazychoir.solve.team import compute_critical_path, merge_best_points


@pytest.fixture
def instance():
    """Two robots 10 m apart; a task 3 m from each, that is carried 4 m at a right angle: tours of 3 + 4 + 5 m."""
    return Instance.parse(
        {
            "home": [[0.0, 0.0], [10.0, 0.0]],
            "pickup": [[3.0, 0.0], [7.0, 0.0]],
            "delivery": [[3.0, 4.0], [7.0, 4.0]],
            "load": [1, 1],
            "capacity": [1, 1],
            "route_length_limit": 30.0,
        }
    )


def answer(stops, **more):
    made = [{"robot": i, "nodes": nodes} for i, nodes in stops.items()]
    curve = [[0.5, 30.0], [0.7, 31.0], [1.0, 24.0]]
    return {
        "routes": made,
        "wall_s": 2.0,
        "cpu_s": 1.0,
        "curve": curve,
        "note": "one run",
    } | more


def test_the_cost_of_a_peer_is_that_of_its_routes_as_they_are_flown(instance):
    row = judge_answer(instance, answer({0: [0, 2], 1: [1, 3]}))
    assert row["cost"] == pytest.approx(24.0)
    assert row["feasible"]
    assert row["curve"] == [[0.5, 30.0], [1.0, 24.0]]
    assert row["note"] == "one run"


@pytest.mark.parametrize(
    ("routes", "fault"),
    [
        ({0: [0, 2]}, "task 1 is served 0 times"),
        ({0: [0, 1, 2, 3]}, "carries 2 after picking up task 1"),
        ({0: [2, 0], 1: [1, 3]}, "delivers task 0 without having it"),
        ({0: [0, 2, 1, 3], 1: [1, 3]}, "task 1 is served 2 times"),
    ],
)
def test_what_is_wrong_with_a_plan_is_said(instance, routes, fault):
    row = judge_answer(instance, answer(routes))
    assert not row["feasible"]
    assert fault in row["note"]


def test_a_model_that_covers_may_serve_twice_but_not_leave_out(instance):
    twice = judge_answer(instance, answer({0: [0, 2, 1, 3], 1: [1, 3]}), covers=True)
    assert twice["feasible"]
    assert "1 tasks are served by several" in twice["note"]
    long = 3.0 + 4.0 + math.dist((3, 4), (7, 0)) + 4.0 + math.dist((7, 4), (0, 0))
    assert twice["cost"] == pytest.approx(12.0 + long)
    assert not judge_answer(instance, answer({0: [0, 2], 1: [0, 2]}), covers=True)[
        "feasible"
    ]


def test_a_solver_without_a_plan_is_a_row_with_its_word(instance):
    row = judge_answer(instance, answer({}, routes=None, note="no proof"))
    assert (row["cost"], row["feasible"], row["note"], row["wall_s"]) == (
        None,
        False,
        "no proof",
        2.0,
    )


def test_a_peer_that_is_not_installed_says_how_to(instance, monkeypatch):
    monkeypatch.setattr(bench_routing.importlib.util, "find_spec", lambda name: None)
    assert (
        measure_peer(instance, PEER_SOLVERS[0], {})["note"]
        == "not measured: pip install crazychoir[bench]"
    )


def row(name, seed, cost, bound=None, **more):
    figures = {
        "size": "small",
        "robots": 2,
        "tasks": 2,
        "seed": seed,
        "name": name,
        "cost": cost,
        "wall_s": 1.0,
    }
    figures |= {
        "cpu_s": 1.0,
        "critical_path_s": None,
        "lower_bound": bound,
        "bound_exact": bound is not None,
    }
    return figures | {"feasible": cost is not None, "note": "", "curve": []} | more


def test_gaps_are_to_the_optimum_where_it_is_proven_and_else_to_the_best_exact_bound():
    proven = rate_rows(
        [row(TEAM_ROW, 1, 20.0, 20.0), row("VROOM", 1, 21.0), row("MILP", 1, None)]
    )
    assert [one["reference"] for one in proven] == ["optimum"] * 3
    assert [one["gap_percent"] for one in proven] == [0.0, pytest.approx(5.0), None]
    bounded = rate_rows([row(TEAM_ROW, 1, 22.0, 20.0), row("VROOM", 1, 21.0, 19.0)])
    assert bounded[0]["reference"] == "bound"
    assert bounded[0]["gap_percent"] == pytest.approx(10.0)
    broken = rate_rows([row(TEAM_ROW, 1, 22.0, 20.0), row("VROOM", 1, 19.0)])
    assert [(one["reference"], one["gap_percent"]) for one in broken] == [
        ("broken bound", None)
    ] * 2
    relaxed = rate_rows([row(TEAM_ROW, 1, 22.0, 20.0, bound_exact=False)])
    assert relaxed[0]["gap_percent"] is None


def test_the_summary_compares_on_instances_that_both_have_solved():
    rows = []
    for seed, (ours, theirs) in enumerate(
        [(10.0, 11.0), (10.0, 12.0), (10.0, 10.0), (10.0, None), (10.0, 9.5)]
    ):
        rows += rate_rows(
            [
                row(TEAM_ROW, seed, ours, 9.0 if seed == 4 else 10.0),
                row("VROOM", seed, theirs),
            ]
        )
    team, vroom = summary(rows)
    assert (team["instances"], team["solved"], team["optimal"]) == (5, 5, 4)
    assert team["against_team"] is None
    assert (vroom["solved"], vroom["optimal"]) == (4, 1)
    versus = vroom["against_team"]
    assert (versus["pairs"], versus["wins"], versus["ties"]) == (4, 2, 1)
    shown = next(
        line.split() for line in printed([team, vroom]) if line.startswith("VROOM")
    )
    assert shown[:-1] == [
        "VROOM",
        "4/5",
        "1",
        "10.50",
        "7.78",
        "20.0",
        "1.00",
        "1.00",
        "-",
        "2/4",
    ]


def printed(rows, width=80):
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(
        bench_routing.table(
            {"summary": rows, "method": "columns", "graph": "k-regular:4", "loss": 0.1}
        )
    )
    return console.export_text().splitlines()


def test_the_table_of_all_sizes_and_solvers_fits_into_80_columns():
    rows = []
    for size, seed in (
        (size, seed) for size in INSTANCE_SIZES for seed in range(1, 21)
    ):
        names = [
            TEAM_ROW,
            *bench_routing.ROUTING_BENCH.rival_methods,
            *(peer.name for peer in PEER_SOLVERS),
            bench_routing.PROOF_ROW,
        ]
        large = {
            "size": size,
            "wall_s": 1234.5,
            "cpu_s": 4321.5,
            "critical_path_s": 123.456,
        }
        costs = [1234.567 + seed + n**2 for n in range(len(names))]
        rows += rate_rows(
            [
                row(name, seed, cost, 1111.1, **large)
                for name, cost in zip(names, costs, strict=True)
            ]
        )
    lines = printed(summary(rows))
    assert max(map(len, lines)) <= 80
    assert "…" not in "".join(lines)
    heads = [n for n, line in enumerate(lines) if line.startswith("solver")]
    assert [lines[n - 1].strip() for n in heads] == [
        "tiny: 3 robots, 5 tasks",
        "small: 10 robots, 20 tasks",
        "middle: 20 robots, 40 tasks",
        "large: 50 robots, 100 tasks",
    ]
    assert lines[heads[0] + 2].split() == [
        "crazychoir",
        "20/20",
        "0",
        "1245.07",
        "12.1",
        "12.9",
        "1234",
        "4322",
        "123",
    ]


@pytest.mark.parametrize(
    ("sizes", "found"),
    [
        (
            bench_routing.ROUTING_BENCH.default_sizes,
            {"small": 20, "middle": 5, "large": 5},
        ),
        ("small,large:2", {"small": 20, "large": 2}),
        (" tiny:1 , middle", {"tiny": 1, "middle": 5}),
    ],
)
def test_each_size_has_its_number_of_instances(sizes, found):
    assert parse_sizes(sizes) == found


@pytest.mark.parametrize(
    "sizes",
    ["", "huge", "small:0", "small:-1", "small:1.5", "small:2000", "small,small"],
)
def test_sizes_that_are_none_are_refused(sizes):
    with pytest.raises(
        ConfigError,
        match=r"^--sizes: found .*; allowed: .* As small:20,middle:5,large:5\.",
    ):
        parse_sizes(sizes)


@pytest.mark.parametrize("prove", [False, True])
def test_a_run_is_of_all_instances_and_proves_all_that_it_can(monkeypatch, prove):
    def rows(size, seed, *more):
        more[-1](f"{size} {seed}")
        return [row(TEAM_ROW, seed, 9.0, 9.0, size=size)]

    said = []
    monkeypatch.setattr(bench_routing, "_rows", rows)
    monkeypatch.setattr(
        bench_routing,
        "_prove_with_team",
        lambda size, seed, *more: row("proof", seed, 9.0, 9.0, size=size),
    )
    found = Counter(
        (one["size"], one["name"])
        for one in bench_routing.run(prove=prove, say=said.append)["rows"]
    )
    assert (said[0], said[-1]) == (
        "instance 1 of 30: small 1",
        "instance 30 of 30: large 5",
    )
    ours = {("small", TEAM_ROW): 20, ("middle", TEAM_ROW): 5, ("large", TEAM_ROW): 5}
    assert found == (
        ours | {("small", "proof"): 20, ("middle", "proof"): 5} if prove else ours
    )


@pytest.mark.parametrize(
    ("option", "said"),
    [({"method": "magic"}, "--method: found magic"), ({"graph": "knot"}, "knot")],
)
def test_what_cannot_be_is_refused_before_anything_is_measured(
    monkeypatch, option, said
):
    monkeypatch.setattr(bench_routing, "_rows", pytest.fail)
    with pytest.raises(ConfigError, match=said):
        bench_routing.run(**option)


@pytest.mark.parametrize("terminal", [False, True])
def test_a_bench_prints_its_progress_as_lines_when_there_is_no_terminal(
    monkeypatch, terminal
):
    console = Console(file=io.StringIO(), force_terminal=terminal, width=80)
    monkeypatch.setattr(bench, "ERROR_CONSOLE", console)

    def measure(say):
        say("small 1: [VROOM]")
        return {}

    bench._show(measure, lambda result: "", as_json=True)
    lines = [
        line
        for line in console.file.getvalue().splitlines()
        if line == "small 1: [VROOM]"
    ]
    assert lines == ([] if terminal else ["small 1: [VROOM]"])


def test_the_paired_test_is_that_of_wilcoxon():
    ours, gain = (
        np.array([10.0, 11.0, 12.0, 13.0, 14.0]),
        np.array([1.0, 2.0, 3.0, 4.0, 5.0]),
    )
    found = bench_statistics.compare_pairs(ours, ours + gain)
    assert found["p"] == pytest.approx(2.0**-5)
    assert bench_statistics.compare_pairs(ours, ours - gain)["p"] == 1.0
    assert bench_statistics.compare_pairs(ours, ours)["p"] is None


def test_the_spread_has_quartiles():
    assert bench_statistics.spread([1.0, 2.0, 3.0, 4.0, 9.0]) == {
        "least": 1.0,
        "lower": 2.0,
        "median": 3.0,
        "upper": 4.0,
        "most": 9.0,
    }


def test_the_critical_path_adds_the_slowest_of_each_round_and_the_empty_rounds():
    assert compute_critical_path([0.5, 0.25], 0.125) == 0.875


def test_the_curve_of_a_team_falls():
    assert merge_best_points([[2.0, 9.0], [1.0, 10.0], [1.5, 11.0], [3.0, 9.0]]) == [
        [1.0, 10.0],
        [2.0, 9.0],
    ]


def test_disropts_rule_serves_what_it_has_a_share_of_as_far_as_a_route_does():
    columns = [
        RouteColumn(0.0, ()),
        RouteColumn(5.0, (0,)),
        RouteColumn(6.0, (1,)),
        RouteColumn(7.0, (0, 2)),
        RouteColumn(9.0, (0, 1)),
    ]
    assert peers_disropt.first_serving_column(np.array([0.0, 0.0, 0.0]), columns) == ()
    assert peers_disropt.first_serving_column(np.array([0.1, 0.0, 0.0]), columns) == (
        0,
    )
    assert peers_disropt.first_serving_column(np.array([0.3, 0.2, 0.0]), columns) == (
        0,
        1,
    )
    assert peers_disropt.first_serving_column(np.array([0.3, 0.1, 0.2]), columns) == (
        0,
        2,
    )  # no route has all: rho = 0.1


def test_whole_distances_keep_the_limit():
    distance = np.array([[0.0, 1.00005], [1.00005, 0.0]])
    one = np.ones(1, np.int64)
    problem = peers_routing.Problem(distance, one, one, np.ones((1, 1), bool), 2.0)
    assert problem.whole(100.0)[0, 1] == 101
    assert problem.longest(100.0) == 200
