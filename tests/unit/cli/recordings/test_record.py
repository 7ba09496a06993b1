"""What `record` says of a recording: what it lacks, and why it has ended."""

import asyncio
import json
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.cli.main import app
from crazychoir.config.swarm_config import default_swarm
from crazychoir.launch.observer import Window
from crazychoir.launch.recording import FILES_KEY, describe_flight
from crazychoir.launch.running_swarm import NEXT_PROCESS_TIMEOUT
from crazychoir.recording.mcap.file import RecordingFile
from crazychoir.recording.mcap.reading import read_header
from crazychoir.runtime.clock import run_virtual
from crazychoir.types import Status

GONE = default_swarm(2).lost_after + NEXT_PROCESS_TIMEOUT
NOBODY = f"no drone was there for {GONE:g} s"


@pytest.fixture
def record(monkeypatch, tmp_path):
    """`crazychoir record` of two drones in virtual time: exit code, what it says, the recording, s that it took.

    scene(clock, bus, there, leave): goes on meanwhile; there: the drones that are found;  leave: Ctrl-C.
    """

    def run(scene, *words):
        took = []

        def looking(swarm, work, as_json):
            async def main(clock):
                bus, there = Bus(clock), {0: "its process", 1: "its process"}
                for address in (PORT_ADDRESSES.first_observer + 1, 0, 1):
                    bus.port(address)
                window = Window(
                    clock, default_swarm(2), SimpleNamespace(bus=bus, directory=there)
                )
                working = asyncio.create_task(work(window))
                playing = asyncio.create_task(scene(clock, bus, there, working.cancel))
                await asyncio.wait([working])
                took.append(clock.now())
                playing.cancel()
                return working.cancelled()

            if run_virtual(main):
                raise KeyboardInterrupt

        monkeypatch.setattr("crazychoir.cli.recordings.record.run_as_observer", looking)
        path = tmp_path / "a.mcap"
        done = CliRunner().invoke(app, ["record", str(path), *words])
        return done, read_header(path) if path.exists() else None, took[0]

    return run


async def stays(clock, bus, there, leave):
    """Both say a word in each second."""
    async for _ in clock.ticks(1.0):
        for i in (0, 1):
            bus.ports[i].publish(DRONE_TOPICS.log, f"drone {i}")


def test_what_was_asked_for_is_there(record):
    done, recording, seconds = record(stays, "--seconds", "3.5", "--json")
    said = json.loads(done.stdout)
    assert (done.exit_code, said["success"], said["messages"], said["lost"]) == (
        0,
        True,
        6,
        0,
    )
    assert said["ended"] == "after 3.5 s"
    assert recording.outcome == {"lost": "0", "missed": "0", "ended": "after 3.5 s"}
    assert recording.about == describe_flight(default_swarm(2), virtual=False) | {
        FILES_KEY: "{}"
    }
    assert seconds == pytest.approx(3.5, abs=0.1)


def test_a_recording_that_lost_messages_is_no_success(record):
    async def too_large(clock, bus, there, leave):
        bus.ports[0].publish(DRONE_TOPICS.log, "fine")
        await clock.sleep(0.5)
        for _ in range(3):
            bus.ports[0].publish(DRONE_TOPICS.status, Status("x", round=1 << 63))
        await stays(clock, bus, there, leave)

    done, recording, _ = record(too_large, "--seconds", "2.2", "--json")
    said = json.loads(done.stdout)
    assert (done.exit_code, said["success"], said["lost"], said["error"]) == (
        1,
        False,
        3,
        "",
    )
    assert (recording.lost, recording.complete) == (3, True)


def test_an_outage_of_its_own_network_does_not_end_it(record):
    async def away_and_back(clock, bus, there, leave):
        speaking = asyncio.create_task(stays(clock, bus, there, leave))
        await clock.sleep(2.0)
        found = dict(there)
        there.clear()
        await clock.sleep(GONE - 1.0)
        there.update(found)
        await clock.sleep(3.0)
        there.clear()
        await clock.sleep(2.5)
        speaking.cancel()

    done, recording, seconds = record(away_and_back, "--json")
    said = json.loads(done.stdout)
    last = 2.0 + GONE - 1.0 + 3.0
    assert (done.exit_code, said["ended"], recording.outcome["ended"]) == (
        0,
        NOBODY,
        NOBODY,
    )
    assert seconds == pytest.approx(last + GONE, abs=0.6)
    assert said["messages"] == 2 * int(last + 2.5)
    assert (
        done.stderr.count(
            f"no drone is there: it ends in {GONE:g} s, unless one comes back"
        )
        == 2
    )


def test_ctrl_c_is_told(record):
    async def interrupts(clock, bus, there, leave):
        bus.ports[0].publish(DRONE_TOPICS.log, "one")
        await clock.sleep(0.5)
        bus.ports[0].publish(DRONE_TOPICS.log, "two")
        leave()

    done, recording, _ = record(interrupts)
    assert done.exit_code == 0
    assert recording.outcome["ended"] == "Ctrl-C"
    assert "2 messages, 0 lost, 0 missed; it ended: Ctrl-C" in " ".join(
        done.stdout.split()
    )


def test_a_disk_that_fails_is_told(record, monkeypatch):
    async def fails(clock, bus, there, leave):
        await clock.sleep(1.5)
        monkeypatch.setattr(
            RecordingFile,
            "_put",
            lambda self, sync: setattr(self, "error", "No space left"),
        )

    async def scene(*story):
        await asyncio.gather(stays(*story), fails(*story))

    done, recording, seconds = record(scene, "--json")
    said = json.loads(done.stdout)
    assert (done.exit_code, said["success"], said["error"], said["ended"]) == (
        1,
        False,
        *2 * ["No space left"],
    )
    assert not recording.complete
    assert seconds < 4.0
    assert (said["messages"], said["lost"] > 0) == (2, True)


@pytest.mark.parametrize(
    ("topics", "what"),
    [
        ((), "no message came"),
        (("--topics", "result,truth"), "no message of result,truth came"),
    ],
)
def test_a_recording_of_nothing_is_no_success(record, topics, what):
    async def silent(clock, bus, there, leave):
        await clock.sleep(9.0)

    done, recording, _ = record(silent, "--seconds", "2.5", "--json", *topics)
    said = json.loads(done.stdout)
    assert (done.exit_code, said["success"], said["messages"], said["ended"]) == (
        1,
        False,
        0,
        "after 2.5 s",
    )
    assert what in said["error"]
    assert "Record for longer, or more topics" in said["error"]
    assert recording is None
    done, _, _ = record(silent, "--seconds", "2.5", *topics)
    assert done.exit_code == 1
    assert "0 messages, 0 lost, 0 missed; it ended: after 2.5 s" in " ".join(
        done.stdout.split()
    )
    assert f"There is no file: {what}" in " ".join(done.stderr.split())


def test_a_disk_without_room_for_a_message_is_told(record, monkeypatch):
    put = RecordingFile._put
    room = iter([True])

    def once(self, sync):
        return (
            put(self, sync)
            if next(room, False)
            else setattr(self, "error", "No space left")
        )

    monkeypatch.setattr(RecordingFile, "_put", once)
    done, recording, _ = record(stays)
    assert (done.exit_code, recording) == (1, None)
    assert "There is no file: No space left" in " ".join(done.stderr.split())
