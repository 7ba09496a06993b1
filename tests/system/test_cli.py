"""What the command lines say when something is wrong, and what they show of a running swarm."""

import asyncio
import contextlib
import json
import os
import signal
import socket
import time
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest
from system.agents import AGENT, BRISK, CRAZYCHOIR, Program, Team, until
from system.commands import call

from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import list_mission_names, load_mission
from crazychoir.launch import observer as window
from crazychoir.launch.flight import MISSION_REASONS, fly_fast
from crazychoir.launch.network import isolate_swarm

pytestmark = pytest.mark.system

RAISING = """
from crazychoir import CFDistributedFeedback, SwarmConfig

class Law(CFDistributedFeedback):
    duration = 2.0
    steps = 0

    def step(self, me, heard):
        self.steps += 1
        if self.member.id == 1 and self.steps > 50:
            raise ValueError("no idea")

def guidance(i, config):
    return Law()

def swarm(drones=None):
    return SwarmConfig.of({"name": "raising", "drones": [{"id": i, "home": [float(i), 0.0, 0.0]} for i in range(3)]})
"""
TELLING = """
import numpy as np
from crazychoir import CFGuidance

class Goes(CFGuidance):
    async def mission(self):
        await self.take_off(0.2)
        print("hovering", self.id)
        await self.land()
        far = np.linalg.norm(self.state.p - np.array([9.0, 9.0, 9.0]))
        there = far < (0.1 if self.id == 1 else 99.0)
        return {"success": there, "far": np.float32(9.0), "at": self.state.p, "by": {1: 2}}

def guidance(i, config):
    return Goes()

def report(config, results):
    return {"types": {i: [type(result[key]).__name__ for key in ("success", "far", "at")] + [list(result["by"])]
                      for i, result in results.items()}}
"""
DRONE = "[[drones]]\nid = 0\nhome = [0.0, 0.0, 0.0]\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nothing", "--fast"], ["nothing", *list_mission_names()]),
        (["no_file.toml", "--fast"], ["no_file.toml"]),
        (
            ["bearing_formation", "--only", "2,3"],
            ["--only", "2,3 without a swarm file", "--swarm"],
        ),
        (["deploy/lab6.toml", "--only", "x"], ["--only", "0 to 5"]),
        (["deploy/lab6.toml", "--only", "17"], ["--only: found drone 17", "0 to 5"]),
        (["deploy/lab6.toml", "--only", "2", "--fast"], ["--only", "--fast"]),
        (
            ["bearing_formation", "--fast", "--drones", "31"],
            ["--drones", "31", "11 (a letter)"],
        ),
        (
            ["deploy/lab6.toml", "--fast", "--drones", "3"],
            ["--drones", "3 beside a swarm file"],
        ),
        (
            ["bearing_formation", "--fast", "--processes", "2"],
            ["--processes", "--fast beside it"],
        ),
        (["bearing_formation", "--fast", "--loss", "2"], ["loss", "probability"]),
    ],
)
def test_run_refuses(here, repository, monkeypatch, words, said):
    monkeypatch.chdir(repository)
    here("crazychoir", "run", *words).refuses(*said)


def test_what_is_refused_is_one_json_object_and_exit_code_2():
    said = call("crazychoir", "run", "nothing", "--fast", "--json")
    said.refuses(*list_mission_names())
    assert said.json["kind"] == "ConfigError"
    assert said.json["success"] is False


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def guidance(i, config)\n    return None\n", ["SyntaxError", "line 1"]),
        ("x = 1\n", ["no function guidance"]),
        ("raise RuntimeError('at import')\n", ["RuntimeError", "at import"]),
    ],
)
def test_a_mission_file_that_is_none_is_refused(here, tmp_path, text, said):
    path = tmp_path / "mission.py"
    path.write_text(text)
    here("crazychoir", "run", path, "--fast").refuses("mission.py", *said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('name = "x"\nfoo = 3\n' + DRONE, ["foo = 3", "no such key"]),
        (
            'name = "x"\n' + DRONE + "neighbors = [7]\n",
            ["neighbors = [7]", "no drone 7"],
        ),
        (
            'name = "x"\n' + DRONE + 'uri = "radio://0/80/2M/E7E7"\n',
            ["radio://", "hexadecimal"],
        ),
        ('name = "x"\n' + DRONE, ["no mission"]),
        ("name = [", ["swarm.toml"]),
    ],
)
def test_a_swarm_file_that_is_wrong_is_refused(here, tmp_path, text, said):
    path = tmp_path / "swarm.toml"
    path.write_text(text)
    here("crazychoir", "run", path, "--fast").refuses("swarm.toml", *said)


def test_a_mission_that_fails_lands_its_drone_and_the_others_go_on(here, tmp_path):
    path = tmp_path / "raising.py"
    path.write_text(RAISING)
    result = here("crazychoir", "run", path, "--fast", "--json").json
    assert not result["success"]
    assert "ValueError: no idea" in result["reasons"]["1"]
    assert list(result["reasons"]) == ["1"]
    assert result["results"]["0"]["law_s"] == pytest.approx(2.0, abs=0.02)
    assert result["flown_m"]["1"] == pytest.approx(2.0, abs=0.1), "up, and down again"


@pytest.mark.parametrize(
    "fast",
    [True, pytest.param(False, marks=(pytest.mark.real_time, pytest.mark.slow))],
    ids=["fast", "real time"],
)
def test_a_report_gets_the_same_results_in_both_worlds_whatever_a_mission_prints(
    tmp_path, fast
):
    path = tmp_path / "telling.py"
    path.write_text(TELLING)
    words = ("run", path, "--drones", 2, "--json", *(["--fast"] if fast else []))
    said = call("crazychoir", *words, PYTHONUNBUFFERED="")  # prints late, if it can
    assert said.code == 1, said.err
    assert said.json["types"] == {i: ["bool", "float", "ndarray", [1]] for i in "01"}
    assert said.json["reasons"] == {"1": MISSION_REASONS.unsaid}
    assert said.json["results"]["0"]["far"] == 9.0
    assert len(said.json["results"]["0"]["at"]) == 3
    assert sorted(line for line in said.err.splitlines() if "hovering" in line) == [
        "hovering 0",
        "hovering 1",
    ]


def test_the_live_table_shows_a_drone_flying_only_when_it_flies():
    mission, told = load_mission("pickup_delivery"), {}

    def watch(score):
        for i, status in score.statuses.items():
            told.setdefault(i, {})[
                status.phase, status.task.split(":")[0].split()[0]
            ] = None

    fly_fast(mission.swarm(None).replace(flight=BRISK), mission, watch)
    assert not any(("on ground", "flying") in seen for seen in told.values()), told
    assert any(("on ground", "waiting") in seen for seen in told.values()), told
    assert all(("on ground", "done") in seen for seen in told.values()), told
    assert all(("hovering", "flying") in seen for seen in told.values()), told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--id", "9"], ["drone 9", "0 to 5"]),
        (["--id", "0", "--listen", "nonsense"], ["listen", "nonsense", "tcp/"]),
        (["--id", "0", "--connect", "nonsense"], ["connect", "nonsense", "tcp/"]),
    ],
)
def test_an_agent_refuses(here, words, said):
    here("crazychoir-agent", *words).refuses(*said)


@pytest.mark.parametrize("words", [["bench"], ["bench", "--help"]])
def test_bench_has_commands_of_its_own(here, words):
    said = here("crazychoir", *words)
    assert all(name in said.out for name in ("exchange", "flight", "latency", "all")), (
        said
    )


def test_an_option_of_a_bench_is_read_by_it(here):
    said = here("crazychoir", "bench", "flight", "--quack")
    assert said.code == 2
    assert "--quack" in said.err


@pytest.fixture
def four(tmp_path):
    """A swarm file of a long formation, two drones a process, on ports of its own."""
    config = isolate_swarm(
        load_mission("bearing_formation")
        .swarm(None)
        .replace(flight=BRISK, mission_options={"duration": 300.0}),
        2,
    )
    return written(tmp_path / "four.json", config.replace(start_deadline=60.0))


def written(path, config):
    path.write_text(config.dumps())
    return path, config


def test_a_port_in_use_is_named(here, four):
    path, config = four
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", config.base_port))
        taken.listen()
        here("crazychoir-agent", "--swarm", path, "--id", 0).refuses(
            str(config.base_port)
        )


def test_a_drone_that_is_absent_at_the_start_is_named(four):
    path, _ = written(four[0], four[1].replace(start_deadline=1.0))
    said = call("crazychoir-agent", "--swarm", path, "--id", 0, "--json")
    assert said.code == 1
    assert "1, 2, 3 absent after 1 s" in said.json["results"]["0"]["reason"]


@pytest.mark.parametrize(
    "words",
    [
        ["echo", "state", "--seconds", "1"],
        ["hz", "state"],
        ["status"],
        ["impair", "--loss", "0.3"],
        ["land"],
        ["stop"],
    ],
)
def test_looking_into_a_swarm_that_does_not_run(here, four, monkeypatch, words):
    monkeypatch.setattr(window, "NEXT_PROCESS_TIMEOUT", 0.1)
    here("crazychoir", *words, "--swarm", four[0]).refuses(
        "no agent found", "is it running?"
    )


def test_topics_that_do_not_exist_and_edges_that_are_none(here):
    here("crazychoir", "echo", "nothing").refuses("nothing", "state")
    here("crazychoir", "impair", "--edge", "a,b").refuses("--edge", "a,b")
    topics = here("crazychoir", "topics", "--json").json
    assert {"pose", "state", "round"} <= {topic["topic"] for topic in topics}


async def look(*words):
    """A command beside a running swarm, in a process of its own."""
    return await asyncio.to_thread(call, "crazychoir", *words)


@pytest.fixture
def look_here(here):
    """A command beside a running swarm, in a thread of this process: one at once."""
    return partial(asyncio.to_thread, here, "crazychoir")


def answers(drones, answer, says):
    """What a command prints in JSON when each of these drones says the same."""
    return {i: {"answer": answer, "says": says} for i in drones}


@contextlib.asynccontextmanager
async def flown_by(program, path, config, folder, command=None):
    """All drones in the air, flown by `crazychoir run` or by one `crazychoir-agent`; the program and its observer.

    command: an operator's part in it, awaited with the observer.
    """
    ids = [word for i in config.ids for word in ("--id", str(i))]
    words = (
        (*AGENT, "--swarm", path, "--json", *ids)
        if program == "agent"
        else (*CRAZYCHOIR, "run", path, "--json")
    )
    flying = await Program.start(*words)
    team = None
    try:
        if program == "run":
            said = await flying.says("crazychoir status --swarm ")
            config = SwarmConfig.load(said.rsplit(" ", 1)[1])
        team = Team(config, folder, lambda i: [])
        await team.look()
        if command is not None:
            await command(team)
        await team.phase("mission", "hovering", seconds=60.0)
        yield flying, team
    finally:
        await flying.kill()
        if team is not None:
            await team.observer.kill()


@pytest.mark.timeout(240)
async def test_operating_and_looking_into_a_swarm_that_runs_then_landing_it(
    look_here, four, tmp_path, compiled
):
    path, config = written(four[0], four[1].replace(flight={**BRISK, "operator": True}))

    async def command(team):
        for verb, says in (("take-off", "hovering"), ("start", "its mission goes on")):
            await until(
                lambda verb=verb: all(f": {verb}" in s["task"] for s in team.newest()),
                40.0,
            )
            said = await look_here(verb, "--json", "--swarm", path)
            assert (said.code, said.json) == (0, answers("0123", "done", says))

    async with flown_by("agent", path, config, tmp_path, command) as (agent, team):
        await until(
            lambda: all(team.statuses(i)[-1]["phase"] == "mission" for i in (2, 3)),
            20.0,
        )
        said = await look_here("status", "--swarm", path, "--json")
        phases = {i: row["phase"] for i, row in said.json.items()}
        assert phases == {
            "0": "hovering",
            "1": "hovering",
            "2": "mission",
            "3": "mission",
        }
        said = await look("echo", "state", "--seconds", "1", "--swarm", path)
        rows = [json.loads(line) for line in said.out.splitlines()]
        assert {row["drone"] for row in rows} == {0, 1, 2, 3}
        rates = (
            await look_here("hz", "state", "--seconds", "1", "--json", "--swarm", path)
        ).json
        assert all(rate > 20.0 for rate in rates.values()), rates
        said = await look_here("impair", "--loss", "0.3", "--json", "--swarm", path)
        assert said.code == 0
        assert set(said.json) == {"0", "1", "2", "3"}
        assert "0.3" in str(said.json["0"])
        said = await look_here(
            "param",
            "set",
            "control.kr",
            "7,7,4",
            "--drone",
            "2",
            "--json",
            "--swarm",
            path,
        )
        assert (said.code, said.json) == (0, {"2": [7.0, 7.0, 4.0]})
        said = await look_here(
            "param", "set", "control.kr", "30,30,4", "--json", "--swarm", path
        )
        assert said.code == 1
        assert all(
            "gains that bear 40 ms more delay" in text for text in said.json.values()
        )
        said = await look_here("param", "get", "control.kr", "--json", "--swarm", path)
        kept = {"control.kr": [8.0, 8.0, 4.0]}
        assert said.json == {
            "0": kept,
            "1": kept,
            "2": {"control.kr": [7.0, 7.0, 4.0]},
            "3": kept,
        }
        said = await look_here("hold", "--drones", "2-3", "--json", "--swarm", path)
        assert (said.code, said.json) == (0, answers("23", "done", "held"))
        said = await look_here("start", "--drones", "2", "--json", "--swarm", path)
        assert (said.code, said.json) == (
            1,
            answers("2", "refused", "its mission has started"),
        )
        said = await look_here("land", "--json", "--swarm", path)
        assert (said.code, said.json) == (0, answers("0123", "done", "on ground"))
        ended = await agent.end(40.0)
        assert ended["code"] == 0
        assert "land" in ended["results"]["2"]["reason"]


@pytest.mark.timeout(120)
async def test_beside_an_agent_that_waits(look_here, four, compiled):
    """A second agent of the same drone is refused. A stop names the drones that have not acknowledged it."""
    path, config = four
    agent = await Program.start(
        *AGENT, "--swarm", path, "--json", "--id", "0", "--id", "1"
    )
    try:
        await listening(config.base_port)
        second = await Program.start(
            *AGENT,
            "--swarm",
            path,
            "--id",
            "0",
            "--json",
            "--listen",
            "tcp/127.0.0.1:0",
            "--connect",
            Addresses(config).endpoint(0),
        )
        ended = await second.end(60.0)
        assert ended["code"] == 1
        assert "Traceback" not in second.text
        assert "flies drone(s) 0 too" in second.text
        said = await look_here("stop", "--json", "--swarm", path)
        off, gone = (
            {"answer": "done", "says": "motors off"},
            {"answer": "absent", "says": ""},
        )
        expected = {"0": off, "1": off, "2": gone, "3": gone}
        assert (said.code, said.json) == (1, expected), said
    finally:
        await agent.kill()


async def listening(port):
    """Wait until a process listens there."""

    def answers():
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    await until(answers, 40.0, lambda: f"no process listens on {port}")


@pytest.mark.slow
@pytest.mark.timeout(180)
async def test_two_runs_of_one_swarm_file_meet_when_each_starts_its_drones(
    four, compiled
):
    path, config = written(four[0], four[1].replace(mission_options={"duration": 1.0}))
    runs = {
        only: await Program.start(*CRAZYCHOIR, "run", path, "--only", only, "--json")
        for only in ("0,1", "2,3")
    }
    try:
        said = await runs["2,3"].says("crazychoir status --swarm ")
        effective = SwarmConfig.load(said.rsplit(" ", 1)[1])
        assert effective == config, "the name and the ports of the file"
        for only, program in runs.items():
            ended = await program.end(90.0)
            here = [int(word) for word in only.split(",")]
            assert (ended["code"], ended["success"], ended["here"]) == (
                0,
                True,
                here,
            ), ended
            assert (ended["drones"], list(map(int, ended["results"]))) == (4, here)
            assert all(length > 0.5 for length in ended["flown_m"].values()), (
                "all four were seen flying"
            )
    finally:
        for program in runs.values():
            await program.kill()


@pytest.mark.timeout(120)
async def test_a_run_fails_if_not_all_its_processes_can_start(four, tmp_path, compiled):
    """A run of some drones names the absent ones. In a run of all, one failed process ends the wait of the others."""
    async with asyncio.TaskGroup() as group:
        group.create_task(
            some_are_missing(written(tmp_path / "some.json", isolate_swarm(four[1], 2)))
        )
        group.create_task(others_wait(four))


async def some_are_missing(swarm):
    path, config = written(swarm[0], swarm[1].replace(start_deadline=1.0))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", config.base_port + 2))
        said = await look("run", path, "--only", "2,3", "--json")
    assert said.code == 1, said.err
    assert (said.json["here"], said.json["absent"]) == ([2, 3], [2, 3])


async def others_wait(swarm):
    path, config = written(swarm[0], swarm[1].replace(start_deadline=60.0))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", config.base_port + 2))
        began = time.monotonic()
        said = await look("run", path, "--only", "0,1,2,3", "--json")
    assert time.monotonic() - began < 30.0, "not the whole deadline"
    assert said.code == 1, said.err
    assert {2, 3} <= set(said.json["absent"]), (
        "drones 2 and 3, and others if their process did not obey signals yet"
    )
    assert "the others wait no more" in said.err


RUN_CHILDREN = 3
"""Two agents, and the fork server that has made them."""


def children_of(pid):
    """Ids of its processes."""
    return [
        int(word)
        for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    ]


def alive(pid):
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    return False


def phases(team):
    """What each drone was seen doing, one after the other."""
    seen = {
        i: [status["phase"] for status in team.statuses(i)] for i in team.config.ids
    }
    return {
        i: [new for old, new in pairwise([None, *told]) if new != old]
        for i, told in seen.items()
    }


def landed(team):
    """Whether every drone was seen landing, then on the ground, and never stopped in the air."""
    every = phases(team).values()
    return all(
        "landing" in seen and seen[-1] == "on ground" and "stopped" not in seen
        for seen in every
    )


async def test_an_interrupted_run_in_virtual_time_says_that_it_ends(four, tmp_path):
    path, _ = written(four[0], four[1].replace(mission_options={"duration": 1e5}))
    recorded = tmp_path / "a.mcap"
    flying = await Program.start(
        *CRAZYCHOIR, "run", path, "--fast", "--json", "--record", recorded
    )
    try:
        await until(
            lambda: recorded.exists() and recorded.stat().st_size > 1e5,
            60.0,
            lambda: flying.text,
        )
        flying.signal(signal.SIGINT)
        ended = await flying.end(30.0)
        assert (ended["code"], ended["success"], ended["kind"]) == (
            130,
            False,
            "KeyboardInterrupt",
        )
        assert "Ctrl-C" in flying.text
        assert "Traceback" not in flying.text
    finally:
        await flying.kill()


@pytest.mark.timeout(240)
async def test_an_interrupted_flight_lands_then_ends_and_leaves_no_process_behind(
    four, tmp_path, compiled
):
    async with asyncio.TaskGroup() as group:
        for program in ("run", "agent"):
            folder = tmp_path / program
            folder.mkdir()
            group.create_task(
                interrupt(
                    program,
                    written(folder / "four.json", isolate_swarm(four[1], 2)),
                    folder,
                )
            )


async def interrupt(program, swarm, folder):
    """Ctrl-C in the air."""
    async with flown_by(program, *swarm, folder) as (flying, team):
        children = children_of(flying.process.pid)
        assert len(children) == (RUN_CHILDREN if program == "run" else 0)
        said = await look("status", "--swarm", swarm[0], "--json")
        assert set(said.json) == {"0", "1", "2", "3"}, (
            "the status of the flown file shows all its drones"
        )
        flying.signal(signal.SIGINT)
        ended = await flying.end(60.0)
        assert ended["code"] == 1
        reasons = [result["reason"] for result in ended["results"].values()]
        assert len(reasons) == 4, ended
        assert all("Ctrl-C" in reason for reason in reasons)
        assert landed(team), (phases(team), {s["note"] for s in team.statuses()})
        assert not any(alive(child) for child in children)
        assert "Traceback" not in flying.text


@pytest.mark.timeout(240)
async def test_children_land_and_end_when_their_parent_is_killed(
    four, tmp_path, compiled
):
    async with flown_by("run", *four, tmp_path) as (flying, team):
        children = children_of(flying.process.pid)
        assert len(children) == RUN_CHILDREN
        await flying.kill()
        try:
            await until(
                lambda: not any(alive(child) for child in children),
                40.0,
                lambda: "children still run",
            )
            assert landed(team), (phases(team), {s["note"] for s in team.statuses()})
        finally:
            for child in children:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
