"""Hosts that do not reach each other, and a third host with a router that passes on what they say, in namespaces."""

import asyncio
import contextlib
import json
import secrets
import signal
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
from system.agents import BRISK, CRAZYCHOIR, Program, flying, results

from crazychoir.bus.network import authority
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.namespaces import (
    NAMESPACE_DEVICE,
    connect_devices,
    make_namespace,
    run_iproute,
)

pytestmark = pytest.mark.system
MISSION = load_mission("pickup_delivery")
INSTANCE = Path(__file__).parents[1] / "data" / "pickup_delivery_room.json"
"""Three drones with four tasks."""
ADDRESSES = {"a": "10.78.1.1", "b": "10.78.2.1", "r": "10.78.1.254"}
GATES = {"a": "10.78.1.254", "b": "10.78.2.254"}


@dataclass
class Apart:
    """Namespaces a, b, r: a and b have a link to r each, which forwards no packets."""

    names: dict[str, str]

    def command(self, host):
        return ["ip", "netns", "exec", self.names[host]]


@contextlib.contextmanager
def apart():
    token = secrets.token_hex(3)
    hosts = Apart({name: f"cc-{token}-{name}" for name in "abr"})
    with contextlib.ExitStack() as stack:
        for name in hosts.names.values():
            stack.enter_context(make_namespace(name))
        router = hosts.names["r"]
        keep_packets = "echo 0 > /proc/sys/net/ipv4/ip_forward"
        subprocess.run([*hosts.command("r"), "sh", "-c", keep_packets], check=True)
        for name, gate in GATES.items():
            there = hosts.names[name]
            connect_devices((there, NAMESPACE_DEVICE), (router, f"veth{name}"))
            run_iproute(
                "-n",
                there,
                "address",
                "add",
                f"{ADDRESSES[name]}/24",
                "dev",
                NAMESPACE_DEVICE,
            )
            run_iproute(
                "-n", router, "address", "add", f"{gate}/24", "dev", f"veth{name}"
            )
            run_iproute("-n", there, "route", "add", "default", "via", gate)
        yield hosts


def planners(folder, secured):
    """Return a swarm of three drones: two on a, one on b, the router on r."""
    keys = folder / "keys"
    authority.make_authority(keys)
    for name in "abr":
        authority.add_host(keys, name)
    config = MISSION.swarm(None, INSTANCE)
    raw = json.loads(config.dumps())
    security = (
        {"operators": ["a"], "keys": str(keys)} if secured else {"insecure": True}
    )
    return config.replace(
        hosts=ADDRESSES,
        router="r",
        security=security,
        drones=[
            {"id": d["id"], "home": d["home"], "host": "ab"[d["id"] // 2]}
            for d in raw["drones"]
        ],
        processes=[[0, 1], [2]],
        mission_options={**raw["mission_options"], "service_time": 0.2},
        flight=BRISK,
    )


@pytest.mark.timeout(300)  # the first test of a fresh clone waits for the compiler
@pytest.mark.parametrize("secured", [True, pytest.param(False, marks=pytest.mark.slow)])
async def test_a_mission_flies_on_hosts_that_reach_the_router_alone(
    tmp_path, compiled, secured
):
    config = planners(tmp_path, secured)
    file = tmp_path / "router.json"
    file.write_text(config.dumps())
    with apart() as hosts:
        router = await Program.start(
            *hosts.command("r"), *CRAZYCHOIR, "router", "--swarm", file
        )
        try:
            await router.says("router at")
            async with flying(
                config, tmp_path / "team", lambda i: hosts.command("ab"[i // 2])
            ) as team:
                ended = await team.end(120)
            report = MISSION.report(config, results(ended))
            assert report["success"], (report, team.text)
            assert report["tasks"] == {"total": 4, "served": 4}
            router.signal(signal.SIGINT)
            assert (await router.end(10))["code"] == 0, router.text
        finally:
            await router.kill()


@pytest.mark.timeout(300)
async def test_without_a_router_they_do_not_find_each_other(tmp_path, compiled):
    """The hosts of the test above are apart: no other program passes anything on."""
    config = planners(tmp_path, secured=False).replace(router=None, start_deadline=4.0)
    with apart() as hosts:
        async with flying(
            config, tmp_path / "team", lambda i: hosts.command("ab"[i // 2])
        ) as team:
            await asyncio.sleep(0)
            ended = await team.end(120)
    reasons = {i: result["reason"] for i, result in results(ended).items()}
    assert "drone(s) 2 absent after 4 s" in reasons[0]
    assert "drone(s) 0, 1 absent after 4 s" in reasons[2]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("secured", [True, False])
async def test_a_router_that_is_killed_and_started_again_is_found_again(
    tmp_path, compiled, secured
):
    """The three are in the middle of planning."""
    config = planners(tmp_path, secured).replace(network={"loss": 0.3, "delay": 0.02})
    file = tmp_path / "router.json"
    file.write_text(config.dumps())
    routers = []
    with apart() as hosts:

        async def route():
            routers.append(
                await Program.start(
                    *hosts.command("r"), *CRAZYCHOIR, "router", "--swarm", file
                )
            )
            await routers[-1].says("router at")

        try:
            await route()
            async with flying(
                config, tmp_path / "team", lambda i: hosts.command("ab"[i // 2])
            ) as team:
                await team.in_planning(10)
                await routers[0].kill()
                await asyncio.sleep(1.0)
                await route()
                ended = await team.end(120)
            report = MISSION.report(config, results(ended))
            assert report["success"], (report, team.text)
            assert report["tasks"] == {"total": 4, "served": 4}
        finally:
            await asyncio.gather(*(router.kill() for router in routers))
