"""What the command lines say when something is wrong, and what they show of a running swarm."""

import asyncio
import contextlib
import json
import os
import signal
import socket
from pathlib import Path

import pytest
from system.agents import AGENT, BRISK, CRAZYCHOIR, Program, until
from system.commands import call, run

from crazychoir.guidance.mission import load
from crazychoir.launch import apart

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
DRONE = "[[drones]]\nid = 0\nhome = [0.0, 0.0, 0.0]\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nothing", "--fast"], ["nothing", "bearing_formation, pickup_delivery"]),
        (["no_file.toml", "--fast"], ["no_file.toml"]),
        (["bearing_formation", "--only", "x"], ["--only", "0 to 3"]),
        (["bearing_formation", "--only", "17"], ["--only", "17"]),
        (["bearing_formation", "--fast", "--drones", "30"], ["--drones", "30"]),
        (["bearing_formation", "--fast", "--loss", "2"], ["loss", "probability"]),
    ],
)
def test_run_refuses(words, said):
    call("crazychoir", "run", *words).refuses(*said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def guidance(i, config)\n    return None\n", ["SyntaxError", "line 1"]),
        ("x = 1\n", ["no function guidance"]),
        ("raise RuntimeError('at import')\n", ["RuntimeError", "at import"]),
    ],
)
def test_a_mission_file_that_is_none_is_refused(tmp_path, text, said):
    path = tmp_path / "mission.py"
    path.write_text(text)
    call("crazychoir", "run", path, "--fast").refuses("mission.py", *said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('name = "x"\nfoo = 3\n' + DRONE, ["foo = 3", "no such key"]),
        ('name = "x"\n' + DRONE + "neighbors = [7]\n", ["neighbors = [7]", "no drone 7"]),
        ('name = "x"\n' + DRONE + 'uri = "radio://0/80/2M/E7E7E7E703"\n', ["radio://", "sim://"]),
        ('name = "x"\n' + DRONE, ["no mission"]),
        ("name = [", ["swarm.toml"]),
    ],
)
def test_a_swarm_file_that_is_wrong_is_refused(tmp_path, text, said):
    path = tmp_path / "swarm.toml"
    path.write_text(text)
    call("crazychoir", "run", path, "--fast").refuses("swarm.toml", *said)


def test_a_mission_that_fails_lands_its_drone_and_the_others_go_on(tmp_path):
    path = tmp_path / "raising.py"
    path.write_text(RAISING)
    result = run(path, "--fast")
    assert not result["success"]
    assert "ValueError: no idea" in result["reasons"]["1"]
    assert list(result["reasons"]) == ["1"]
    assert result["results"]["0"]["law_s"] > 2.0
    assert result["flown_m"]["1"] == pytest.approx(2.0, abs=0.1), "up, and down again"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--id", "9"], ["drone 9", "0 to 5"]),
        (["--id", "0", "--listen", "nonsense"], ["listen", "nonsense", "tcp/"]),
        (["--id", "0", "--connect", "nonsense"], ["connect", "nonsense", "tcp/"]),
    ],
)
def test_an_agent_refuses(words, said):
    call("crazychoir-agent", *words).refuses(*said)


@pytest.fixture
def four(tmp_path):
    """A swarm file of a long formation, on ports of its own."""
    mission = load("bearing_formation")
    config = apart(mission.swarm(None).replace(flight=BRISK, mission_options={"duration": 300.0}), None)
    config = config.replace(start_deadline=3.0)
    path = tmp_path / "four.json"
    path.write_text(config.dumps())
    return path, config


def test_a_port_in_use_is_named(four):
    path, config = four
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", config.base_port))
        taken.listen()
        call("crazychoir-agent", "--swarm", path, "--id", 0).refuses(str(config.base_port))


def test_who_is_absent_at_the_start_is_named(four):
    path, _ = four
    said = call("crazychoir-agent", "--swarm", path, "--id", 0, "--json")
    assert said.code == 1
    assert "1, 2, 3 absent after 3 s" in said.json["results"]["0"]["reason"]


@pytest.mark.parametrize(
    "words",
    [["echo", "state", "--seconds", "1"], ["hz", "state"], ["status"], ["impair", "--loss", "0.3"], ["stop", "--land"]],
)
def test_looking_into_a_swarm_that_does_not_run(four, words):
    call("crazychoir", *words, "--swarm", four[0]).refuses("no agent found", "is it running?")


def test_topics_that_do_not_exist_and_edges_that_are_none():
    call("crazychoir", "echo", "nothing").refuses("nothing", "state")
    call("crazychoir", "impair", "--edge", "a,b").refuses("--edge", "a,b")
    topics = call("crazychoir", "topics", "--json").json
    assert {"pose", "state", "round"} <= {topic["topic"] for topic in topics}


async def look(*words):
    """A command beside a running swarm."""
    return await asyncio.to_thread(call, "crazychoir", *words)


@pytest.mark.timeout(240)
async def test_looking_into_a_swarm_that_runs_then_landing_it(four, compiled):
    path, config = four
    path.write_text(config.replace(start_deadline=60.0).dumps())
    ids = [word for i in config.ids for word in ("--id", str(i))]
    agent = await Program.start(*AGENT, "--swarm", path, "--json", *ids)
    try:
        phases: dict[str, str] = {}
        for _ in range(20):
            said = await look("status", "--swarm", path, "--json")
            phases = {i: row["phase"] for i, row in said.json.items()} if said.code == 0 else {}
            if phases.get("2") == "mission":
                break
        assert phases == {"0": "hovering", "1": "hovering", "2": "mission", "3": "mission"}
        said = await look("echo", "state", "--seconds", "1", "--swarm", path)
        rows = [json.loads(line) for line in said.out.splitlines()]
        assert {row["drone"] for row in rows} == {0, 1, 2, 3}
        rates = (await look("hz", "state", "--seconds", "2", "--json", "--swarm", path)).json
        assert all(rate > 20.0 for rate in rates.values()), rates
        said = await look("impair", "--loss", "0.3", "--json", "--swarm", path)
        assert set(said.json) == {"0", "1", "2", "3"}
        assert "0.3" in str(said.json["0"])
        assert (await look("stop", "--land", "--swarm", path)).code == 0
        ended = await agent.end(40.0)
        assert ended["code"] == 1
        assert "land" in ended["results"]["2"]["reason"]
    finally:
        await agent.kill()


def children_of(pid):
    """Ids of its processes."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def alive(pid):
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    return False


async def flying(path):
    """`crazychoir run` of a swarm file, and its children."""
    program = await Program.start(*CRAZYCHOIR, "run", path, "--json")
    await until(lambda: len(children_of(program.process.pid)) == 4, 60.0)
    await asyncio.sleep(12.0)
    return program, children_of(program.process.pid)


@pytest.mark.timeout(240)
async def test_an_interrupted_run_lands_and_leaves_nobody_behind(four, compiled):
    path, config = four
    path.write_text(config.replace(start_deadline=60.0).dumps())
    program, children = await flying(path)
    try:
        program.signal(signal.SIGINT)
        ended = await program.end(60.0)
        assert ended["code"] != 0
        assert ended["success"] is False
        assert len(ended["reasons"]) == 4, ended
        assert all("SIG" in reason for reason in ended["reasons"].values())
        assert not any(alive(child) for child in children)
    finally:
        await program.kill()


@pytest.mark.timeout(240)
async def test_children_land_and_end_when_their_parent_is_killed(four, compiled):
    path, config = four
    path.write_text(config.replace(start_deadline=60.0).dumps())
    program, children = await flying(path)
    await program.kill()
    try:
        await until(lambda: not any(alive(child) for child in children), 40.0, lambda: "children still run")
    finally:
        for child in children:
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)


@pytest.mark.timeout(120)
async def test_the_second_agent_of_one_drone_is_refused(four, compiled):
    path, config = four
    path.write_text(config.replace(start_deadline=30.0).dumps())
    first = await Program.start(*AGENT, "--swarm", path, "--id", "0", "--json")
    try:
        await asyncio.sleep(6.0)
        second = await Program.start(*AGENT, "--swarm", path, "--id", "0", "--json", "--listen", "tcp/127.0.0.1:0",
                                     "--connect", config.endpoint(0))  # fmt: skip
        ended = await second.end(60.0)
        assert ended["code"] != 0
        assert "Traceback" not in second.text
        assert "flies drone(s) 0 too" in second.text
    finally:
        await first.kill()
