"""`crazychoir missions` lists what can be flown, and the options of a mission."""

import json

import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.guidance.mission import list_mission_names


@pytest.fixture
def said():
    """What the command prints, with its exit code."""

    def say(*words):
        done = CliRunner().invoke(app, ["missions", *words])
        return done.exit_code, done.stdout

    return say


def test_all_missions_are_listed_with_a_line_each(said):
    code, text = said("--json")
    found = json.loads(text)
    assert code == 0
    assert list(found) == list_mission_names()
    assert all(line and line.endswith(".") for line in found.values())
    assert found["mpc"] in " ".join(said()[1].split())


def test_the_options_of_a_mission_are_listed(said):
    code, text = said("containment", "--json")
    found = json.loads(text)
    options = {entry["option"]: entry for entry in found["mission_options"]}
    assert code == 0
    assert found["mission"] == "containment"
    assert options["kp"] == {
        "option": "kp",
        "value": "a gain, above 0, at most 1000",
        "default": 0.8,
        "meaning": "1/s2: gain of the positions.",
    }
    assert options["leaders"]["meaning"] == "What the leaders do."
    assert [entry["option"] for entry in found["drone_options"]] == ["height"]


def test_a_mission_without_options_says_so(said):
    assert "[mission_options]: none" in said("unicycles")[1]


def test_the_table_of_options_has_units_and_defaults(said):
    text = " ".join(said("mpc")[1].split())
    for words in ("jerk", "4.0", "m/s3: largest", "options of a drone:"):
        assert words in text


def test_an_unknown_mission_is_refused(said):
    assert said("mpk")[0] != 0


def test_run_and_missions_come_first_in_the_help():
    text = CliRunner().invoke(app, ["--help"]).stdout
    places = [text.index(word) for word in ("Fly", " run ", " missions ", "Operate a")]
    assert places == sorted(places)
