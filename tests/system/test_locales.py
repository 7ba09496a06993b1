"""Commands handle names of files that no locale expects, under locales that lack letters, with output into pipes."""

import json
import os
import re
import subprocess
import sys

import pytest

pytestmark = pytest.mark.system

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
LATIN_OUTPUT = {"LC_ALL": "C.UTF-8", "PYTHONIOENCODING": "latin-1:strict"}
UTF8 = {"LC_ALL": "C.UTF-8"}
NAMES = {"umlaut": "schön".encode(), "other bytes": b"b\xfcse", "markup": b"[red]x[z]"}
MISSION = """
from crazychoir import CFGuidance

class Rising(CFGuidance):
    async def mission(self):
        await self.take_off(0.3)
        await self.land()
        return {"success": False, "reason": f"{__file__}: [red]böse[/red] [/] :smile:"}

def guidance(i, config):
    return Rising()
"""
ALGORITHM = """
from crazychoir.optimization.algorithms.consensus import Consensus

def agent(i, graph):
    return Consensus(i, [float(i)], {j: 1.0 / 3.0 for j in (i, *graph.neighbors(i))}, 3)
"""


CASES = {
    "umlaut, ASCII": (NAMES["umlaut"], ASCII),
    "other bytes, UTF-8": (NAMES["other bytes"], UTF8),
    "markup, Latin-1": (NAMES["markup"], LATIN_OUTPUT),
}
COMMANDS = """
import json, os, sys
from crazychoir.launch.process import ending
from crazychoir.cli.main import app

ending.run_to_exit(lambda: None)
for words in json.loads(sys.argv[1]):
    try:
        app([word.replace("HERE", os.getcwd()) for word in words])
    except SystemExit as end:
        print("ended with", end.code, flush=True)
"""


def folder_named(name, tmp_path):
    """A folder with such a name, in which there are a mission, a swarm file and an algorithm."""
    made = tmp_path / os.fsdecode(name)
    made.mkdir()
    (made / "rise.py").write_text(MISSION, encoding="utf-8")
    (made / "$\\frac.py").write_text(ALGORITHM)
    (made / "swarm.toml").write_text(
        'name = "x"\nmission = "rise.py"\n[[drones]]\nid = 0\nhome = [0, 0, 0]\n[[drones]]\nid = 1\nhome = [1, 0, 0]\n'
    )
    return made


def run(command, environment, folder):
    done = subprocess.run(
        command,
        env=os.environ | {"COLUMNS": "400"} | environment,
        cwd=folder,
        capture_output=True,
        check=False,
    )
    assert b"Traceback" not in done.stderr, done.stderr.decode(errors="replace")
    return done


@pytest.mark.parametrize(("name", "environment"), CASES.values(), ids=CASES)
def test_commands_read_write_and_print_names_that_no_locale_expects(
    name, environment, tmp_path
):
    folder = folder_named(name, tmp_path)
    commands = [
        ["run", "swarm.toml", "--fast", "--record", "flight.mcap"],
        ["solve", "HERE/missing.json"],
    ]
    codes = [b"1", b"2"]
    if name == NAMES["umlaut"]:
        words = ["--agents", "3", "--picture", "$\\frac$.png", "--save", "history.json"]
        commands.append(["simulate", "$\\frac.py", *words])
        codes.append(b"0")
    if name == NAMES["markup"]:
        commands.append(["plot", "flight.mcap"])
        codes.append(b"0")
    done = run(
        [sys.executable, "-c", COMMANDS, json.dumps(commands)], environment, folder
    )
    assert re.findall(rb"ended with (\d)", done.stdout) == codes, done.stderr
    assert b"[red]" in done.stdout
    assert b"[/red] [/] :smile:" in done.stdout
    assert os.fsencode(folder / "missing.json") in done.stderr
    if name == NAMES["umlaut"]:
        assert (folder / "$\\frac$.png").stat().st_size > 0
        assert json.loads((folder / "history.json").read_text())["rounds"] == 3
    if name == NAMES["markup"]:
        assert b"[red]x[z]/rise.py" in done.stdout


@pytest.mark.real_time
def test_processes_are_told_such_names_and_say_them(tmp_path):
    name, environment = CASES["umlaut, ASCII"]
    folder = folder_named(name, tmp_path)
    words = [
        "run",
        str(folder / "rise.py"),
        "--drones",
        "1",
        "--processes",
        "1",
        "--json",
    ]
    done = run(
        [sys.executable, "-m", "crazychoir.cli.main", *words], environment, folder
    )
    result = json.loads(done.stdout)
    assert "[red]böse[/red] [/] :smile:" in result["reasons"]["0"]
    assert done.returncode == 1
