"""`crazychoir validate` on two real flights: table, JSON, picture and errors."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app

FOLDER = Path(__file__).resolve().parents[3] / "data" / "realflight"
FLIGHTS = [
    str(FOLDER / "B2_circle_fast_rep3.npz"),
    str(FOLDER / "B7_oval_slow_rep3.npz"),
]


@pytest.fixture
def validate():
    def run(*arguments):
        return CliRunner().invoke(app, ["validate", *arguments])

    return run


def test_the_table_shows_models_and_flights(validate):
    done = validate(*FLIGHTS)
    assert done.exit_code == 0
    for words in ("simulator as it is", "physical set", "B7_oval_slow_rep3", "Trims:"):
        assert words in done.stdout


def test_the_answer_has_the_errors_of_each_model_and_flight(validate, tmp_path):
    picture = tmp_path / "errors.png"
    done = validate(*FLIGHTS, "--json", "--picture", str(picture))
    answer = json.loads(done.stdout)
    assert answer["success"]
    assert answer["windows"] == 135
    assert picture.read_bytes().startswith(b"\x89PNG")
    models = answer["models"]
    late = {name: times["0.5"]["rmse"] for name, times in models.items()}
    assert late["simulator as it is"]["position_mm"] > 600
    assert late["fitted set, trims of the last 0.36 s"]["position_mm"] < 50
    assert late["fitted set, trims of the last 0.36 s"]["attitude_deg"] < 7
    flight = answer["flights"]["B2_circle_fast_rep3"]
    assert flight["windows"] == 68
    assert flight["share_in_gaps"] == 0.0
    assert flight["position_mm_after_0.5_s"]["velocity and rates stay"] > 100


def test_a_fit_of_one_flight_is_refused_before_it_begins(validate):
    done = validate(FLIGHTS[0], "--fit", "--json")
    assert done.exit_code == 2
    assert "two flights or more" in json.loads(done.stdout)["error"]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["none.npz"], "none.npz"),
        (["lab.toml"], "crazychoir doctor --swarm lab.toml checks a swarm file"),
        ([FLIGHTS[0], "--platform", "cf99"], "--platform"),
        ([FLIGHTS[0], "--picture", "a.txt"], "--picture"),
    ],
)
def test_what_cannot_be_compared_is_refused(validate, arguments, reason):
    done = validate(*arguments, "--json")
    assert done.exit_code == 2
    assert reason in json.loads(done.stdout)["error"]


def test_the_filters_are_scored_on_the_recorded_poses(validate):
    done = validate(*FLIGHTS, "--filters")
    assert done.exit_code == 0
    for words in ("kalman, no commands", "200 ms", "B7_oval_slow_rep3", "240"):
        assert words in done.stdout
    answer = json.loads(validate(*FLIGHTS, "--filters", "--json").stdout)
    assert answer["success"]
    assert answer["flights"] == ["B2_circle_fast_rep3", "B7_oval_slow_rep3"]
    errors = {
        (row["filter"], row["rate_hz"], row["gaps"]): row for row in answer["filters"]
    }
    assert len(errors) == 4 * 3 * 3
    row = errors["kalman, no commands", 100, "no gaps"]
    assert row["velocity_mm_s"] < 10.0
    assert len(row["velocity_mm_s_of_flights"]) == 2


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["none.npz", "--filters"], "none.npz"),
        ([FLIGHTS[0], "--filters", "--fit"], "--fit beside it"),
        ([FLIGHTS[0], "--filters", "--picture", "a.png"], "--picture beside it"),
        ([FLIGHTS[0], "--filters", "--paths", "a.png"], "--paths beside it"),
        ([FLIGHTS[0], "--filters", "--platform", "cf99"], "--platform"),
    ],
)
def test_filters_that_cannot_be_scored_are_refused(validate, arguments, reason):
    done = validate(*arguments, "--json")
    assert done.exit_code == 2
    assert reason in json.loads(done.stdout)["error"]
