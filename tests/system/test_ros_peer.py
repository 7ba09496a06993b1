"""Drones in flight, as Foxglove's protocol and an independent implementation of rmw_zenoh see and command them."""

import asyncio
import json

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="needs the extra `foxglove`")
pytest.importorskip("xxhash", reason="keys of rmw_zenoh need the extra `ros2`")

from foxglove_client import foxglove_client
from ros2_decoders import fields
from ros2_peer import made, ros_peer, ros_router
from system.agents import CRAZYCHOIR, Program, flying, until
from system.pages import six

pytestmark = [pytest.mark.system, pytest.mark.real_time, pytest.mark.timeout(300)]
TOPICS = {
    "/drone1/pose": "geometry_msgs/msg/PoseStamped",
    "/drone1/path": "nav_msgs/msg/Path",
    "/drone1/odom": "nav_msgs/msg/Odometry",
    "/drone1/status": "std_msgs/msg/String",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/drones": "visualization_msgs/msg/MarkerArray",
}


def goal_of(peer, x, y, z):
    stamp = made("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    return {
        "header": made("std_msgs/msg/Header", stamp=stamp, frame_id="world"),
        "pose": made(
            "geometry_msgs/msg/Pose",
            position=made("geometry_msgs/msg/Point", x=x, y=y, z=z),
            orientation=made(
                "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0
            ),
        ),
    }


def twist_of(x, y, z):
    stamp = made("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    none = made("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    linear = made("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
    return {
        "header": made("std_msgs/msg/Header", stamp=stamp, frame_id="drone1"),
        "twist": made("geometry_msgs/msg/Twist", linear=linear, angular=none),
    }


async def test_foxglove_and_ros_show_six_drones_and_fly_them(tmp_path, compiled):
    async with flying(six(processes=1), tmp_path / "team") as team:
        await team.phase("on ground", seconds=100.0)
        with ros_router() as port, ros_peer(port, tmp_path / "messages") as peer:
            router = f"tcp/127.0.0.1:{port}"
            swarm = ("--swarm", team.path, "--commands")
            bridge = await Program.start(
                *CRAZYCHOIR, "ros", "--connect", router, *swarm
            )
            server = await Program.start(
                *CRAZYCHOIR,
                "foxglove",
                "--port",
                "0",
                "--layout",
                tmp_path / "a.json",
                *swarm,
            )
            try:
                await fly_by_both(peer, bridge, server, tmp_path / "a.json")
            finally:
                await bridge.kill()
                await server.kill()
        assert "Traceback" not in bridge.text + server.text
        await team.end(40.0)


async def fly_by_both(peer, bridge, server, layout):
    for topic, kind in TOPICS.items():
        await asyncio.to_thread(peer.subscribe, topic, kind)
    line = await server.says("for Foxglove", 120.0)
    port = int(line.split("ws://127.0.0.1:")[1].split(";")[0])
    panels = json.loads(layout.read_text())["configById"]
    key = json.loads(panels["CallService!land"]["requestPayload"])["key"]
    async with foxglove_client(port, channels=27) as client:
        await client.subscribe("/tf", "/scene", "/drone1/status")
        await until(lambda: all(peer.heard.values()), 120.0, lambda: bridge.text)
        listed = {name: [kind] for name, kind in TOPICS.items()}
        await until(
            lambda: listed.items() <= peer.topics().items(), 60.0, lambda: bridge.text
        )
        up = await asyncio.to_thread(peer.trigger, "/crazychoir/take_off")
        assert up.success, up.message
        goals = await asyncio.to_thread(
            peer.publisher, "/drone1/goal_pose", "geometry_msgs/msg/PoseStamped"
        )
        velocities = await asyncio.to_thread(
            peer.publisher, "/drone1/cmd_vel", "geometry_msgs/msg/TwistStamped"
        )
        await asyncio.sleep(0.3)
        place = np.array([0.3, -0.7, 1.2])
        goals.publish(**goal_of(peer, *place.tolist()))

        def position():
            found = fields(peer.heard["/drone1/pose"][-1])["pose"]["position"]
            return np.array(list(found.values()))

        await until(
            lambda: np.linalg.norm(position() - place) < 0.1,
            60.0,
            lambda: str(position()),
        )
        for _ in range(10):  # of a stream of 1 s, then the drone rests by itself
            velocities.publish(**twist_of(0.3, 0.0, 0.0))
            await asyncio.sleep(0.1)
        await asyncio.sleep(1.5)
        rested = position()
        ahead = np.array([0.4, 0.0, 0.0])
        assert rested == pytest.approx(place + ahead, abs=0.2)
        moves = {"drones": [1], "v": [-0.4, 0.0, 0.0], "duration": 1.0}
        moved = await client.call("/crazychoir/velocity", key=key, **moves)
        assert moved["done"], moved
        await asyncio.sleep(1.0)
        assert rested[0] - 0.6 < position()[0] < rested[0] - 0.2
        seen = {one["child_frame_id"]: one for one in client.last("/tf")["transforms"]}
        assert len(seen) == 6
        assert list(seen["drone1"]["translation"].values()) == pytest.approx(
            position().tolist(), abs=0.15
        )
        entities = {one["id"] for one in client.last("/scene")["entities"]}
        assert {"fence", "drone5 arms", "trail of drone 1"} <= entities
        assert json.loads(peer.heard["/drone1/status"][-1].data)["phase"]
        down = await asyncio.to_thread(peer.trigger, "/drone1/land")
        assert (down.success, down.message) == (True, "drone 1: done: on ground")
        rest = await client.call("/crazychoir/land", key=key, drones=[0, 2, 3, 4, 5])
        assert rest["done"], rest
