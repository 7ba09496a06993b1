"""A user's file that calls sys.exit, exit or quit: an error that names the file and the line, and nothing else ends."""

from textwrap import dedent

import pytest
from typer.testing import CliRunner

from crazychoir.cli.fly.agent import app as agent_app
from crazychoir.cli.main import app
from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast
from crazychoir.solve.simulate import simulate
from crazychoir.team import graph as graphs

CALLS = ("import sys; sys.exit(3)", "exit()", "quit('done')", "raise SystemExit")
MISSION = """
    import asyncio

    from crazychoir import Acceleration, CFDistributedFeedback, CFGuidance


    class Own(CFGuidance):
        def __init__(self): {init}
        def bind(self, member): super().bind(member); {bind}
        async def helper(self): {helper}
        async def mission(self):
            await self.take_off(0.3)
            {mission}
            task = asyncio.create_task(self.helper())
            await asyncio.wait([task])
            await task
            await self.land()


    class Law(CFDistributedFeedback):
        duration = 0.5
        def height(self): {height}; return 0.3
        def step(self, me, heard): {step}; return Acceleration(-me.v)


    def guidance(i, config): {guidance}; return {kind}()
    def check(config, force): {check}
    def report(config, results): {report}; return {{}}
"""
PLACES = (
    "init",
    "bind",
    "helper",
    "mission",
    "height",
    "step",
    "guidance",
    "check",
    "report",
)


def written(folder, place, call):
    parts = {name: call if name == place else "pass" for name in PLACES}
    parts["kind"] = "Law" if place in ("height", "step") else "Own"
    file = folder / "own.py"
    file.write_text(dedent(MISSION.format(**parts)))
    line = next(
        k
        for k, text in enumerate(file.read_text().splitlines(), 1)
        if place == "" or call in text
    )
    return file, f"{file}:{line}"


@pytest.mark.parametrize("place", PLACES)
def test_a_mission_that_exits_anywhere_is_told_by_file_and_line(place, tmp_path):
    file, where = written(tmp_path, place, "import sys; sys.exit(3)")
    said = CliRunner().invoke(
        app, ["run", str(file), "--fast", "--drones", "1", "--json"]
    )
    assert said.exit_code in (1, 2)
    assert where in said.output, said.output
    assert "sys.exit(3)" in said.output
    assert not isinstance(said.exception, SystemExit) or said.exception.code in (1, 2)


@pytest.mark.parametrize("call", CALLS)
def test_a_file_that_exits_when_it_is_imported_is_told_by_file_and_line(call, tmp_path):
    file = tmp_path / "own.py"
    file.write_text(f"a = 1\n{call}\n")
    with pytest.raises(
        ConfigError, match=r"own\.py:2: found the mission file called sys\.exit\("
    ):
        load_mission(str(file))
    for words in (["run", str(file), "--fast"], ["simulate", str(file)]):
        said = CliRunner().invoke(app, words)
        assert (said.exit_code, f"{file}:2" in said.stderr) == (2, True), said.output


def test_an_agent_reports_a_mission_file_that_exits(tmp_path):
    (tmp_path / "own.py").write_text("exit(0)\n")
    swarm = tmp_path / "a.toml"
    swarm.write_text(
        'name = "a"\nmission = "own.py"\ngraph = "empty"\ndrones = [{id = 0, home = [0, 0, 0]}]\n'
    )
    said = CliRunner().invoke(agent_app, ["--swarm", str(swarm), "--id", "0"])
    assert (
        said.exit_code,
        "own.py:1: found the mission file called sys.exit(0)" in said.stderr,
    ) == (2, True)


def test_a_mission_that_exits_in_flight_lands_its_drone_and_the_others_fly_on(tmp_path):
    file, where = written(
        tmp_path, "mission", "import sys; sys.exit(3) if self.id == 1 else None"
    )
    result = fly_fast(default_swarm(3), load_mission(str(file)))
    assert [one["success"] for one in result["results"].values()] == [True, False, True]
    assert (
        f"RuntimeError: the mission called sys.exit(3) ({where} mission)"
        in result["reasons"][1]
    )


class Exits:
    """An algorithm that exits in one of its parts."""

    x = 0.0

    def __init__(self, part):
        self.part, self.steps = part, 0

    @property
    def done(self):
        return self.steps > 3

    def message(self):
        if self.part == "message":
            raise SystemExit(4)
        return 1.0

    def step(self, heard):
        self.steps += 1
        if self.part == "step":
            quit()


@pytest.mark.parametrize("part", ["message", "step"])
@pytest.mark.parametrize("asynchronous", [False, True])
def test_an_algorithm_that_exits_at_one_agent_ends_all_and_is_told_by_file_and_line(
    part, asynchronous
):
    team = {i: Exits(part if i == 2 else "") for i in range(3)}
    for agent in team.values():
        agent.asynchronous = asynchronous
    with pytest.raises(
        CrazyChoirError,
        match=rf"test_exits\.py:\d+: found {part}\(\) of agent 2 called sys\.exit\(",
    ):
        simulate(team, graphs.path(3))
