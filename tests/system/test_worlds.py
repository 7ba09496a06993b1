"""The owner of a world in a process of its own: all drones fly in it; a killed process leaves none hanging."""

import asyncio
import contextlib
import json
import os
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from ports import is_free
from system.agents import BRISK, CRAZYCHOIR, OBSERVER, WORLD, Program, until
from system.commands import call

from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.launch.network import isolate_swarm

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.timeout(180),
    pytest.mark.usefixtures("compiled"),
]
STANDING = '''
"""Every drone takes off, stands for a while, but no longer than until it was looked at, and lands."""

from pathlib import Path

from crazychoir import CFGuidance


class Standing(CFGuidance):
    async def mission(self):
        await self.take_off()
        await self.rendezvous()
        self.member.report = lambda: {"task": "standing"}
        options = self.member.config.mission_options
        for _ in range(round(10 * options["duration"])):
            if Path(options["looked"]).exists():
                break
            await self.sleep(0.1)
        await self.land()


def guidance(i, config):
    return Standing()
'''


def standing(
    folder: Path, duration: float, drones: int = 4, motors: int = 0, **tables: object
) -> SwarmConfig:
    """Drones in a row, in worlds with an owner: the first `motors` of them with motors and firmware."""
    folder.mkdir(exist_ok=True)
    path = folder / "standing.py"
    path.write_text(STANDING)
    config = SwarmConfig.of(
        {
            "name": "standing",
            "mission": str(path),
            "mission_options": {"duration": duration, "looked": str(folder / "looked")},
            "drones": [
                {
                    "id": i,
                    "home": [float(i), 0.0, 0.0],
                    **(
                        {"uri": WORLD_URIS.motor_level, "platform": "cf21"}
                        if i < motors
                        else {}
                    ),
                }
                for i in range(drones)
            ],
            "flight": {**BRISK, "takeoff_height": 0.5},
            "world": {"owned": True},
            "lost_after": 3.0,
            **tables,
        }
    )
    return isolate_swarm(config, None)


class Run:
    """`crazychoir run` of a swarm, and an observer of it."""

    def __init__(
        self, config: SwarmConfig, program: Program, observer: Program, path: Path
    ) -> None:
        self.config, self.program, self.observer, self.path = (
            config,
            program,
            observer,
            path,
        )

    def pid(self, word: str) -> int:
        """Return the id of the child process with this word in its command line."""
        pid = self.program.process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return next(
            int(c)
            for c in children
            if word in Path(f"/proc/{c}/cmdline").read_text().replace("\0", " ")
        )

    @property
    def tasks(self) -> dict[int, str]:
        """What each drone last said that it does."""
        heard = [
            json.loads(line) for line in self.observer.said if line.startswith("{")
        ]
        return {one["drone"]: one["status"]["task"] for one in heard if "status" in one}

    async def stands(self) -> None:
        """Until all drones stand in the air, and have met."""
        await until(
            lambda: (
                [self.tasks.get(i) for i in self.config.ids]
                == ["standing"] * len(self.config.ids)
            ),
            40.0,
            lambda: f"{self.tasks}: {self.program.text}",
        )


@contextlib.asynccontextmanager
async def running(config: SwarmConfig, folder: Path) -> AsyncIterator[Run]:
    """Run the swarm under the name and the ports that `crazychoir run` draws, with an observer."""
    path = folder / "swarm.json"
    path.write_text(config.dumps())
    program = await Program.start(*CRAZYCHOIR, "run", path, "--json")
    line = await program.says("--swarm ")
    flown = Path(line.rpartition("--swarm ")[2].strip())
    observer = await Program.start(*OBSERVER, flown)
    try:
        yield Run(config, program, observer, flown)
    finally:
        await asyncio.gather(program.kill(), observer.kill())


def gone(pids: list[int]) -> bool:
    """Whether none of these processes is left."""
    return not any(Path(f"/proc/{pid}").exists() for pid in pids)


@pytest.mark.slow
async def test_four_processes_fly_in_worlds_of_one_owner_that_others_can_look_into(
    tmp_path,
):
    async with running(standing(tmp_path, 60.0, motors=2), tmp_path) as run:
        await run.stands()
        said = await asyncio.to_thread(
            call, "crazychoir", "echo", "truth", "--swarm", run.path, "--seconds", 1
        )
        (tmp_path / "looked").touch()
        ended = await run.program.end(60.0)
    truths = [json.loads(line) for line in said.out.splitlines()]
    assert {truth["drone"] for truth in truths} == {0, 1, 2, 3}, said.err
    assert all(0.4 < truth["p"][2] < 0.6 for truth in truths)
    assert ended["code"] == 0, ended["reasons"]
    assert ended["min_separation_m"] == pytest.approx(1.0, abs=0.1), (
        "between drones of several processes, by the truth"
    )
    assert all(0.9 < far < 1.5 for far in ended["flown_m"].values()), ended["flown_m"]


async def kill_the_owner(folder: Path) -> None:
    """The drones of the killed owner are blind, and come down; every process ends, with the reason."""
    async with running(standing(folder, 60.0, drones=2), folder) as run:
        await run.stands()
        pids = [run.pid("cli.fly.world"), run.pid("--id 0"), run.pid("--id 1")]
        os.kill(pids[0], signal.SIGKILL)
        killed = time.monotonic()
        ended = await run.program.end(30.0)
        assert run.program.ended - killed < 12.0
        assert gone(pids)
    assert ended["code"] == 1
    assert "world: its owner was ended by SIGKILL" in run.program.text
    for i in ("0", "1"):
        assert "s old, limit" in ended["reasons"][i], ended["reasons"]
        assert "its world's owner (crazychoir-world) is silent" in ended["reasons"][i]


async def kill_an_agent(folder: Path) -> None:
    """The drone of the killed agent falls; the two others fly on, and land in the world that is still there."""
    async with running(standing(folder, 6.0, drones=3), folder) as run:
        await run.stands()
        os.kill(run.pid("--id 1"), signal.SIGKILL)
        ended = await run.program.end(60.0)
    assert ended["code"] == 1
    assert ended["absent"] == [1]
    assert all(ended["results"][i]["success"] for i in ("0", "2")), ended["results"]
    assert "drone 1: no command for" in run.program.text


@pytest.mark.slow
async def test_a_killed_owner_or_agent_leaves_no_process_hanging(tmp_path):
    async with asyncio.TaskGroup() as group:
        group.create_task(kill_the_owner(tmp_path / "owner"))
        group.create_task(kill_an_agent(tmp_path / "agent"))


def test_a_world_without_an_owner_is_refused(tmp_path):
    path = tmp_path / "swarm.json"
    config = standing(tmp_path, 1.0, world={})
    path.write_text(config.dumps())
    call("crazychoir-world", "--swarm", path).refuses(
        "swarm.json", "owned = true into [world]"
    )


async def test_a_second_owner_cannot_be_and_the_first_ends_when_it_is_told_to(tmp_path):
    path = tmp_path / "swarm.json"
    config = standing(tmp_path, 1.0)
    path.write_text(config.dumps())
    first = await Program.start(*WORLD, "--swarm", path, "--json")
    second = None
    try:
        await until(lambda: not is_free(config.base_port - 1), 20.0, lambda: first.text)
        second = await Program.start(*WORLD, "--swarm", path, "--json")
        assert (await second.end(20.0))["code"] == 2, second.text
        assert "must be a free port" in second.text
        first.signal(signal.SIGINT)
        ended = await first.end(10.0)
    finally:
        await asyncio.gather(
            *(program.kill() for program in (first, second) if program)
        )
    assert (ended["code"], ended["success"], ended["missed"] < ended["steps"]) == (
        0,
        True,
        True,
    )
    assert ended["commands"] == 0
