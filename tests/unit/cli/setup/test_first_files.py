"""`crazychoir new` and `crazychoir examples`: files of a user to begin with."""

import json

import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission, resolve_example
from crazychoir.launch.flight import fly_fast


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def invoke(*words, code=0):
    said = CliRunner().invoke(app, words)
    assert said.exit_code == code, said.output
    return said.output


def test_new_files_fly_at_once(folder):
    written = json.loads(invoke("new", "my_law", "--json"))["written"]
    assert written == ["my_law.py", "my_law.toml"]
    config = SwarmConfig.load("my_law.toml").with_network(loss=0.3)
    result = fly_fast(config, load_mission(config.mission))
    assert result["success"], result["reasons"]
    assert result["spread_m"] < 0.01


def test_new_overwrites_nothing(folder):
    (folder / "my_law.toml").write_text("mine")
    assert "Nothing was written" in invoke("new", "my_law", code=2)
    assert (folder / "my_law.toml").read_text() == "mine"
    assert not (folder / "my_law.py").exists()


@pytest.mark.parametrize("name", ["my-law", "2laws", "a/b", "gesetz_ü"])
def test_new_refuses_a_name_that_is_no_name_of_a_module(folder, name):
    assert "letters, digits and _" in " ".join(invoke("new", name, code=2).split())
    assert list(folder.iterdir()) == []


def test_examples_are_listed_shown_and_copied(folder):
    assert "lab6" in json.loads(invoke("examples", "--json"))
    assert 'name = "lab6"' in invoke("examples", "lab6")
    assert "crazychoir run formation_drawn.toml" in invoke(
        "examples", "formation_drawn", "--copy"
    )
    assert sorted(file.name for file in folder.iterdir()) == [
        "circle.csv",
        "formation_drawn.toml",
    ]
    assert "file of this name" in invoke(
        "examples", "formation_drawn", "--copy", code=2
    )


def test_run_finds_an_example_by_its_name_and_a_mission_before_it():
    assert resolve_example("lab6").endswith("lab6.toml")
    assert resolve_example("crossing") == "crossing"
    assert resolve_example("nothing") == "nothing"


def test_misspelt_mission_or_example_is_refused_with_the_name_that_was_meant(folder):
    assert "mean bearing_formation?" in invoke("run", "bearing_formatoin", code=2)
    assert "mean grid30?" in invoke("run", "grid_30", code=2)
    (folder / "my_law.toml").write_text("")
    assert "mean my_law.toml?" in invoke("run", "my_law", code=2)
