"""What a client of Foxglove's protocol, written without its SDK, receives and commands."""

import asyncio
import contextlib
import json

import numpy as np
import pytest
from foxglove_client import foxglove_client
from observed_drones import TURNED, ObserverPlace
from system.agents import until

pytest.importorskip("foxglove", reason="needs the extra `foxglove`")

from crazychoir.bridges import foxglove_stream
from crazychoir.bridges.foxglove_layout import make_layout
from crazychoir.bridges.operator_services import OPERATOR_SERVICES
from crazychoir.errors import ConfigError
from crazychoir.runtime.clock import WallClock


@contextlib.asynccontextmanager
async def served(key=None):
    """Two moving drones, and a client that knows all topics."""
    place, said = ObserverPlace(WallClock(asyncio.get_running_loop())), []

    serving = asyncio.create_task(
        foxglove_stream.serve_foxglove(place, 0, 50.0, key, said.append)
    )
    moving = asyncio.create_task(place.move())
    try:
        await until(lambda: said, 20.0)
        port = _port(said[0])
        async with foxglove_client(port, channels=11) as client:
            yield place, client
    finally:
        for task in (moving, serving):
            task.cancel()
        await asyncio.wait([moving, serving])
        place.clock.close()


def _port(line):
    return int(line.split("ws://127.0.0.1:")[1].split(";")[0])


def entities(client):
    return {entity["id"]: entity for entity in client.last("/scene")["entities"]}


async def test_transforms_turn_and_move_each_drone_in_the_world():
    async with served() as (_, client):
        assert client.channels["/tf"]["schemaName"] == "foxglove.FrameTransforms"
        await client.subscribe("/tf")
        await client.until(lambda: len(client.heard.get("/tf", [])) >= 3)
    first, *_, last = client.heard["/tf"]
    one, other = last["transforms"]
    assert (one["parent_frame_id"], one["child_frame_id"]) == ("world", "drone3")
    assert other["child_frame_id"] == "drone8"
    assert (one["translation"]["y"], one["translation"]["z"]) == (3.0, 1.0)
    turn = one["rotation"]
    assert [turn.get(name, 0.0) for name in "xyzw"] == pytest.approx(TURNED, abs=1e-6)
    moved = one["translation"]["x"] - first["transforms"][0]["translation"].get(
        "x", 0.0
    )
    assert moved > 0.0


async def test_a_scene_has_fence_drones_trails_and_routes_where_they_are():
    async with served() as (_, client):
        await client.subscribe("/scene")
        await client.until(
            lambda: (
                "/scene" in client.heard
                and {"trail of drone 3", "route of drone 3"} <= entities(client).keys()
            )
        )
        found = entities(client)
    assert client.last("/scene")["deletions"][0]["type"] == "ALL"
    assert len(found["fence"]["lines"][0]["points"]) == 24
    arms = found["drone8 arms"]
    assert (arms["frame_id"], arms["frame_locked"]) == ("drone8", True)
    assert found["drone8 number"]["texts"][0]["text"] == "8"
    trail = found["trail of drone 3"]["lines"][0]["points"]
    steps = np.diff([point.get("x", 0.0) for point in trail])
    assert steps.min() >= 0.03 - 1e-6
    assert {point["y"] for point in trail} == {3.0}
    route = found["route of drone 3"]["lines"][0]["points"]
    assert route[-1] == {"x": 2.0, "z": 1.0}
    assert "route of drone 8" not in found


async def test_states_references_status_links_and_log_are_typed_messages():
    topics = ["/drone3/state", "/drone3/reference", "/drone3/status", "/drone3/link"]
    async with served() as (_, client):
        await client.subscribe(*topics, "/log")
        await client.until(lambda: client.heard.keys() >= {*topics, "/log"})
    state, reference, status, link = map(client.last, topics)
    assert client.channels["/drone3/state"]["schemaName"] == "nav_msgs/msg/Odometry"
    assert state["pose"]["pose"]["position"]["y"] == 3.0
    assert state["twist"]["twist"]["linear"]["y"] == pytest.approx(-0.5)
    assert reference["p"]["z"] == 1.5
    assert (status["phase"], status["cost"]) == ("flying", 3.0)
    assert (link["state"], link["battery"]) == ("up", 3.9)
    assert state["header"]["stamp"]["sec"] > 1_700_000_000
    line = client.heard["/log"][-1]
    assert (line["level"], line["message"]) == ("INFO", "commanded: hold")
    assert line["name"] == "drone 8"


async def test_a_service_gives_a_command_and_answers_with_its_receipt():
    async with served("secret") as (place, client):
        await client.until(lambda: len(client.services) == len(OPERATOR_SERVICES))
        done = await client.call("/crazychoir/land", key="secret", drones=[3])
        both = await client.call("/crazychoir/land", key="secret")
        place.told.clear()
        goals = {"drones": [3], "p": [0.0, 0.5, 1.0], "yaw": 1.0}
        await client.call("/crazychoir/go_to", key="secret", **goals)
        moves = {"drones": [3], "v": [0.3, 0.0, 0.0], "duration": 2.0}
        await client.call("/crazychoir/velocity", key="secret", **moves)
        await client.call("/crazychoir/stop", key="secret", drones=[8])
    assert done == {
        "done": True,
        "answers": {"3": {"answer": "done", "says": "landed"}},
    }
    refusal = {"answer": "refused", "says": "it is on the ground"}
    assert (both["done"], both["answers"]["8"]) == (False, refusal)
    velocity = {"v": [0.3, 0.0, 0.0], "yaw_rate": 0.0, "duration": 2.0}
    assert place.told == [
        ("go-to", {"p": [0.0, 0.5, 1.0], "yaw": 1.0}),
        ("velocity", velocity),
    ]
    assert place.stopped == [8]


@pytest.mark.parametrize(
    ("request_fields", "why"),
    [
        ({}, "found none"),
        ({"key": "guess"}, "found another one"),
        ({"key": "secret", "drones": [4]}, "allowed: 3, 8"),
        ({"key": "secret", "drones": []}, "length >= 1"),
        ({"key": "secret", "height": 2.0}, "drones"),
    ],
)
async def test_a_call_that_cannot_be_carried_out_is_refused_with_the_reason(
    request_fields, why
):
    async with served("secret") as (place, client):
        await client.until(lambda: len(client.services) == len(OPERATOR_SERVICES))
        with pytest.raises(RuntimeError, match=why):
            await client.call("/crazychoir/land", **request_fields)
        assert place.told == []


async def test_a_call_that_waits_when_the_server_ends_holds_nothing_up():
    async with served("secret") as (place, client):
        await client.until(lambda: len(client.services) == len(OPERATOR_SERVICES))
        del place.bus.ports[8]
        call = asyncio.create_task(client.call("/crazychoir/land", key="secret"))
        await client.until(lambda: place.told)
    call.cancel()


async def test_without_a_key_there_are_no_services():
    async with served() as (_, client):
        assert client.info["capabilities"] == []
        assert client.services == {}


async def test_a_taken_port_is_refused():
    async with served() as (place, client):
        port = client.socket.remote_address[1]
        with pytest.raises(ConfigError, match="free port"):
            await foxglove_stream.serve_foxglove(place, port, 20.0, None, print)


async def test_the_layout_shows_topics_and_services_that_are_there():
    layout = make_layout([3, 8], "secret")
    panels = layout["configById"]
    paths = [
        path["value"] for config in panels.values() for path in config.get("paths", [])
    ]
    async with served("secret") as (_, client):
        assert {
            "/" + "/".join(path.split(".")[0].split("/")[1:]) for path in paths
        } <= client.channels.keys()
        assert {"/scene", "/log"} <= client.channels.keys()
        await client.subscribe("/drone3/state", "/drone3/status", "/drone3/link")
        await client.until(lambda: len(client.heard) == 3)
        await client.until(lambda: len(client.services) == len(OPERATOR_SERVICES))
    for path in paths:
        topic, *names = path.split(".")
        if topic.startswith("/drone3/"):
            value = client.last(topic)
            for name in names:
                value = value[name]
            assert isinstance(value, str | float | int), path
    calls = [config for config in panels.values() if "serviceName" in config]
    assert {config["serviceName"] for config in calls} <= client.services.keys()
    requests = [json.loads(config["requestPayload"]) for config in calls]
    assert {request["key"] for request in requests} == {"secret"}
    assert [request["drones"] for request in requests if "drones" in request] == [[3]]
    placed = json.dumps(layout["layout"]) + json.dumps(panels["Tab!plots"])
    assert all(f'"{name}"' in placed for name in panels)
