"""Two hosts: network namespaces joined by a veth pair, with monotonic clocks that differ by 1000 s."""

import asyncio
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from system.agents import BRISK, Team, flying, results
from system.namespaces import ADDRESSES, Hosts, two_hosts

from crazychoir.bus.network import authority
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission

pytestmark = pytest.mark.system
SKEW = 1000.0
OUTAGE = 1.3
MISSION = load_mission("pickup_delivery")


def demo(
    folder: Path, network: dict[str, float], groups: list[list[int]]
) -> SwarmConfig:
    """The demo's six drones and ten goods, three drones a host, flown briskly; with mutual TLS."""
    keys = folder / "keys"
    authority.make_authority(keys)
    for name in "ab":
        authority.add_host(keys, name)
    config = MISSION.swarm(None)
    raw = json.loads(config.dumps())
    return config.replace(
        hosts=dict(zip("ab", ADDRESSES, strict=True)),
        security={"operators": ["a"], "keys": str(keys)},
        drones=[
            {"id": d["id"], "home": d["home"], "host": "ab"[d["id"] // 3]}
            for d in raw["drones"]
        ],
        processes=groups,
        network=network,
        mission_options={**raw["mission_options"], "service_time": 0.2},
        flight=BRISK,
    )


def check_served(config: SwarmConfig, ended: dict[int, dict[str, Any]]) -> None:
    found = results(ended)
    assert [one["code"] for one in ended.values()] == [0] * len(ended), found
    report = MISSION.report(config, found)
    assert report["success"], report
    assert report["tasks"] == {"total": 10, "served": 10}


def states(ended: dict[int, dict[str, Any]]) -> list[str]:
    return [
        state
        for one in ended.values()
        for history in one["presence"].values()
        for _, _, state in history
    ]


def check_clocks(team: Team) -> None:
    """What each drone says of the other host's clock, until that has ended."""
    for i in team.config.ids:
        said = [status for status in team.statuses(i) if status["hosts"]]
        assert said, f"drone {i} knows nothing of the other clock"
        assert {host for status in said for host in status["hosts"]} == {"ba"[i // 3]}
        for status in said:
            assert (
                abs(status["offsets"][0] - (SKEW if i < 3 else -SKEW))
                <= status["offset_errors"][0]
            )
        assert said[-1]["offset_errors"][0] < 0.01


def clock_of(hosts: Hosts, host: int) -> float:
    program = [sys.executable, "-c", "import time; print(time.monotonic())"]
    return float(
        subprocess.run(
            [*hosts.command(host), *program], check=True, capture_output=True
        ).stdout
    )


async def cut_in_planning(hosts: Hosts, folder: Path, groups: list[list[int]]) -> None:
    """The hosts do not hear each other for a while as the six plan."""
    config = demo(folder, {"loss": 0.3, "delay": 0.02}, groups)
    async with flying(config, folder, lambda i: hosts.command(i // 3)) as team:
        await team.in_planning(10)
        hosts.cut()
        await asyncio.sleep(OUTAGE)
        assert team.planning_round() >= 10, (
            "the outage was not in the middle of planning"
        )
        hosts.mend()
        ended = await team.end(90)
        check_clocks(team)
    check_served(config, ended)
    assert "suspect" in states(ended), "no drone noticed the outage"


async def fly_undisturbed(hosts: Hosts, folder: Path) -> None:
    """One process a host."""
    config = demo(folder, {"loss": 0.3}, [[0, 1, 2], [3, 4, 5]])
    async with flying(config, folder, lambda i: hosts.command(i // 3)) as team:
        ended = await team.end(90)
    check_served(config, ended)


@pytest.mark.slow
@pytest.mark.timeout(300)  # the first test of a fresh clone waits for the compiler
async def test_demo_runs_on_two_hosts_with_different_clocks_through_a_partition(
    tmp_path, compiled
):
    """Two processes on one host, one on the other."""
    with two_hosts(SKEW) as hosts:
        assert clock_of(hosts, 1) - clock_of(hosts, 0) == pytest.approx(SKEW, abs=5.0)
        await cut_in_planning(hosts, tmp_path, [[0], [1, 2], [3, 4, 5]])


@pytest.mark.slow
@pytest.mark.timeout(300)
async def test_demo_on_two_pairs_of_hosts_at_once(tmp_path, compiled):
    """Three processes a host, through a partition, and beside them one process a host, undisturbed."""
    with two_hosts(SKEW) as hosts, two_hosts(SKEW) as others:
        async with asyncio.TaskGroup() as group:
            group.create_task(
                cut_in_planning(hosts, tmp_path / "cut", [[i] for i in range(6)])
            )
            group.create_task(fly_undisturbed(others, tmp_path / "undisturbed"))


def test_hosts_side_by_side_are_others_and_gone_afterwards():
    with two_hosts() as made, two_hosts() as others:
        names = made.names + others.names
        assert len(set(names)) == 4
        assert all(name in namespaces() for name in names)
    assert not any(name in namespaces() for name in names)


def namespaces() -> str:
    return subprocess.run(
        ["ip", "netns", "list"], check=True, capture_output=True, text=True
    ).stdout
