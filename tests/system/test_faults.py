"""Killed, stopped and hanging processes, hostile bytes, the emergency stop: the others go on, and say what happened."""

import asyncio
import json
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from system.agents import BRISK, CRAZYCHOIR, Program, Team, flying, results, until

from crazychoir.bus.codec import encode
from crazychoir.bus.frames import Envelope, Frame, encode_frame
from crazychoir.bus.topics import ESTOP, HEARTBEAT, HELLO, ROSTER, ROUND, STATE, Class
from crazychoir.guidance.mission import load
from crazychoir.launch.network import apart
from crazychoir.swarm.config import SwarmConfig

pytestmark = [pytest.mark.system, pytest.mark.timeout(300), pytest.mark.usefixtures("compiled")]
DATA = Path(__file__).parents[1] / "data"
LOST_AFTER = 3.0
LEASE = 1.0
SAFE_PUT = 0.002
STANDING = '''
"""Every drone takes off, stands for a while, and lands."""

import re
import time
from crazychoir import CFDistributedFeedback
from crazychoir.runtime import watchdog

watchdog.GIVE_UP, watchdog.STUCK = 4.0, 5.0  # s, instead of 10 and 15


class Standing(CFDistributedFeedback):
    def __init__(self, i, duration):
        self.i, self.duration, self.steps = i, duration, 0

    def step(self, me, heard):
        self.steps += 1
        if self.i == 2 and self.steps == 50:
            {hang}
        return None


def guidance(i, config):
    return Standing(i, config.mission_options["duration"])
'''


def ahead_of_others() -> list[str]:
    """What lets a command go before the rest of this machine, whose load would show as late puts; [] if forbidden."""
    command = ["chrt", "--rr", "1"]
    allowed = subprocess.run([*command, "true"], check=False, capture_output=True).returncode == 0
    return command if allowed else []


def planners(instance: str, **network: float) -> SwarmConfig:
    """Drones in a ring that share pickups and deliveries, over a network that makes them plan for some seconds."""
    config = load("pickup_delivery").swarm(None, DATA / f"pickup_delivery_{instance}.json")
    options = {**json.loads(config.dumps())["mission_options"], "service_time": 0.2}
    changes = {"network": {"loss": 0.2, **network}, "mission_options": options, "flight": BRISK}
    return apart(config.replace(lost_after=LOST_AFTER, lease=LEASE, **changes), None)


def standing(folder: Path, duration: float, hang: str = "pass", drones: int = 4) -> SwarmConfig:
    """Drones in a row that stand for `duration` s; drone 2 hangs there."""
    folder.mkdir(exist_ok=True)
    path = folder / "standing.py"
    path.write_text(STANDING.format(hang=hang))
    return SwarmConfig.of(
        {
            "name": "standing",
            "mission": str(path),
            "mission_options": {"duration": duration},
            "drones": [{"id": i, "home": [float(i), 0.0, 0.0]} for i in range(drones)],
            "flight": {**BRISK, "takeoff_height": 0.3},
            "lost_after": LOST_AFTER,
            "lease": LEASE,
        }
    )


def seen(ended: dict[int, dict[str, Any]], i: int, j: int, state: str, after: float) -> float:
    """s after `after` at which drone i began to hold j for `state`."""
    history = ended[i]["presence"][str(i)]
    times = [t for t, who, what in history if (who, what) == (j, state) and t > after]
    assert times, f"drone {i} never saw drone {j} {state}: {history}"
    return times[0] - after


# A killed process ---------------------------------------------------------------------------------------------


async def kill_in_planning(folder: Path, victim: int) -> None:
    """Four drones: 0 and 2, like 1 and 3, are not neighbours; 0 is the coordinator."""
    config = planners("limited", delay=0.1)
    others = [i for i in config.ids if i != victim]
    first = ahead_of_others()
    async with flying(config, folder, lambda i: first) as team:
        await team.in_planning(5)
        killed = time.monotonic()
        team.agents[victim].signal(signal.SIGKILL)
        ended = await team.end(40.0, victim)
        ends = {i: team.agents[i].ended - killed for i in others}
    found = results(ended)
    for i in others:
        assert seen(ended, i, victim, "suspect", killed) <= 2 * LEASE
        assert ended[i]["code"] == 1
        assert not found[i]["success"]
        assert names(victim, found[i]["reason"]), found[i]["reason"]
        assert LOST_AFTER - 1.0 < ends[i] < LOST_AFTER + 6.0, ends


def names(j: int, reason: str) -> bool:
    """Whether a text names the drone as lost, or as having left."""
    return f"lost drone(s) {j}" in reason or f"left [{j}]" in reason


async def test_a_killed_process_in_planning_ends_the_mission_of_the_others_and_is_named(tmp_path):
    async with asyncio.TaskGroup() as group:
        group.create_task(kill_in_planning(tmp_path / "coordinator", 0))
        group.create_task(kill_in_planning(tmp_path / "member", 3))


# A stopped process --------------------------------------------------------------------------------------------


async def test_a_stopped_process_delays_nobody(tmp_path):
    config, first = apart(standing(tmp_path, 4.0), None), ahead_of_others()
    async with flying(config, tmp_path, lambda i: first) as team:
        await team.law()
        stopped = time.monotonic()
        team.agents[3].signal(signal.SIGSTOP)
        ended = await team.end(30.0, 3)
        assert min(team.agents[i].ended for i in ended) - stopped > 2.5
    for i in (0, 2):  # its neighbours; 1 does not talk to it
        assert seen(ended, i, 3, "suspect", stopped) <= 2 * LEASE
    for i in ended:
        assert ended[i]["code"] == 0, results(ended)
    assert {i: one["worst_put_s"] for i, one in ended.items() if one["worst_put_s"] >= SAFE_PUT} == {}


# A hanging event loop -----------------------------------------------------------------------------------------


async def run(folder: Path, hang: str, duration: float) -> tuple[dict[str, Any], str]:
    """`crazychoir run` of four standing drones of which drone 2, in a process of its own, hangs; its JSON and its
    standard error.
    """
    config = apart(standing(folder, duration, hang).replace(processes=[[0, 1, 3], [2]]), None)
    path = folder / "standing.json"
    path.write_text(config.dumps())
    program = await Program.start(*CRAZYCHOIR, "run", path, "--json")
    try:
        return await program.end(90), program.text
    finally:
        await program.kill()


def check_hang(ended: dict[str, Any], text: str, line: int) -> None:
    place = f"standing.py:{line} step"
    assert any("drone 2 guidance keeps the event loop" in said and place in said for said in text.splitlines()), text
    assert any("drone 2 guidance keeps the event loop" in said and place in said for said in ended["log"]), ended["log"]
    assert ended["code"] == 1
    for i in ("0", "1", "3"):
        assert ended["results"][i]["success"], ended["results"]


async def hang_in_python(folder: Path) -> None:
    """It is interrupted; drone 2 hovers, lands and says where its code hung."""
    ended, text = await run(folder, "while True: pass", 5.0)
    check_hang(ended, text, HANGING)
    reason = ended["reasons"]["2"]
    assert "guidance failed: Hung" in reason
    assert f"standing.py:{HANGING} step" in reason
    assert any("guidance failed: Hung" in said for said in ended["log"])
    assert "guidance failed" in text
    kept = [float(seconds) for seconds in re.findall(r"keeps the event loop for ([0-9.]+) s", text)]
    assert max(kept) < 2.0, "interrupted after a second"


async def hang_in_c(folder: Path) -> None:
    """Nothing can interrupt it: the process ends itself, and says where its code hung."""
    ended, text = await run(folder, "time.sleep(60)", 5.0)
    check_hang(ended, text, HANGING)
    assert ended["absent"] == [2]
    assert "this process ends itself" in text


async def hang_with_the_lock(folder: Path) -> None:
    """Not even the watchdog's thread gets a turn: the process is ended from C, and says where its code hung."""
    ended, text = await run(folder, "re.match('(a+)+$', 64 * 'a' + 'b')", 5.0)
    assert ended["absent"] == [2]
    assert "Timeout (0:00:05)!" in text
    assert f'standing.py", line {HANGING} in step' in text
    assert [ended["results"][i]["success"] for i in "013"] == [True] * 3, ended["results"]


HANGING = 1 + STANDING[: STANDING.index("{hang}")].count("\n")


async def test_a_hanging_step_is_named_and_only_its_drone_fails(tmp_path):
    async with asyncio.TaskGroup() as group:
        group.create_task(hang_in_python(tmp_path / "python"))
        group.create_task(hang_in_c(tmp_path / "c"))
        group.create_task(hang_with_the_lock(tmp_path / "lock"))


# Hostile bytes ------------------------------------------------------------------------------------------------


def opened(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in (("mode", "client"), ("connect/endpoints", [endpoint]), ("scouting/multicast/enabled", False)):
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def lies(draw: np.random.Generator, process: str) -> list[Envelope]:
    """Messages that look valid, from drones that the process does not fly, or that nobody flies."""
    sources = [j for j in range(6) if str(j) != process.split("-")[0]]
    payloads = [encode(None), encode([1, 2, [0], [3], 9, "x"]), encode({"epoch": 10**9}), draw.bytes(40)]
    topics = [ROUND, HEARTBEAT, ROSTER, STATE, ESTOP, HELLO]
    return [
        Envelope(topic.number, int(draw.choice(sources)), (0, 1, 2, 3), int(draw.integers(99)), 0, 0.0, "main", payload)
        for topic in topics
        for payload in payloads
    ]


def attack(config: SwarmConfig, ends: Callable[[], bool]) -> int:
    """Random bytes, and frames under the names of the agents and of a stranger, until `ends`; returns how many."""
    draw = np.random.default_rng(1)
    sent = 0
    with opened(config.endpoint(0)) as session:
        live = f"choir/{config.name}/live/*/*"
        tokens = [str(reply.ok.key_expr).split("/")[-2:] for reply in session.liveliness().get(live)]
        while not ends():
            for _, process in tokens:
                for host, claimed in (*tokens, ("nowhere", "stranger")):
                    key = f"choir/{config.name}/f/{process}/{host}/{claimed}"
                    frame = encode_frame(Frame(claimed, 1, Class.ROUNDS, lies(draw, claimed)))
                    session.put(f"{key}/rounds", draw.bytes(int(draw.integers(0, 400))))
                    session.put(f"{key}/control", frame)
                    sent += 2
            time.sleep(0.1)
    return sent


async def plan_and_fly_under_attack(folder: Path) -> None:
    config = planners("room", delay=0.05)
    async with flying(config, folder) as team:
        await team.in_planning(2)
        agents = list(team.agents.values())
        sent = await asyncio.to_thread(attack, config, lambda: any(p.process.returncode is not None for p in agents))
        ended = await team.end(60.0)
    assert [one["code"] for one in ended.values()] == [0] * len(config.ids), team.text
    assert load("pickup_delivery").report(config, results(ended))["success"]
    for one in ended.values():
        assert one["network"]["malformed"] > 10
        assert one["network"]["strangers"] > 10
        assert one["network"]["failed"] == 0
    assert sent > 500


# The emergency stop -------------------------------------------------------------------------------------------


async def stop(team: Team, *options: str) -> str:
    program = await Program.start(*CRAZYCHOIR, "stop", "--swarm", team.path, *options)
    ended = await program.end(30.0)
    assert ended["code"] == 0, program.text
    return str(ended["answer"])


async def stop_restart_and_clear(folder: Path) -> None:
    """A restarted agent hears of the stop from the others, and stays on the ground until an operator clears it."""
    config = apart(standing(folder, 60.0, drones=2), None)
    async with flying(config, folder) as team:
        await team.law()
        assert (await stop(team)).count("motors off") == 2
        await until(lambda: all(team.statuses(i)[-1]["phase"] == "stopped" for i in config.ids), 3.0)
        team.agents[1].signal(signal.SIGKILL)
        await team.agents[1].process.wait()
        await team.start((1,))
        await team.agents[1].says("emergency stop in force")
        before = len(team.statuses(1))
        await until(lambda: len(team.statuses(1)) > before + 8, 10.0)
        assert {status["phase"] for status in team.statuses(1)[before:]} == {"on ground"}
        assert team.agents[0].process.returncode is None
        assert (await stop(team, "--clear")).count("cleared") == 2
        first = await team.agents[0].end(10.0)
        assert first["code"] == 1
        assert "emergency stop" in first["results"]["0"]["reason"]


async def test_hostile_bytes_are_counted_and_an_emergency_stop_holds_until_it_is_cleared(tmp_path):
    async with asyncio.TaskGroup() as group:
        group.create_task(plan_and_fly_under_attack(tmp_path / "attack"))
        group.create_task(stop_restart_and_clear(tmp_path / "stop"))
