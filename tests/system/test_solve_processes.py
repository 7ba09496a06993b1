"""`crazychoir solve --processes`: robots in processes of their own, over Zenoh, with lost messages."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from system.commands import call

from crazychoir.errors import ConfigError, ProcessFailed
from crazychoir.numerics import kernel_cache as cache
from crazychoir.routing.instance.instance import Instance
from crazychoir.solve import team
from crazychoir.solve.solve_options import SolveOptions
from crazychoir.solve.solving import solve_here

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.usefixtures("compiled"),
]


@pytest.fixture
def demo(repository):
    return repository / "agents" / "data" / "lab6.json"


def test_four_processes_of_six_robots_find_the_plan_of_virtual_time(demo):
    said = call("crazychoir", "solve", demo, "--processes", 4, "--loss", 0.2, "--json")
    assert said.code == 0, said.err
    found, here = said.json, solve_here(Instance.load(demo))
    assert found["plan_digest"] == here["plan_digest"]
    assert found["rounds"] == here["rounds"]
    assert found["lost"] == pytest.approx(0.2 * found["messages"], rel=0.1)
    assert found["resent"] > 0
    assert [robot["robot"] for robot in found["robots"]] == list(range(6))
    assert all(
        robot["rounds"] == found["rounds"] and robot["cpu_s"] > 0.0
        for robot in found["robots"]
    )
    assert sum(robot["bytes"] for robot in found["robots"]) == found["bytes"]
    assert found["critical_path_s"] == pytest.approx(
        found["critical_cpu_s"] + found["exchange_s"]
    )
    assert found["critical_cpu_s"] < found["cpu_s"]
    assert found["curve"][-1][1] == pytest.approx(found["cost"])


def test_options_that_cannot_be_are_refused_before_anything_starts(demo):
    problem = Instance.load(demo)
    with pytest.raises(ConfigError, match="processes: found 7; allowed: 1 to 6"):
        team.solve_in_processes(problem, 7)
    with pytest.raises(ConfigError, match="magic"):
        team.solve_in_processes(problem, 2, SolveOptions(method="magic"))
    call("crazychoir", "solve", demo, "--processes", 2, "--loss", 1.5).refuses(
        "--loss", "a probability, 0 to 1"
    )


def test_an_error_of_a_robot_names_it_and_ends_all(demo, monkeypatch):
    commands = team._build_commands

    def other_method(parts, common):
        first, second = commands(parts, common)
        second[-1] = json.dumps(json.loads(second[-1]) | {"method": "resource"})
        return [first, second]

    monkeypatch.setattr(team, "_build_commands", other_method)
    with pytest.raises(
        ProcessFailed,
        match=r"robots \d to \d: ConfigError: .*another task list, method",
    ):
        team.solve_in_processes(Instance.load(demo), 2)


def test_a_process_that_ends_is_told_with_its_last_words(demo, monkeypatch):
    end = [sys.executable, "-c", "raise SystemExit('out of memory, say')"]
    monkeypatch.setattr(team, "_build_commands", lambda parts, common: [end, end])
    with pytest.raises(
        ProcessFailed,
        match=r"robots \d to \d: .* ended before its answer: out of memory, say",
    ):
        team.solve_in_processes(Instance.load(demo), 2)


def test_compiling_in_the_processes_is_told_once(demo, monkeypatch, capsys):
    cache.announce_compiling.cache_clear()
    words = (
        "import json; print(json.dumps({'compiles': True})); raise SystemExit('done')"
    )
    monkeypatch.setattr(
        team,
        "_build_commands",
        lambda parts, common: [[sys.executable, "-c", words]] * 2,
    )
    with pytest.raises(ProcessFailed, match="done"):
        team.solve_in_processes(Instance.load(demo), 2)
    assert capsys.readouterr().err == f"{cache.COMPILING_MESSAGE}\n"


def test_a_missing_cache_of_the_processes_is_told_once(demo, monkeypatch, capsys):
    monkeypatch.setenv("CRAZYCHOIR_TOLD", "")
    words = "import json; print(json.dumps({'warning': 'cache: compiled laws: none'})); raise SystemExit('done')"
    monkeypatch.setattr(
        team,
        "_build_commands",
        lambda parts, common: [[sys.executable, "-c", words]] * 2,
    )
    with pytest.raises(ProcessFailed, match="done"):
        team.solve_in_processes(Instance.load(demo), 2)
    assert capsys.readouterr().err == "cache: compiled laws: none\n"


def test_no_robot_process_outlives_its_parent(demo):
    words = [
        sys.executable,
        "-m",
        "crazychoir.cli.main",
        "solve",
        str(demo),
        "--processes",
        "2",
        "--loss",
        "0.9",
    ]
    with subprocess.Popen(
        words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as parent:
        children = _until(
            lambda: found if len(found := _children(parent.pid)) == 2 else None
        )
        os.kill(parent.pid, signal.SIGKILL)
    _until(lambda: all(not _alive(child) for child in children))


def _until(condition, patience=30.0):
    ends = time.monotonic() + patience
    while not (found := condition()):
        assert time.monotonic() < ends
        time.sleep(0.05)
    return found


def _children(parent):
    with open(f"/proc/{parent}/task/{parent}/children") as file:
        return [int(word) for word in file.read().split()]


def _alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
