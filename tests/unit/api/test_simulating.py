"""Simulations from Python: each form of an algorithm, and errors."""

from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.api import simulate
from crazychoir.errors import ConfigError
from crazychoir.team.graph import metropolis, ring

ALGORITHM = """
import numpy as np
from crazychoir.team.graph import metropolis

class Average:
    def __init__(self, i, weights):
        self.i, self.weights, self.x, self.left = i, weights, float(i), 30

    @property
    def done(self):
        return self.left == 0

    def message(self):
        return self.x

    def step(self, heard):
        own = self.weights[self.i] * self.x
        self.x = own + sum(self.weights[j] * heard[j] for j in heard)
        self.left -= 1

def agent(i, graph):
    return Average(i, metropolis(graph)[i])
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("algorithm") / "average.py"
    path.write_text(ALGORITHM)
    return path


@pytest.fixture(scope="module")
def own(file):
    """The names of the file, as if a cell had defined them."""
    names = {}
    exec(compile(ALGORITHM, "a cell", "exec"), names)  # noqa: S102 - it is the text above
    return SimpleNamespace(**names)


def test_each_form_of_an_algorithm_gives_one_history(file, own):
    graph = ring(4)
    weights = metropolis(graph)
    forms = [
        simulate(file, "ring", 4),
        simulate(str(file), graph),
        simulate(own.agent, graph, loss=0.4, seed=3),
        simulate(own, graph),
        simulate({i: own.Average(i, weights[i]) for i in range(4)}, graph),
    ]
    for run in forms:
        assert np.array_equal(run.of(), forms[0].of())
        assert run.last()[2] == pytest.approx(1.5, abs=1e-6)
    assert [run.lost > 0 for run in forms] == [False, False, True, False, False]


def test_rounds_and_recorded_names_are_chosen(own):
    run = simulate(own.agent, "ring", 4, rounds=5, record=["left"])
    assert run.rounds == 5
    assert run.last("left")[0] == 25


def test_a_simulation_is_drawn(own):
    run = simulate(own.agent, "ring", 4)
    figure = run.plot()
    above, _ = figure.axes
    assert len(above.lines) == 4
    assert figure._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match=r"plot: found y; allowed: .*x"):
        run.plot("y")


@pytest.mark.parametrize(
    ("algorithm", "said"),
    [
        (3, "no function agent"),
        ("none.py", "a Python file that exists"),
        (lambda i, graph: i, "found int for agent 0, without message, step, done"),
        (lambda i: i, r"def agent\(i, graph\)|found def"),
    ],
    ids=["number", "no file", "no agent", "other arguments"],
)
def test_what_is_no_algorithm_is_refused(algorithm, said):
    with pytest.raises(ConfigError, match=said):
        simulate(algorithm, "ring", 4)


def test_a_simulation_is_shown_in_one_line(file):
    run = simulate(file, "ring", 4)
    assert repr(run) == (
        "<Simulation of 4 agents: 30 rounds, 280 messages, recorded: x>"
    )
