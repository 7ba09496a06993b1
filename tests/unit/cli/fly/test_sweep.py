"""`crazychoir sweep`: its options, its tables, and how it ends on Ctrl-C."""

import json

import pytest
from typer.testing import CliRunner

from crazychoir import api
from crazychoir.api.sweeps import SweepInterrupted
from crazychoir.api.table import Table
from crazychoir.cli.fly.sweep import parse_values
from crazychoir.cli.main import app
from crazychoir.errors import ConfigError

ROWS = [
    {
        "loss": loss,
        "seed": seed,
        "success": seed != 2,
        "reason": None if seed != 2 else "late",
        "settling_s": float(seed),
    }
    for loss in (0.0, 0.2)
    for seed in (1, 2, 3)
]


@pytest.fixture
def asked(monkeypatch):
    """What the command asks the Python interface for; it returns ROWS."""
    calls = {}

    def sweep(mission, **values):
        calls.update(values, mission=mission)
        if mission == "interrupted":
            raise SweepInterrupted(Table(ROWS[:2], ["loss", "seed"]))
        if mission == "interrupted at once":
            raise KeyboardInterrupt
        return Table(ROWS, ["loss", "seed"])

    monkeypatch.setattr(api, "sweep", sweep)
    return calls


def run(*words):
    return CliRunner().invoke(app, ["sweep", *map(str, words)])


def test_the_command_asks_for_each_value(asked, tmp_path):
    csv = tmp_path / "out.csv"
    words = ("--seeds", "1-3", "--loss", "0,0.2", "--drones", "4,6", "--jobs", "2")
    done = run("figure", *words, "--set", "laps=1,2", "--csv", csv)
    assert done.exit_code == 0, done.output
    assert asked == {
        "mission": "figure",
        "seeds": [1, 2, 3],
        "loss": [0.0, 0.2],
        "drones": [4, 6],
        "options": {"laps": [1, 2]},
        "jobs": 2,
        "file": tmp_path / "out.runs.jsonl",
    }
    assert csv.read_text().splitlines()[1] == "0.0,1,True,,1.0"


def test_medians_and_failures_are_printed(asked):
    text = run("figure").stdout
    assert "loss 0.0" in text
    assert "2 of 3" in text
    assert "2 (1.5–2.5)" in text
    assert "2 failed: late" in text


def test_json_has_the_rows_and_the_summary(asked):
    told = json.loads(run("figure", "--json").stdout)
    assert told["rows"] == ROWS
    assert told["runs"] == 6
    assert told["summary"][1]["settling_s_median"] == 2.0


def test_ctrl_c_says_how_the_sweep_goes_on(asked, tmp_path):
    file = tmp_path / "a.jsonl"
    file.write_text("{}\n" * 5)
    done = run("interrupted", "--file", file)
    assert done.exit_code == 130
    kept = f"2 runs are kept in {file}: the same command goes on"
    assert kept in done.stderr, "not the lines of other sweeps"
    assert "1.5 (1.25–1.75)" in done.stdout
    assert "name --csv or --file" in run("interrupted at once").stderr
    told = json.loads(run("interrupted", "--json").stdout)
    assert told["rows"] == ROWS[:2]
    assert told["success"] is False


def test_a_picture_shows_a_figure_over_the_input_that_varies(asked, tmp_path):
    file = tmp_path / "a.svg"
    assert run("figure", "--picture", file).exit_code == 0
    text = file.read_text()
    assert "<!-- loss -->" in text
    assert "<!-- settling [s] -->" in text
    done = run("figure", "--picture", file, "--figure", "cost")
    assert done.exit_code == 1
    assert "Not written: --picture: column: found cost" in done.stderr


def test_a_figure_without_a_picture_is_refused_before_anything_flies(asked):
    done = run("figure", "--figure", "settling_s")
    assert done.exit_code == 2
    assert "--figure: found settling_s; allowed: a figure for --picture" in done.stderr
    assert not asked


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("gain=1,2.5", [1, 2.5]),
        ("law=paper,normalised", ["paper", "normalised"]),
        ("at=[0,1],[2,3]", [[0, 1], [2, 3]]),
        ("on=true", [True]),
        ("mixed=paper,2", ["paper", 2]),
    ],
)
def test_values_of_an_option_are_read(text, values):
    assert parse_values(text) == (text.partition("=")[0], values)


@pytest.mark.parametrize("text", ["gain", "=1", "gain="])
def test_an_option_without_name_or_value_is_refused(text):
    with pytest.raises(ConfigError, match=r"--set: found .*allowed: NAME=V1,V2"):
        parse_values(text)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--seeds", "5-1"), "--seeds"),
        (("--loss", "much"), "--loss"),
        (("--csv", "out.txt"), "--csv"),
    ],
)
def test_wrong_options_are_refused(asked, words, said):
    done = run("figure", *words)
    assert done.exit_code == 2
    assert said in done.stderr
