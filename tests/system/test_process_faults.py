"""What happens to processes and cables in flight: six drones with firmware, two hosts, mutual TLS, a bad cable.

Each test adds what became of it to out/process_faults.jsonl, a line each.
"""

import asyncio
import contextlib
import json
import signal
import subprocess
import time

import pytest
from system.agents import CRAZYCHOIR, WORLD, Program, flying, results, seen, until
from system.lossy_link import wired

from crazychoir.bus.network import authority
from crazychoir.flight.judge import CUT_OFF_TEXT
from crazychoir.guidance.mission import load_mission

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.timeout(300),
    pytest.mark.usefixtures("compiled"),
]
MISSION = load_mission("online_delivery")
ADDRESSES = {"a": "10.79.0.1", "b": "10.79.0.2"}
LEASE = 1.0
VICTIM = 3
"""A drone of host b; the world is on host a."""
FIRST, SECOND = (0, 1, 2), (3, 4, 5)
"""The drones of host a, and those of host b."""


def delivery(folder):
    """Six drones with motors and firmware, eight goods."""
    keys = folder / "keys"
    authority.make_authority(keys)
    for name in ADDRESSES:
        authority.add_host(keys, name)
    config = MISSION.swarm(6)
    drones = [
        {
            "id": d.id,
            "home": list(d.home),
            "host": "a" if d.id in FIRST else "b",
            "uri": "sim://motors",
        }
        for d in config.drones
    ]
    raw = json.loads(config.dumps())
    return config.replace(
        hosts=ADDRESSES,
        drones=drones,
        world={"owned": True, "host": "a"},
        lease=LEASE,
        graph="complete",
        security={"operators": ["a"], "keys": str(keys)},
        start_deadline=60.0,
        mission_options={**raw["mission_options"], "tasks": 8, "later": 0},
        flight={
            "takeoff_height": 0.6,
            "speed_limit": 1.0,
            "acceleration_limit": 2.0,
            "landing_speed": 0.4,
        },
    )


@contextlib.asynccontextmanager
async def in_flight(folder):
    """All of them on their way; the world, the team and the cable."""
    config = delivery(folder)
    async with wired(ADDRESSES, loss=0.01, delay=0.005) as cable:
        file = folder / "world.json"
        file.write_text(config.dumps())
        world = await Program.start(
            *cable.command("a"), *WORLD, "--swarm", file, "--json"
        )
        try:
            place = {i: cable.command("a" if i in FIRST else "b") for i in config.ids}
            async with flying(config, folder / "team", lambda i: place[i]) as team:
                await until(
                    lambda: under_way(team.newest()),
                    90.0,
                    lambda: f"{team.newest()} {world.text}",
                )
                yield world, team, cable
        finally:
            await world.kill()


def under_way(statuses):
    """Whether one drone of either host does its part of the mission."""
    return statuses[0]["phase"] == statuses[VICTIM]["phase"] == "mission"


def score(folder, name, world, found, **figures):
    """Append one line of results and return it; check that no task was delivered twice and no drone crashed."""
    stops = [
        stop["task"]
        for one in found.values()
        for stop in one.get("served", [])
        if stop["kind"] == "delivery"
    ]
    assert len(stops) == len(set(stops)), stops
    reasons = {i: one.get("reason", "") for i, one in sorted(found.items())}
    line = {"fault": name, **figures, "delivered": len(stops), "reasons": reasons}
    line["firmware"] = [
        said
        for said in world.said
        if "landing" in said or "crash" in said or "hit" in said
    ]
    out = folder / "out"
    out.mkdir(exist_ok=True)
    with (out / "process_faults.jsonl").open("a") as file:
        file.write(json.dumps(line) + "\n")
    assert not any("crash" in said or "hit" in said for said in world.said), world.text
    return line


async def ending(world):
    """The world's own account of its drones."""
    world.signal(signal.SIGINT)
    return await world.end(30.0)


async def test_one_of_six_is_killed_and_the_rest_finish(tmp_path, repository):
    async with in_flight(tmp_path) as (world, team, _):
        killed = time.monotonic()
        team.agents[VICTIM].signal(signal.SIGKILL)
        ended = await team.end(150.0, VICTIM)
        await ending(world)
    found, others = results(ended), [i for i in team.config.ids if i != VICTIM]
    named = max(seen(ended, i, VICTIM, "suspect", killed) for i in others)
    line = score(repository, "kill -9", world, found, named_s=named)
    assert named <= 2 * LEASE
    assert any(
        f"drone {VICTIM}" in said and "landing" in said for said in world.said
    ), world.text
    assert all(found[i]["success"] for i in others), line


async def test_a_process_that_is_killed_and_restarted_takes_part_again(
    tmp_path, repository
):
    """Meanwhile the firmware has landed the drone of the killed process."""
    async with in_flight(tmp_path) as (world, team, _):
        await asyncio.sleep(0.5)
        killed = time.monotonic()
        team.agents[VICTIM].signal(signal.SIGKILL)
        await world.says(f"drone {VICTIM}", 10.0)
        await asyncio.sleep(6.0)
        again = time.monotonic()
        await team.start((VICTIM,))
        ended = await team.end(150.0)
        await ending(world)
    found, others = results(ended), [i for i in team.config.ids if i != VICTIM]
    back = max(seen(ended, i, VICTIM, "alive", again) for i in others)
    line = score(
        repository,
        "kill -9, started again",
        world,
        found,
        heard_again_s=back,
        away_s=again - killed,
    )
    assert all(found[i]["success"] for i in others), line
    assert found[VICTIM]["success"], (line, team.agents[VICTIM].text)


@pytest.mark.parametrize("length", [2.0, 5.0, 15.0])
async def test_a_partition_that_heals(tmp_path, repository, length):
    """Drones without cameras are landed. Drones with cameras go on as long as they hear more than half of the team."""
    async with in_flight(tmp_path) as (world, team, cable):
        cut = time.monotonic()
        cable.change(cut=1)
        await asyncio.sleep(length)
        cable.change(cut=0)
        ended = await team.end(150.0)
        await ending(world)
    found = results(ended)
    named = {i: seen(ended, i, VICTIM, "suspect", cut) for i in FIRST}
    line = score(
        repository,
        f"partition of {length:g} s",
        world,
        found,
        named_s=max(named.values()),
    )
    assert max(named.values()) <= 2 * LEASE
    deaf = (
        CUT_OFF_TEXT if length > 10.0 else "-"
    )  # by then half of the team lands, wherever it is
    assert all(found[i]["success"] or deaf in found[i]["reason"] for i in FIRST), line


async def test_a_process_that_is_stopped_for_3_s_is_suspected_and_the_others_succeed(
    tmp_path, repository
):
    async with in_flight(tmp_path) as (world, team, _):
        stopped = time.monotonic()
        team.agents[VICTIM].signal(signal.SIGSTOP)
        await asyncio.sleep(3.0)
        team.agents[VICTIM].signal(signal.SIGCONT)
        ended = await team.end(150.0)
        await ending(world)
    found, others = results(ended), [i for i in team.config.ids if i != VICTIM]
    named = max(seen(ended, i, VICTIM, "suspect", stopped) for i in others)
    line = score(repository, "SIGSTOP of 3 s", world, found, named_s=named)
    assert named <= 2 * LEASE
    assert all(found[i]["success"] for i in others), line


async def test_a_full_disk_ends_the_recording_and_not_the_flight(small_disk):
    flown = await Program.start(
        *CRAZYCHOIR,
        "run",
        "pickup_delivery",
        "--record",
        small_disk / "flight.mcap",
        "--json",
    )
    result = await flown.end(150.0)
    told = result["recording"]
    assert (result["success"], result["code"]) == (True, 0), flown.text
    assert "No space left" in told["error"]
    assert told["lost"] > 0


@pytest.fixture
def small_disk(tmp_path):
    """A folder that half a megabyte fills."""
    folder = tmp_path / "small"
    folder.mkdir()
    subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", folder], check=True
    )
    yield folder
    subprocess.run(["umount", folder], check=True)
