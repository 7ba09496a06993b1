"""The ablations: what is run, what is told of it, and the files of `bench paper`."""

import csv

import pytest

from crazychoir.bench.paper import ablation as bench_ablation
from crazychoir.bench.paper import paper as bench_paper
from crazychoir.bench.paper import pictures as bench_pictures
from crazychoir.bench.paper.ablation import (
    ABLATION_GRAPHS,
    ABLATION_STUDY,
    AblationCase,
)
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS
from crazychoir.team.graph import graph_from_name


@pytest.fixture(scope="module")
def rows():
    """A robust pair of runs: the same instance with and without loss."""
    of = [
        AblationCase("loss", 4, "ring", "resource-columns", loss, burst, 1)
        for loss, burst in ((0.0, None), (0.4, 3.0))
    ]
    return bench_ablation.run(of)


def test_the_cases_cover_loss_graphs_sizes_and_methods():
    of = bench_ablation.list_cases()
    loss, size, method = (
        [case for case in of if case.study == study]
        for study in ("loss", "size", "method")
    )
    assert {(c.graph, c.loss) for c in loss if c.burst is None} == {
        (g, p) for g in ABLATION_GRAPHS for p in ABLATION_STUDY.losses
    }
    assert {(c.graph, c.loss) for c in loss if c.burst} == {
        (g, p) for g in ABLATION_GRAPHS for p in ABLATION_STUDY.losses if p
    }
    assert {(c.robots, c.graph) for c in size} >= {
        (n, g)
        for n in ABLATION_STUDY.team_sizes
        for g in ABLATION_GRAPHS
        if g != "complete"
    }
    assert {c.robots for c in size if c.graph == "complete"} == {6, 10, 20, 30}
    assert {c.method for c in method} == set(PLANNING_METHODS)
    assert len(of) == len(set(of))


@pytest.mark.parametrize("robots", ABLATION_STUDY.team_sizes)
def test_every_size_has_an_instance(robots):
    for seed in (1, 2, 3):
        of = bench_ablation.instance_of(
            AblationCase("size", robots, "ring", "columns", 0.1, None, seed)
        )
        assert (of.robots, len(of.tasks)) == (robots, robots)


@pytest.mark.parametrize("robots", ABLATION_STUDY.team_sizes)
@pytest.mark.parametrize("graph", ABLATION_GRAPHS)
def test_every_graph_can_be_drawn_at_every_size(graph, robots):
    links = graph_from_name(ABLATION_GRAPHS[graph](robots), robots, 1)
    assert links.is_connected
    assert (
        graph == "complete"
        or robots == 6
        or len(links.edges()) < robots * (robots - 1) / 2
    )


def test_loss_costs_time_and_bytes_and_changes_no_plan(rows):
    perfect, lossy = rows
    assert perfect["lost_a_robot"] == 0
    assert lossy["lost_a_robot"] > 0
    assert lossy["communication_s"] > 2.0 * perfect["communication_s"]
    assert lossy["bytes_a_robot"] > perfect["bytes_a_robot"]
    assert lossy["rounds"] == perfect["rounds"]
    assert [row["same_plan"] for row in rows] == [True, True]


def test_without_loss_a_round_takes_the_delay(rows):
    perfect = rows[0]
    assert perfect["communication_s"] == pytest.approx(
        perfect["rounds"] * bench_ablation.ABLATION_STUDY.message_delay, rel=0.1
    )


def test_another_plan_is_told(monkeypatch):
    plans = iter("ab")
    row = {"robots": 4, "graph": "ring", "method": "x", "seed": 1}
    monkeypatch.setattr(
        bench_ablation, "run_case", lambda case: row | {"plan_digest": next(plans)}
    )
    of = [AblationCase("loss", 4, "ring", "x", loss, None, 1) for loss in (0.0, 0.1)]
    assert [row["same_plan"] for row in bench_ablation.run(of)] == [True, False]


def test_a_cell_has_the_median_over_its_seeds(rows):
    more = [rows[0] | {"seed": seed, "rounds": 100 * seed} for seed in (1, 2, 4)]
    (cell,) = bench_ablation.summary(more)
    assert (cell["seeds"], cell["rounds_median"], cell["rounds_most"]) == (
        3,
        200.0,
        400.0,
    )


def test_all_files_are_written(tmp_path, monkeypatch, rows):
    of = [
        AblationCase("loss", 4, "ring", "resource-columns", loss, None, 1)
        for loss in (0.0, 0.2)
    ]
    of += [
        AblationCase("size", n, "ring", "resource-columns", 0.1, None, 1)
        for n in (3, 4)
    ]
    of += [
        AblationCase("method", 4, "ring", method, 0.1, None, 1)
        for method in ("resource-columns", "resource-argmax")
    ]
    monkeypatch.setattr(bench_ablation, "list_cases", lambda quick: of)
    result = bench_paper.run(tmp_path / "paper", quick=True, peers=False)
    assert result["same_plans"]
    for name in result["files"]:
        assert (tmp_path / "paper" / name).stat().st_size > 500
    assert {
        "ablation_runs.csv",
        "ablation.csv",
        "loss.png",
        "size.png",
        "method.png",
    } == set(result["files"])
    with (tmp_path / "paper" / "ablation_runs.csv").open() as file:
        written = list(csv.DictReader(file))
    assert len(written) == len(of)
    assert {row["same_plan"] for row in written} == {"True"}


def test_the_solvers_are_drawn(tmp_path):
    curve = [[0.5, 30.0], [1.0, 24.0]]
    of = [
        (name, seed, tasks)
        for name in ("crazychoir", "VROOM", "MILP")
        for seed in (1, 2)
        for tasks in (5, 20)
    ]
    common = {"robots": 3, "wall_s": 2.0, "curve": curve}
    rows = [
        common
        | {
            "name": name,
            "seed": seed,
            "tasks": tasks,
            "cost": 24.0 + seed,
            "feasible": name != "MILP",
        }
        for name, seed, tasks in of
    ]
    for file in bench_pictures.draw_routing(rows, tmp_path):
        assert file.stat().st_size > 5000


def test_nested_figures_become_columns():
    row = {"size": "small", "cost": {"median": 1.0, "most": 2.0}, "notes": ["a", "b"]}
    assert bench_paper.flatten_row(row) == {
        "size": "small",
        "cost_median": 1.0,
        "cost_most": 2.0,
        "notes": "a; b",
    }
