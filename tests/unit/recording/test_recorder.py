"""The recorder: all that drones say, exactly; nothing that goes wrong in it reaches them."""

import asyncio
import json
import logging
import time

import numpy as np
import pytest
from ros2_decoders import by_mcap_ros2, by_rosbags
from virtual_time import virtual

from crazychoir.bus.codec import encode
from crazychoir.bus.message import Message
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import (
    DRONE_TOPICS,
    MESSAGE_TOPICS,
    OBSERVABLE_TOPICS,
)
from crazychoir.recording import recorder as module
from crazychoir.recording.mcap.file import RecordingFile
from crazychoir.recording.mcap.reading import read_header
from crazychoir.recording.recorder import Recorder
from crazychoir.runtime.clock import run_virtual, run_wall
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.team.message_kind import EPOCH_SHIFT
from crazychoir.types import (
    FPQR,
    Body,
    FullState,
    LinkStatus,
    Plan,
    Pose,
    State,
    Status,
    Vel,
)

ABOUT = {"version": "1.2"}


def recorded(path, work, observer=None, run=run_virtual):
    """What the recorder says after `work(clock, bus)` with drones 0 and 1."""

    async def main(clock):
        bus = Bus(clock)
        for address in (0, 1, *([] if observer is None else [observer])):
            bus.port(address)
        bus.tap = lambda *message: None
        recorder = Recorder(
            bus, (0, 1), RecordingFile(path, ABOUT, "{}", False), observer
        )
        supervisor = Supervisor(clock, "test")
        running = asyncio.create_task(supervisor.run([recorder]))
        await clock.sleep(0.1)
        await work(clock, bus)
        supervisor.stop()
        await running
        return recorder.result()

    return run(main)


VALUES = {
    DRONE_TOPICS.pose: Pose(np.arange(7.0), 0.25),
    DRONE_TOPICS.state: State.at((1, 2, 3), (4, 5, 6)),
    DRONE_TOPICS.reference: FullState(np.arange(14.0)),
    DRONE_TOPICS.command: FPQR(np.arange(4.0)),
    DRONE_TOPICS.truth: State.at((7, 8, 9)),
    DRONE_TOPICS.status: Status("hovering", suspect=[1], cost=0.5, relaxed=0.25),
    DRONE_TOPICS.result: {"success": True, "place": np.ones(3)},
    DRONE_TOPICS.log: "drone 1: a line",
    DRONE_TOPICS.body: Body("crashed"),
    DRONE_TOPICS.telemetry: {"pm.vbat": [3.9, 0.05]},
    DRONE_TOPICS.plan: Plan(
        np.ones((1, 25)), 0.5, np.zeros((0, 25)), 0.0, 3, {0: 2}, np.zeros(0)
    ),
    DRONE_TOPICS.link: LinkStatus(
        "up",
        0.01,
        0.02,
        0.9,
        -40.0,
        3.9,
        3,
        True,
        ["battery"],
        "2025.12",
        1,
        2,
        "it tilts otherwise",
    ),
    DRONE_TOPICS.console: "SYS: a line of the firmware",
}


@pytest.mark.parametrize("observer", [None, PORT_ADDRESSES.first_observer + 5])
def test_every_observable_topic_arrives_as_it_was_sent(tmp_path, observer):
    async def work(clock, bus):
        for topic, value in VALUES.items():
            bus.ports[1].publish(topic, value, 0.25)
        await clock.sleep(0.5)

    assert [topic.name for topic in VALUES] == list(OBSERVABLE_TOPICS)
    path = tmp_path / "a.mcap"
    assert recorded(path, work, observer) == {
        "file": str(path),
        "messages": 13,
        "lost": 0,
        "missed": 0,
        "error": "",
    }
    found = by_mcap_ros2(path)
    assert found == by_rosbags(path)
    assert [name for name, *_ in found] == [f"/drone1/{topic.name}" for topic in VALUES]
    assert all(came == 100_000_000 for _, _, came, _ in found)
    by_topic = {name.split("/")[-1]: fields for name, _, _, fields in found}
    assert by_topic["pose"]["header"]["stamp"] == {"sec": 0, "nanosec": 0}, (
        "older than the clock"
    )
    assert by_topic["pose"]["pose"]["orientation"] == {
        "x": 3.0,
        "y": 4.0,
        "z": 5.0,
        "w": 6.0,
    }
    assert by_topic["state"]["twist"]["twist"]["linear"] == {
        "x": 4.0,
        "y": 5.0,
        "z": 6.0,
    }
    assert by_topic["command"]["rates"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert by_topic["status"]["suspect"] == [1]
    assert by_topic["result"]["json"] == '{"success": true, "place": [1.0, 1.0, 1.0]}'
    assert by_topic["log"] == {"data": "drone 1: a line"}
    assert by_topic["console"] == {"data": "SYS: a line of the firmware"}
    assert by_topic["body"]["harm"] == "crashed"
    assert by_topic["telemetry"]["json"] == '{"pm.vbat": [3.9, 0.05]}'
    plan = json.loads(by_topic["plan"]["json"])
    assert (plan["way"], plan["offer"], plan["agreed"], plan["awaits"]) == (
        [[1.0] * 25],
        [],
        {"0": 2},
        [],
    )


def test_ages_make_times_of_birth(tmp_path):
    async def work(clock, bus):
        await clock.sleep(1.0)
        bus.ports[0].publish(DRONE_TOPICS.pose, VALUES[DRONE_TOPICS.pose], 0.25)

    path = tmp_path / "a.mcap"
    recorded(path, work)
    ((name, kind, came, fields),) = by_rosbags(path)
    assert (name, kind, came) == (
        "/drone0/pose",
        "geometry_msgs/msg/PoseStamped",
        1_100_000_000,
    )
    assert fields["header"]["stamp"] == {"sec": 0, "nanosec": 850_000_000}


def test_each_type_of_a_topic_has_messages_of_its_own(tmp_path):
    async def work(clock, bus):
        for value in (
            VALUES[DRONE_TOPICS.command],
            Vel(np.arange(4.0)),
            VALUES[DRONE_TOPICS.command],
            FullState(np.arange(14.0)),
            7,
        ):
            bus.ports[0].publish(DRONE_TOPICS.command, value)

    path = tmp_path / "a.mcap"
    assert recorded(path, work)["lost"] == 0
    found = by_mcap_ros2(path)
    assert found == by_rosbags(path)
    names = ["command", "command/vel", "command", "command/fullstate", "command/int"]
    assert [name for name, *_ in found] == [f"/drone0/{name}" for name in names]
    assert [kind.split("/")[-1] for _, kind, *_ in found] == [
        "FPQR",
        "Vel",
        "FPQR",
        "FullState",
        "Value",
    ]
    assert found[4][3]["json"] == "7", "whatever it is, as JSON"


def test_rounds_are_recorded_under_their_sender(tmp_path):
    async def work(clock, bus):
        flags = 1 << EPOCH_SHIFT
        bus.ports[0].send(
            Message(
                MESSAGE_TOPICS.rounds,
                bus.ports[0].address,
                encode([1, 2]),
                5,
                "sum",
                flags,
            ),
            (1,),
        )

    path = tmp_path / "a.mcap"
    recorded(path, work)
    ((name, _, _, fields),) = by_mcap_ros2(path)
    assert name == "/drone0/round"
    del fields["header"]
    assert fields == {
        "to": 1,
        "round": 5,
        "epoch": 1,
        "kind": "data",
        "channel": "sum",
        "json": "[1, 2]",
    }


@virtual
async def test_no_message_between_drones_is_numbered_otherwise(clock):
    """Numbers decide what the simulated network loses: a reader elsewhere must not count."""
    bus = Bus(clock)
    one, other = bus.port(0), bus.port(1)
    seen = []
    bus.tap = lambda to, message, age: seen.append(message)

    class File:
        error = ""

    Recorder(bus, (0, 1), File())
    one.publish(DRONE_TOPICS.state, State.at((0, 0, 0)))
    assert seen == []
    bus.subscribe(DRONE_TOPICS.state, 0, 1, module.Call(clock, lambda value, age: None))
    one.publish(DRONE_TOPICS.state, State.at((0, 0, 0)))
    assert [message.number for message in seen] == [1]
    assert (one.counters.sent, other.counters.received) == (1, 1)


def test_unwritable_messages_are_counted_as_lost_and_the_rest_is_recorded(
    tmp_path, caplog
):
    async def work(clock, bus):
        port = bus.ports[0]
        port.publish(DRONE_TOPICS.status, Status("x", round=1 << 70))
        port.publish(DRONE_TOPICS.state, State(np.zeros(2)))
        port.bus.deliver(
            Message(MESSAGE_TOPICS.rounds, 1, b"\xff\xff", 0, "sum"),
            (port.address,),
            0.0,
        )
        port.publish(DRONE_TOPICS.state, State.at((0, 0, 0)), float("inf"))
        port.publish(DRONE_TOPICS.log, "fine")

    result = recorded(tmp_path / "a.mcap", work)
    assert (result["messages"], result["lost"]) == (1, 4)
    assert read_header(tmp_path / "a.mcap").outcome == {
        "lost": "4",
        "missed": "0",
        "ended": "its flight has ended",
    }
    assert len(caplog.records) == 1
    assert "status of drone 0" in caplog.text


def test_what_the_network_did_not_bring_is_counted(tmp_path):
    """Of each topic of each drone on its own; a latched value and an agent that begins anew are no gap."""

    async def work(clock, bus):
        state, link = encode(State.at((0, 0, 0))), encode(LinkStatus("up"))

        def say(*parts):
            bus.deliver(Message(*parts), (PORT_ADDRESSES.first_observer,), 0.0)

        for number in (7, 8, 11, 1, 2, 4):  # 9, 10 and 3 are not there
            say(DRONE_TOPICS.state, 0, state, number)
        say(DRONE_TOPICS.state, 1, state, 100)
        say(DRONE_TOPICS.state, 1, state, 101)
        for number in (0, 3, 4):
            say(DRONE_TOPICS.link, 1, link, number)

    path = tmp_path / "a.mcap"
    result = recorded(path, work, PORT_ADDRESSES.first_observer)
    assert (result["messages"], result["lost"], result["missed"]) == (11, 0, 3)
    assert read_header(path).lacks == {"complete": True, "lost": 0, "missed": 3}


def test_a_full_disk_ends_the_recording_not_the_flight(tmp_path, monkeypatch, caplog):
    async def work(clock, bus):
        bus.ports[0].publish(DRONE_TOPICS.log, "one")
        await clock.sleep(1.0)
        monkeypatch.setattr(
            RecordingFile,
            "_put",
            lambda self, sync: setattr(self, "error", "No space left"),
        )
        for _ in range(3):
            bus.ports[0].publish(DRONE_TOPICS.log, "two")
            await clock.sleep(1.0)

    result = recorded(tmp_path / "a.mcap", work)
    assert (result["messages"], result["lost"], result["error"]) == (
        1,
        3,
        "No space left",
    )
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "the flight goes on" in caplog.text


@pytest.mark.real_time
def test_a_hanging_disk_does_not_delay_the_flight(tmp_path, monkeypatch):
    """Real time: what comes while the disk hangs waits for it, up to a limit."""
    monkeypatch.setattr(module, "MOST_WAITING", 1000)
    write, hung = RecordingFile.write, []

    def slow(self, entries):
        if not hung:
            hung.append(True)
            time.sleep(0.7)
        write(self, entries)

    monkeypatch.setattr(RecordingFile, "write", slow)
    late = []

    async def work(clock, bus):
        async for due_ns in clock.ticks(100.0):
            late.append((clock.now_ns() - due_ns) / 1e9)
            bus.ports[0].publish(DRONE_TOPICS.pose, VALUES[DRONE_TOPICS.pose])
            if len(late) == 90:
                break

    result = recorded(tmp_path / "a.mcap", work, run=run_wall)
    assert max(late) < 0.3
    assert result["messages"] + result["lost"] == 90
    assert 0 < result["lost"] < 90
