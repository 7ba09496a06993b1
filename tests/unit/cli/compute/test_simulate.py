"""crazychoir simulate: a user's file, its table, its picture, its errors."""

import csv
import json
import signal
import warnings
from functools import partial

import numpy as np
import pytest
from pages import page
from typer.testing import CliRunner

from crazychoir.cli.compute import simulate as command
from crazychoir.cli.main import app

AVERAGING = """
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.team.graph import metropolis

def agent(i, graph):
    return Consensus(i, [1.0 * i, -i], metropolis(graph)[i], rounds=30)
"""
AWAKE = """
from crazychoir.optimization.algorithms.asynchronous_consensus import AsynchronousConsensus
from crazychoir.team.graph import metropolis

def agent(i, graph):
    return AsynchronousConsensus(i, [1.0 * i], metropolis(graph)[i])
"""
SHARING = """
import numpy as np
from crazychoir.optimization.algorithms.primal_decomposition import AllocatedSolution, PrimalDecomposition
from crazychoir.team.graph import metropolis

class Allocation:  # min (x - i)^2 + 100 rho, x <= y + rho, x >= 0
    def __init__(self, i):
        self.i = float(i)

    def allocate(self, y):
        x = max(0.0, min(self.i, y[0]))
        over = max(0.0, x - y[0])
        mu = 100.0 if over else 2 * max(self.i - x, 0.0)
        return AllocatedSolution((x - self.i) ** 2 + 100 * over, np.array([x]), np.array([mu]), over)

def agent(i, graph):
    return PrimalDecomposition(i, metropolis(graph)[i], Allocation(i), np.array([SHARE]), 0.1, 20)
"""
ENDING = """
from dataclasses import dataclass
import numpy as np
from crazychoir.optimization.rounds.agreement import flood_values
from crazychoir.optimization.rounds.program import Program

@dataclass(frozen=True)
class Found:
    x: np.ndarray
    cost: float
    path: tuple

class Finding(Program):
    def __init__(self, i, diameter):
        self.i, self.diameter = i, diameter
        super().__init__()

    def run(self):
        known = yield from flood_values(self.i, self.i, self.diameter)
        return Found(np.array([self.i, 0.5]), float(sum(known.values())), ((1, "a,b"), None))

def agent(i, graph):
    return Finding(i, graph.diameter())
"""


@pytest.fixture
def simulated(tmp_path, monkeypatch, capfd):
    """The exit code and what is on standard output and error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")

    def run(text, *options):
        (tmp_path / "mine.py").write_text(text)
        result = CliRunner().invoke(app, ["simulate", "mine.py", *map(str, options)])
        assert result.exception is None or isinstance(result.exception, SystemExit), (
            result.exception
        )
        return result.exit_code, result.stdout, result.stderr + capfd.readouterr().err

    return run


def test_it_prints_one_json_object(simulated):
    code, out, _ = simulated(AVERAGING, "--agents", 6, "--loss", 0.3, "--json")
    result = json.loads(out)
    assert code == 0
    assert result["rounds"] == 30
    assert sorted(result["agents"]) == [str(i) for i in range(6)]
    assert result["agents"]["3"]["x"] == pytest.approx([2.5, -2.5], abs=0.05)
    assert result["disagreement"]["x"] < 0.05
    assert result["lost"] == pytest.approx(0.3 * result["messages"], rel=0.3)


def row(text, key):
    """The value beside a figure of the table."""
    found = [
        line.split("│")[2].strip()
        for line in text.splitlines()
        if line.startswith(f"│ {key} ")
    ]
    return found[0] if found else None


def test_an_x_of_each_is_no_disagreement_and_what_is_infeasible_is_told(simulated):
    code, out, err = simulated(SHARING.replace("SHARE", "9.0"), "--json")
    result = json.loads(out)
    assert code == 0, err
    assert result["disagreement"] == {"x": None}
    assert result["violation"] == 0.0
    feasible, infeasible = (
        simulated(SHARING.replace("SHARE", share))[1] for share in ("9.0", "-1.0")
    )
    assert (row(feasible, "disagreement"), row(feasible, "violation")) == (None, "0")
    assert (
        row(infeasible, "violation") == "1, of 10 agents, as 0: their x is not feasible"
    )
    assert row(simulated(AVERAGING)[1], "violation") is None
    assert row(simulated(AVERAGING)[1], "lost") == "0"


def test_without_an_x_its_result_is_the_answer(simulated, tmp_path):
    for suffix in ("csv", "json", "npz"):
        code, out, err = simulated(
            ENDING, "--agents", 4, "--save", f"h.{suffix}", "--json"
        )
        assert code == 0, err
    told = {"x": [3.0, 0.5], "cost": 6.0, "path": [[1, "a,b"], None]}
    assert json.loads(out)["agents"]["3"] == {"result": told}
    assert json.loads((tmp_path / "h.json").read_text())["agents"]["3"] == {
        "result": told
    }
    with np.load(tmp_path / "h.npz") as arrays:
        assert arrays["result.x_3"].tolist() == [3.0, 0.5]
        assert json.loads(str(arrays["result.path_3"])) == told["path"]
    with (tmp_path / "h.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["result.cost"] for row in rows] == ["", "", "6.0"] * 4
    assert (rows[-1]["result.x[0]"], json.loads(rows[-1]["result.path"])) == (
        "3.0",
        told["path"],
    )
    _, out, _ = simulated(ENDING, "--agents", 4)
    assert "at the end" not in out
    assert [cell.strip() for cell in out.splitlines()[-2].split("│")[1:4]] == [
        "3",
        "3, 0.5",
        "6",
    ]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            ("--record", "result"),
            "a Finding, as diameter, i, k. A `result` is kept without it, at the end.",
        ),
        (
            ("--record", "z"),
            "found z; allowed: attributes of agent 0, a Finding, as diameter, i, k.",
        ),
        (
            ("--picture", "p.png"),
            "--picture: found nothing recorded; allowed: what --record names, to draw it",
        ),
    ],
)
def test_what_can_be_recorded_is_listed(simulated, options, said):
    code, _, err = simulated(ENDING, *options)
    assert code == 2
    assert said in " ".join(err.split())
    assert simulated(ENDING, "--record", "k,i", "--picture", "p.png")[0] == 0


def test_its_table_says_how_many_agents_it_does_not_show(simulated):
    code, out, err = simulated(AVERAGING, "--agents", 23)
    assert code == 0, err
    assert "and 3 more agents" in out
    assert "19 " in out
    assert "more agents" not in simulated(AVERAGING, "--agents", 20)[1]


@pytest.mark.parametrize(
    ("text", "options"),
    [(AVERAGING, ()), (AWAKE, ("--rounds", 40, "--graph", "complete"))],
)
def test_it_writes_histories_and_a_picture(simulated, tmp_path, text, options):
    code, _, err = simulated(
        text, *options, "--save", "out/h.npz", "--picture", "out/p.png", "--seed", 3
    )
    assert code == 0, err
    assert (tmp_path / "out/p.png").read_bytes()[:4] == b"\x89PNG"
    with np.load(tmp_path / "out/h.npz") as arrays:
        assert len(arrays["x_0"]) == len(arrays["time_0"]) > 30


def test_a_picture_of_agents_that_agree_from_the_start_is_drawn(simulated, tmp_path):
    with warnings.catch_warnings(action="error"):
        code, _, err = simulated(
            AVERAGING.replace("[1.0 * i, -i]", "[0.0]"), "--picture", "p.png"
        )
    assert code == 0, err
    assert (tmp_path / "p.png").exists()


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        (
            "x = 1",
            (),
            "no function agent(i, graph); allowed: a file that defines agent(i, graph)",
        ),
        ("def agent(i): pass", (), "found def agent(i); allowed: def agent(i, graph)"),
        (
            "def agent(i, graph): return 3",
            (),
            "int for agent 0, without message, step, done; allowed: an agent: message(), step(heard), done",
        ),
        (
            "def agent(i, graph):\n    return {}[i]",
            (),
            "mine.py:2: agent(i, graph): found KeyError: 0",
        ),
        (AVERAGING, ("--graph", "rink"), "graph: found rink"),
        (
            AVERAGING,
            ("--record", "y"),
            "record: found y; allowed: attributes of agent 0, a Consensus",
        ),
        (
            AVERAGING,
            ("--save", "h.txt"),
            "--save: found h.txt; allowed: a file that ends in .csv, .json, .npz",
        ),
        (
            AVERAGING.replace("metropolis(graph)[i]", "{i: 0.5}"),
            (),
            "agent 0: weights = {0: 0.5}: they sum to 0.5",
        ),
        (AVERAGING + "    ) + (\n", (), "a file that Python can import"),
    ],
)
def test_what_is_wrong_is_said_with_exit_code_2(simulated, text, options, said):
    code, _, err = simulated(text, *options)
    assert code == 2
    assert said in " ".join(err.split())


@pytest.mark.parametrize(
    ("option", "name"), [("--save", "a.csv"), ("--picture", "a.png")]
)
def test_one_folder_is_made_for_a_file_and_no_more(simulated, tmp_path, option, name):
    code, _, err = simulated(AVERAGING, option, tmp_path / "mistyped" / "out" / name)
    assert code == 2
    assert (
        f"{option}: found {tmp_path}/mistyped/out/{name}; allowed: a name in a folder"
        in " ".join(err.split())
    )
    assert not (tmp_path / "mistyped").exists()
    code, _, err = simulated(AVERAGING, option, tmp_path / "out" / name)
    assert code == 0, err
    assert (tmp_path / "out" / name).exists()


@pytest.mark.parametrize(
    "text",
    [
        "def agent(i): pass",
        "def agent(i, graph): return 3",
        "def agent(i, graph):\n    return {}[i]",
    ],
)
def test_an_error_of_an_algorithm_says_so_and_where_algorithms_are_explained(
    simulated, text
):
    _, _, err = simulated(text)
    said = " ".join(err.split())
    assert "ConfigError: algorithm " in said
    assert "mission" not in said
    chapter = "A new distributed algorithm"
    file = "crazychoir/optimization/README.md"
    assert said.endswith(f'See "{chapter}" in {file}.')
    assert f"\n## {chapter}\n" in page(file)


def test_what_a_users_step_raises_is_named_with_its_line(simulated):
    text = (
        AVERAGING
        + "\nclass Bad(Consensus):\n    def step(self, heard):\n        heard['x']\n"
    )
    code, out, _ = simulated(
        text.replace("return Consensus", "return Bad"), "--json", "--loss", 0.2
    )
    result = json.loads(out)
    assert code == 2
    assert result["kind"] == "AgentFailed"
    assert result["error"].endswith(
        "KeyError: 'x' (mine.py:10); it had heard float64 (2,) from 1, 9"
    )


def test_a_failing_step_names_the_senders_of_what_it_had_heard(simulated):
    text = (
        AVERAGING
        + "\nclass Mute(Consensus):\n    def message(self):\n        if self.i != 3: return self.x\n"
    )
    text += "    def step(self, heard):\n        self.x = 0.5 * self.x + sum(heard.values()) / 4\n"
    code, _, err = simulated(
        text.replace("return Consensus", "return Mute"), "--loss", 0.2
    )
    assert code == 2
    assert "agent 2 has failed" in err
    assert "it had heard None from 3, float64 (2,) from 1" in " ".join(err.split())


FOR_EVER = (
    AVERAGING.replace("rounds=30", "rounds=None").replace(
        "return Consensus", "return Endless"
    )
    + """
import signal

class Endless(Consensus):
    def step(self, heard):
        super().step(heard)
        if (self.i, self.k) == (3, 50):
            signal.raise_signal(signal.SIGINT)
"""
)


@pytest.mark.parametrize("asynchronous", [False, True])
def test_on_ctrl_c_there_is_what_there_is(simulated, tmp_path, asynchronous, request):
    request.addfinalizer(
        partial(signal.signal, signal.SIGINT, signal.getsignal(signal.SIGINT))
    )
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a loop of an earlier test may have left its own
    text = (
        FOR_EVER.replace("    def step", "    asynchronous = True\n    def step")
        if asynchronous
        else FOR_EVER
    )
    if asynchronous:
        text = text.replace("super().step(heard)", "self.k += 1")
    code, out, err = simulated(text, "--save", "h.csv", "--picture", "p.png", "--json")
    result = json.loads(out)
    assert code == 130, err
    assert (result["success"], result["kind"]) == (False, "KeyboardInterrupt")
    assert 49 <= result["rounds"] <= 51 + 50 * asynchronous
    assert result["messages"] > 500
    rows = (tmp_path / "h.csv").read_text().splitlines()[1:]
    assert [row for row in rows if row.startswith("3,50,")]
    assert (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"
    code, out, err = simulated(text)
    assert code == 130
    assert row(out, "rounds") == str(result["rounds"])
    assert err.endswith("Ctrl-C: the run ends here, with the rounds so far\n")


def test_a_long_run_says_now_and_then_how_far_it_is(simulated, monkeypatch):
    monkeypatch.setattr(command, "FIRST_PROGRESS_DELAY", 1e-3)
    said = [
        line
        for line in simulated(AVERAGING, "--agents", 20)[2].splitlines()
        if line.startswith("round ")
    ]
    assert 1 <= len(said) < 15
    assert said[-1].endswith(", --rounds limits them, Ctrl-C ends the run")
    rounds = [int(line.split(",")[0].split()[1]) for line in said]
    assert rounds == sorted(rounds)
    assert rounds[-1] <= 30
    assert ", of at most 30" in simulated(AVERAGING, "--agents", 20, "--rounds", 30)[2]
    monkeypatch.undo()
