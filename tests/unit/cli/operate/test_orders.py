import asyncio

import pytest
import typer
from typer.testing import CliRunner

from crazychoir.agents import operator as mission
from crazychoir.cli.main import app
from crazychoir.cli.operate import go_to, inspect, orders
from crazychoir.cli.operate.orders import _conclude, parse_drones
from crazychoir.config.swarm_config import default_swarm
from crazychoir.launch.run_registry import RunRecord
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.trajectory_file import write_pieces


class Window:
    """Notes what it is to command."""

    config = mission.swarm(3)

    def __init__(self):
        self.told = []

    def check(self, option, ids):
        assert set(ids) <= set(self.config.ids)

    async def order(self, verb, drones, seconds, **arguments):
        self.told.append((verb, drones, seconds, arguments))
        return {0: (True, ("done", ""))}

    async def command(self, verb, told, seconds):
        self.told.append((verb, told, seconds))
        return {0: (True, ("done", ""))}


@pytest.fixture
def window(monkeypatch):
    window = Window()
    for module in (orders, go_to):
        monkeypatch.setattr(
            module,
            "run_as_operator",
            lambda swarm, work, as_json: asyncio.run(work(window)),
        )
    return window


def test_commands_carry_height_duration_and_velocity(window):
    for words in (
        ["take-off", "--height", "0.8", "--duration", "3"],
        ["land", "--drones", "1", "--wait", "9"],
        ["velocity", "0.3,0,-0.1", "--drones", "0-1", "--duration", "2"],
        ["hold"],
    ):
        assert CliRunner().invoke(app, words).exit_code == 0, words
    assert window.told == [
        ("take-off", None, 33.0, {"height": 0.8, "duration": 3.0}),
        ("land", [1], 9.0, {"height": 0.0, "duration": 0.0}),
        (
            "velocity",
            [0, 1],
            12.0,
            {"v": (0.3, 0.0, -0.1), "yaw_rate": 0.0, "duration": 2.0},
        ),
        ("hold", None, 5.0, {}),
    ]


def test_relative_goal_is_the_same_for_each_drone(window):
    words = ["go-to", "0,0,0.3", "--drones", "0,2", "--relative", "--velocity", "0.2"]
    assert CliRunner().invoke(app, words).exit_code == 0
    goal = {"p": [0.0, 0.0, 0.3], "yaw": None, "duration": 0.0}
    told = goal | {"relative": True, "speed": 0.2}
    assert window.told == [("go-to", {0: told, 2: told}, 120.0)]


@pytest.mark.parametrize("is_loaded", [True, False])
def test_flight_on_board_begins_when_all_drones_have_its_trajectory(
    window, tmp_path, monkeypatch, is_loaded
):
    path = tmp_path / "path.csv"
    write_pieces(path, minimum_snap([[0, 0, 1.0], [0.4, 0.3, 1.0]]))

    async def command(verb, told, seconds):
        window.told.append(verb)
        answer = ("done", "") if is_loaded else ("refused", "no memory")
        return {0: (True, ("done", "")), 1: (is_loaded, answer)}

    monkeypatch.setattr(window, "command", command)
    words = ["fly", str(path), "--drones", "0-1", "--on-board", "--relative"]
    run = CliRunner().invoke(app, words)
    assert (run.exit_code == 0) is is_loaded, run.output
    assert window.told == (["load", "fly"] if is_loaded else ["load"])


def test_operator_chooses_one_of_several_runs(monkeypatch, capsys):
    runs = [RunRecord(name, "figure", None, f"{name}.json") for name in ("a", "b")]
    answers = iter([5, 2])
    monkeypatch.setattr(typer, "prompt", lambda *words, **more: next(answers))
    assert inspect._ask_for_run(runs) is runs[1]
    assert "2: swarm b, figure" in capsys.readouterr().err
    inspect._print_swarm(default_swarm(2))
    assert capsys.readouterr().err == "swarm default\n"


def test_drones_are_told_by_numbers_ranges_and_names():
    assert parse_drones("3, 5-7,3,cf231").words == (3, 5, 6, 7, "cf231")


@pytest.mark.parametrize(
    ("text", "said"),
    [("7-5", "5-7"), ("3,7-5", "5-7"), ("x y", "3,5-7"), ("", "3,5-7")],
)
def test_what_names_no_drones_is_refused(text, said, capsys):
    with pytest.raises(typer.Exit) as ended:
        parse_drones(text)
    assert ended.value.exit_code != 0
    assert said in "".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("rows", "code"),
    [
        ({}, 1),
        ({0: {"answer": "done", "says": ""}}, 0),
        ({0: {"answer": "silent", "says": ""}}, 1),
    ],
)
def test_an_order_that_reaches_no_drone_has_failed(rows, code, capsys):
    with pytest.raises(typer.Exit) as ended:
        _conclude(rows, as_json=True)
    assert ended.value.exit_code == code
