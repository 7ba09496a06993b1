"""Algorithms side by side: the problems, the choice of the step, the files, and what is refused."""

import csv

import numpy as np
import pytest

from crazychoir.bench.convergence import convergence as bench_convergence
from crazychoir.bench.convergence.contenders import (
    ALL_CONTENDERS,
    DEFAULT_CHOICE,
    choose_contenders,
)
from crazychoir.bench.convergence.convergence import ComparisonChoice
from crazychoir.bench.convergence.pictures import line_style
from crazychoir.bench.convergence.study import (
    Case,
    Curve,
    StudyRequest,
    choose_scale,
    list_cases,
    run_once,
)
from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.shared_problem import (
    PROBLEM_NAMES,
    PROBLEM_SHAPE,
    SharedProblem,
    make_problem,
)

OWN = """
class Descent:
    done = False

    def __init__(self, i, x, weights, gradient, step):
        self.i, self.x, self.weights, self.gradient, self.a = i, x, weights, gradient, step

    def message(self):
        return self.x

    def step(self, heard):
        mixed = sum(self.weights[j] * x for j, x in {**heard, self.i: self.x}.items())
        self.x = mixed - self.a * self.gradient(self.x)

def of_two(i, graph):
    return None

def nothing(i, x, weights, gradient, step):
    return None
"""
REQUEST = StudyRequest("least-squares", rounds=60, seeds=2, accuracy=1e-2)


@pytest.fixture
def own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    return tmp_path


@pytest.mark.parametrize("name", PROBLEM_NAMES)
def test_a_kept_problem_cannot_be_changed(name):
    problem = make_problem(name, 4, 2)
    assert make_problem(name, 4, 2) is problem
    for array in (problem.rows, problem.values, problem.smoothness, problem.optimum):
        with pytest.raises(ValueError, match="read-only"):
            array += 1.0


@pytest.mark.parametrize("name", PROBLEM_NAMES)
def test_a_problem_knows_its_optimum_and_its_constants(name):
    problem = SharedProblem(name, 3, 1)
    total = sum(problem.gradient(i, problem.optimum) for i in range(3))
    assert np.abs(total).max() < 1e-9
    chance = np.random.default_rng(2)
    for i in range(3):
        x, y = chance.normal(size=(2, PROBLEM_SHAPE.entries))
        change = problem.gradient(i, x) - problem.gradient(i, y)
        assert np.linalg.norm(change) <= problem.smoothness[i] * np.linalg.norm(x - y)
        assert change @ (x - y) >= problem.modulus * (x - y) @ (x - y)
        samples = range(PROBLEM_SHAPE.samples)
        mean = np.mean([problem.sample_gradient(i, x, s) for s in samples], axis=0)
        assert mean == pytest.approx(problem.gradient(i, x), abs=1e-12)


@pytest.mark.parametrize("name", PROBLEM_NAMES)
def test_a_local_problem_in_cvxpy_is_the_cost_of_the_gradient(name):
    problem = SharedProblem(name, 2, 3)
    x = problem.local(1).argmin()
    assert np.abs(problem.gradient(1, x)).max() < 1e-5


@pytest.mark.parametrize("name", ALL_CONTENDERS)
def test_each_algorithm_comes_nearer_to_the_optimum(name):
    curve = run_once(ALL_CONTENDERS[name], Case(3, "path", 0.0), REQUEST, 0.25, 1)
    assert curve.error[0] <= 1.0  # NIDS has made a step before its first message
    assert curve.error[-1] < 0.5 * curve.error[0]
    assert len(curve.error) == len(curve.messages) == 61
    assert (np.diff(curve.sent_bytes) >= 0.0).all()


def test_the_step_with_the_least_error_is_chosen():
    request = StudyRequest("least-squares", rounds=60, seeds=1, accuracy=1e-2)
    scale = choose_scale(ALL_CONTENDERS["extra"], Case(3, "path", 0.4), request)
    assert 0.1 < scale < 2.0


def test_an_effort_ends_where_the_error_stays_below_the_accuracy():
    counts = np.arange(5.0)
    curve = Curve(np.array([1.0, 0.01, 0.2, 0.05, 0.01]), counts, 10.0 * counts)
    found = {"rounds": 3.0, "messages_an_agent": 3.0, "bytes_an_agent": 30.0}
    assert curve.find_effort(0.1) == found
    assert set(curve.find_effort(1e-3).values()) == {np.inf}


def test_the_first_case_is_the_base_and_the_others_vary_alone():
    assert list_cases((8, 16), ("ring", "complete"), (0.0, 0.4)) == [
        Case(8, "ring", 0.0),
        Case(8, "ring", 0.4),
        Case(8, "complete", 0.0),
        Case(16, "ring", 0.0),
    ]


def test_tables_and_pictures_show_all_algorithms_also_a_users_own(own, monkeypatch):
    monkeypatch.setattr("crazychoir.recording.analysis.plots.PICTURE_FORMATS", ("png",))
    choice = ComparisonChoice(("extra", "own.py:Descent"), (3,), ("path",), (0.0, 0.4))
    said = []
    result = bench_convergence.run(own / "out", REQUEST, choice, say=said.append)
    assert len(said) == 4
    for file in result["files"]:
        assert (own / "out" / file).stat().st_size > 0
    assert {"error.png", "effort.png"} <= set(result["files"])
    with (own / "out" / "summary.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = ["extra", "own.py:Descent"]
    assert [row["algorithm"] for row in rows] == 2 * names
    calm, lossy = rows[0], rows[2]
    assert calm["rounds_median"] == lossy["rounds_median"]  # the iterates are the same
    sent = "messages_an_agent_median"
    assert float(lossy[sent]) > 1.2 * float(calm[sent])
    assert float(calm["last_error_median"]) < 1e-3
    assert float(rows[1]["last_error_median"]) > float(calm["last_error_median"])
    table, below = bench_convergence.table(result).renderables
    assert table.row_count == 2
    assert "failed" not in below.plain
    result["rows"][2]["failed"] = 1
    result["rows"][2]["failure"] = "It grew."
    _, below = bench_convergence.table(result).renderables
    assert "EXTRA: 1 of 2 runs failed: 3 agents, path, 40% lost. It grew" in below.plain


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("extr",), "--algorithms: found extr; allowed: gradient-tracking"),
        (("extra", "extra"), "found extra twice"),
        ((), "found no name"),
        (("none.py:A",), "found none.py; allowed: a Python file that exists"),
        (("own.py:Asent",), "a name that own.py defines: Descent, of_two, nothing"),
        (("own.py:of_two",), r"def of_two\(i, x, weights, gradient, step\)"),
    ],
)
def test_an_algorithm_that_is_not_there_is_refused_with_what_is(own, names, said):
    with pytest.raises(ConfigError, match=said):
        choose_contenders(names, "least-squares")


def test_a_users_function_that_returns_no_agent_is_named(own):
    choice = ComparisonChoice(("own.py:nothing",), (3,), ("path",), (0.0,))
    with pytest.raises(ConfigError, match="NoneType for agent 0, without message"):
        bench_convergence.run(own / "out", REQUEST, choice)


def test_a_graph_that_does_not_fit_is_refused_before_anything_is_computed(own):
    choice = ComparisonChoice(("extra",), (3, 4), ("ring", "k-regular:3"), (0.0,))
    with pytest.raises(ConfigError, match="--graph"):
        bench_convergence.run(own / "out", REQUEST, choice, say=pytest.fail)


def test_the_default_choice_leaves_out_what_is_slow_on_a_problem():
    names = [one.name for one in choose_contenders(None, "logistic")]
    assert set(DEFAULT_CHOICE) - set(names) == {"admm", "relaxed-admm"}


def test_each_line_of_a_picture_has_a_style_of_its_own():
    styles = {str(line_style(number)) for number in range(len(ALL_CONTENDERS) + 10)}
    assert len(styles) == len(ALL_CONTENDERS) + 10
