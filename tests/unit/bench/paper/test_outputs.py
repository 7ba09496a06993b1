"""Every command that writes beside its answer: places are checked first, and the answer is printed whatever they do."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from crazychoir.bench.paper import ablation as bench_ablation
from crazychoir.cli.main import app
from crazychoir.launch import console as show

FULL = Path("/dev/full")
ALGORITHM = """
import numpy as np

class Averaging:
    def __init__(self, i):
        self.x = np.array([float(i)])
        self.grown = np.zeros(1)
        self.words = "none"
        self.k = 0

    @property
    def done(self):
        return self.k == 3

    def message(self):
        return self.x

    def step(self, heard):
        self.x = (self.x + sum(heard.values())) / (1 + len(heard))
        self.k += 1
        self.grown = np.zeros(1 + self.k)

def agent(i, graph):
    return Averaging(i)
"""


@pytest.fixture
def files(tmp_path, monkeypatch, repository):
    """A folder of inputs, and of places that cannot be written, in which commands run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lab.json").write_text(
        (repository / "tests" / "data" / "pickup_delivery_flat.json").read_text()
    )
    (tmp_path / "algorithm.py").write_text(ALGORITHM)
    for ending in ("png", "csv", "json", "npz"):
        (tmp_path / f"folder.{ending}").mkdir()
        (tmp_path / f"full.{ending}").symlink_to(FULL)
    (tmp_path / "file").write_text("kept")
    return tmp_path


def ran(*words):
    """Exit code, the JSON answer, and what was said aside, of a command."""
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exception is None or isinstance(done.exception, SystemExit), (
        done.exception
    )
    return done.exit_code, json.loads(done.stdout), done.stderr


SOLVE = ("solve", "lab.json", "--picture")
SAVE = ("simulate", "algorithm.py", "--save")
DRAW = ("simulate", "algorithm.py", "--picture")
RUN = ("run", "figure", "--fast", "--picture")
RECORD = ("run", "figure", "--fast", "--record")
SURVEY = ("radio", "survey", "--simulated", "1", "--picture")
PAPER = ("bench", "paper", "--quick", "--out")
COMPUTATIONS = (
    "crazychoir.solve.solving.solve_here",
    "crazychoir.solve.simulate.simulate",
    "crazychoir.api.flying.fly_fast",
    "crazychoir.radio.survey.survey.run_survey",
    "crazychoir.bench.paper.ablation.run",
)


@pytest.mark.parametrize(
    ("words", "places"),
    [
        (
            SOLVE,
            (
                "folder.png",
                "file/x.png",
                "a/b/x.png",
                "x.txt",
                "file",
                "-",
                ".",
                f"{'x' * 300}.png",
            ),
        ),
        (
            SAVE,
            (
                "folder.csv",
                "folder.json",
                "folder.npz",
                "file/x.csv",
                "a/b/x.csv",
                "x.png",
                "file",
                "-",
                ".",
            ),
        ),
        (DRAW, ("folder.png", "file/x.png", "a/b/x.png", "x.csv", "-")),
        (RUN, ("folder.png", "file/x.png", "a/b/x.png", "x.gif", "-")),
        (RECORD, ("folder.csv", "file/x.mcap", "x.bag", "-")),
        (SURVEY, ("folder.png", "file/x.png", "a/b/x.png", "x.gif", "-")),
        (PAPER, ("file", "file/below", f"{'x' * 300}")),
    ],
)
def test_a_place_that_cannot_be_written_is_said_before_anything_is_computed(
    files, monkeypatch, words, places
):
    def compute(*arguments, **options):
        raise AssertionError("it was computed first")

    for name in COMPUTATIONS:
        monkeypatch.setattr(name, compute)
    for place in places:
        done = CliRunner().invoke(app, [*words, place])
        assert done.exit_code == 2, (place, done.exception)
        assert words[-1] in done.stderr
        assert place[:60] in done.stderr.replace("\n", "")
    assert (files / "file").read_text() == "kept"


@pytest.mark.skipif(
    not FULL.exists(), reason="no /dev/full here, which is a disk without room"
)
@pytest.mark.parametrize(
    ("words", "place", "answer"),
    [
        (SOLVE, "full.png", "cost"),
        (SAVE, "full.csv", "rounds"),
        (SAVE, "full.json", "rounds"),
        (SAVE, "full.npz", "rounds"),
        (DRAW, "full.png", "rounds"),
        ((*SURVEY[:-1], "--passes", "1", "--picture"), "full.png", "chosen"),
    ],
)
def test_a_disk_that_fills_loses_no_answer(files, words, place, answer):
    code, told, aside = ran(*words, place)
    assert code == 1
    assert answer in told
    assert "No space left" in told["not_written"][words[-1]]
    assert "No space left" in aside


def test_values_that_cannot_be_drawn_or_saved_lose_no_answer(files):
    code, told, _ = ran(
        "simulate", "algorithm.py", "--record", "words", "--picture", "x.png"
    )
    assert (code, told["rounds"], list(told["not_written"])) == (1, 3, ["--picture"])
    code, told, _ = ran(
        "simulate",
        "algorithm.py",
        "--record",
        "grown",
        "--save",
        "x.npz",
        "--picture",
        "x.png",
    )
    assert (code, told["rounds"], list(told["not_written"])) == (
        1,
        3,
        ["--save", "--picture"],
    )
    assert not (files / "x.npz").exists()
    assert not (files / "x.png").exists()


def test_any_failure_of_a_picture_leaves_the_plan(files, monkeypatch):
    def fail(*arguments):
        raise RuntimeError("no font")

    monkeypatch.setattr("crazychoir.routing.instance.picture.draw_routes", fail)
    code, told, aside = ran(*SOLVE, "x.png")
    assert (code, told["feasible"]) == (1, True)
    assert told["not_written"] == {"--picture": "RuntimeError: no font"}
    assert "Not written: --picture: RuntimeError: no font" in aside
    done = CliRunner().invoke(app, [*SOLVE, "x.png"])
    assert "cost" in done.stdout
    assert done.exit_code == 1


def test_a_picture_that_a_mission_does_not_draw_leaves_the_flight_and_is_said(
    files, monkeypatch
):
    def nothing(*arguments):
        pass

    monkeypatch.setattr("crazychoir.agents.figure.picture", nothing)
    (files / "x.png").write_text("of an earlier flight")
    code, told, _ = ran(*RUN, "x.png")
    assert code == 1
    assert told["success"]
    assert told["picture"] is None
    assert "x.png, which was not drawn" in told["not_written"]["--picture"]


def test_what_is_asked_for_is_written_and_no_word_is_said_of_it(files):
    for words, place in ((SOLVE, "new/x.png"), (SAVE, "x.CSV"), (DRAW, "x.PDF")):
        code, told, _ = ran(*words, place)
        assert code == 0
        assert "not_written" not in told
        assert (files / place).stat().st_size > 0


def test_the_tables_of_the_paper_are_not_computed_for_a_file(files, monkeypatch):
    monkeypatch.setattr(
        bench_ablation, "run", lambda *arguments: pytest.fail("it was computed first")
    )
    assert CliRunner().invoke(app, [*PAPER, "file"]).exit_code == 2


@pytest.mark.skipif(
    not FULL.exists(), reason="no /dev/full here, which is a disk without room"
)
def test_an_answer_that_standard_output_does_not_take_goes_to_standard_error(
    monkeypatch, capsys
):
    with FULL.open("w") as full:
        monkeypatch.setattr(show.sys, "stdout", full)
        with pytest.raises(show.typer.Exit) as ended:
            show.write_json({"cost": 3.5})
    assert ended.value.exit_code == 1
    said = capsys.readouterr().err
    assert "No space left" in said
    assert '{"cost": 3.5}' in said
