"""The owner of a dongle with twelve virtual drones over UDP, through cflib, in one process and in real time."""

import asyncio
import contextlib
import json
import math

import numpy as np
import pytest
from dongle_flights import crowd
from system.hall import udp_block

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.radio.owner import RadioProcess
from crazychoir.radio.virtual.air import VirtualDongle
from crazychoir.radio.virtual.server import VirtualServer
from crazychoir.radio.virtual.setup import dongle_groups, select_from_swarm
from crazychoir.runtime.clock import WallClock
from crazychoir.types import XYZ, Pose

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.usefixtures("compiled"),
]
HEIGHT, RADIUS, PERIOD = 0.6, 0.2, 4.0


def at_free_ports(config):
    raw, first = json.loads(config.dumps()), udp_block(len(config.ids))
    for k, drone in enumerate(raw["drones"]):
        drone["uri"] = f"udp://127.0.0.1:{first + k}"
    raw["mocap"]["port"] = first - 1
    return SwarmConfig.of(raw)


@contextlib.asynccontextmanager
async def owner_of(config, folder, monkeypatch):
    """The virtual drones on their dongle, their owner, and cameras that see them 50 times a second."""
    clock = WallClock(asyncio.get_running_loop())
    monkeypatch.setattr("crazychoir.radio.owner.tables_folder", lambda: folder)
    hall = select_from_swarm(config, None)
    radios = [VirtualDongle(clock, *group) for group in dongle_groups(hall, None, None)]
    server = VirtualServer(clock, hall.world(0), hall.seats, hall.poses, radios)
    server.listen()
    owner = RadioProcess(clock, config, 0, "dongle0", "here", 1)

    async def see():
        async for _ in clock.ticks(50.0):
            for i, drone in owner.drones.items():
                x = server.world.states[server.world.row[i]]
                pose = Pose(np.array([*x[:3], *x[6:10]]))
                drone.view.pose.put(pose, 0.0)
                drone.view.see(pose, 0.0)

    serving = asyncio.create_task(owner.serve())
    running = [asyncio.create_task(task) for task in (server.run(), see())]
    try:
        yield owner, server
    finally:
        owner.abort("the test has ended")
        await asyncio.wait([serving], timeout=5.0)
        for task in running:
            task.cancel()
        await asyncio.wait(running)
        await server.on_stop()
        clock.close()


async def command(owner, seconds, choose):
    """Send each drone a command ten times a second; choose: of its id and the s since the start, or None."""
    began = owner.clock.now()
    async for _ in owner.clock.ticks(10.0):
        t = owner.clock.now() - began
        if t > seconds:
            return
        for i, drone in owner.drones.items():
            if (chosen := choose(i, t)) is not None:
                drone.commands.send(XYZ(chosen[0], np.array(chosen[1:])))


async def test_twelve_drones_of_one_dongle_fly_a_figure_through_cflib(
    tmp_path, monkeypatch
):
    config = at_free_ports(crowd(12, connect_deadline=30.0))
    homes = {i: config.drone(i).home for i in config.ids}

    def circle(i, t):
        w = 2.0 * math.pi * min(t + 0.2, PERIOD) / PERIOD
        x = homes[i][0] + RADIUS * (1.0 - math.cos(w))
        y = homes[i][1] + RADIUS * math.sin(w)
        return "line", x, y, HEIGHT, 0.0, 0.2

    async with owner_of(config, tmp_path, monkeypatch) as (owner, server):
        assert owner.plan.broadcasts
        async with asyncio.timeout(60.0):
            async for _ in owner.clock.ticks(10.0):
                drones = owner.drones.values()
                if not any(drone.report.find_problems() for drone in drones):
                    break
        await command(
            owner,
            4.0,
            lambda i, t: (
                None
                if owner.drones[i].estimate.is_flying
                else ("take_off", 0.0, 0.0, HEIGHT, 0.0, 2.0)
            ),
        )
        assert all(
            abs(server.world.states[row][2] - HEIGHT) < 0.2
            for row in server.world.row.values()
        )
        await command(owner, PERIOD + 1.0, circle)
        await command(owner, 5.0, lambda i, t: ("land", *homes[i][:2], -0.25, 0.0, 3.0))
        for i, home in homes.items():
            place = server.world.states[server.world.row[i]][:3]
            assert math.dist(place, home) < 0.3
            assert server.world.resting(i)
            assert not server.world.harm(i)
            assert server.drones[i].flight.zeros == 0
        assert owner.report()["poses"]["broadcast"] > 12 * 10 * 10
