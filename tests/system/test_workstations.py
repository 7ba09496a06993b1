"""Three workstations as deploy/ has them: namespaces with those addresses, keys of `crazychoir keys`, mutual TLS."""

import asyncio
import contextlib
import shutil
import signal

import pytest
from system.agents import (
    AGENT,
    CRAZYCHOIR,
    MOCAP,
    RADIO,
    WORLD,
    Program,
    results,
    until,
)

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.namespaces import make_switched_namespaces

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.timeout(300),
]
FORMATION = load_mission("bearing_formation")
FOR_ALL = 120.0  # s


class Lab:
    """The workstations of a file of deploy/, each with a copy of that file and with its own keys beside it alone."""

    def __init__(self, file, folder, hosts):
        self.hosts, self.file, self.folder = hosts, file, folder
        self.config = SwarmConfig.load(file)
        self.programs = []

    async def keys(self):
        """Make the keys of all hosts and copy them there, as the guide says."""
        for words in (["init"], *(["add", name] for name in self.config.hosts)):
            made = await Program.start(
                *CRAZYCHOIR, "keys", *words, "--folder", self.folder / "keys"
            )
            assert (await made.end(20.0))["code"] == 0, made.text
        for name in self.config.hosts:
            shutil.copytree(
                self.folder / "keys" / name, self.folder / name / "keys" / name
            )
            shutil.copy(self.file, self.folder / name / "swarm.toml")

    async def start(self, host, *command):
        where = [
            *self.hosts.command(host),
            "sh",
            "-c",
            'cd "$0" && exec "$@"',
            self.folder / host,
        ]
        self.programs.append(await Program.start(*where, *command))
        return self.programs[-1]


@contextlib.asynccontextmanager
async def lab(file, folder):
    config = SwarmConfig.load(file)
    with make_switched_namespaces(config.hosts) as hosts:
        made = Lab(file, folder, hosts)
        try:
            await made.keys()
            yield made
        finally:
            await asyncio.gather(*(program.kill() for program in made.programs))


async def fly(made, each):
    """Agents with so many drones a process; returns what became of all, and of the tables that an operator sees."""
    agents = {}
    for host in made.config.hosts:
        ids = [drone.id for drone in made.config.drones if drone.host == host]
        for first in range(0, len(ids), each):
            words = [
                word for i in ids[first : first + each] for word in ("--id", str(i))
            ]
            agents[ids[first]] = await made.start(host, *AGENT, "--json", *words)
    ended = await asyncio.gather(*(agent.end(FOR_ALL) for agent in agents.values()))
    found = results(dict(zip(agents, ended, strict=True)))
    report = FORMATION.report(made.config, found)
    assert report["success"], (report, [agent.text for agent in agents.values()])
    assert sorted(found) == list(made.config.ids)
    return report


@pytest.mark.parametrize("each", [15, 3])
async def test_thirty_form_their_grid_from_three_workstations(
    repository, tmp_path, compiled, each
):
    async with lab(repository / "deploy/three_workstations.toml", tmp_path) as made:
        world = await made.start("physics", *WORLD, "--json")
        await fly(made, each)
        world.signal(signal.SIGINT)
        assert (await world.end(20.0))["success"], world.text


async def test_six_virtual_crazyflies_behind_dongles_of_two_workstations(
    repository, tmp_path, compiled
):
    async with lab(repository / "deploy/virtual_dongles.toml", tmp_path) as made:
        hall = await made.start(
            "physics", *CRAZYCHOIR, "virtual", "--swarm", "swarm.toml", "--json"
        )
        await until(lambda: "virtual Crazyflies" in hall.text, 30.0, lambda: hall.text)
        owners = [
            await made.start("physics", *MOCAP, "--json"),
            await made.start("left", *RADIO, "--dongle", "0", "--json"),
            await made.start("right", *RADIO, "--dongle", "1", "--json"),
        ]
        await fly(made, 3)
        for program in (*owners, hall):
            program.signal(signal.SIGINT)
            assert (await program.end(70.0))["success"], program.text
