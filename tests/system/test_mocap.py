"""Motion capture in real processes: a system that hangs, virtual drones, a recording, and the library itself."""

import asyncio
import contextlib
import importlib.util
import os
import signal
import socket

import numpy as np
import pytest
from ports import free_ports
from system.agents import MOCAP, Program, until

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.launch.network import make_observer_link, run_attached
from crazychoir.mocap.frames import FRAME_PROTOCOL, PoseFrame
from crazychoir.mocap.recording import FrameRecorder, read_recording
from crazychoir.numerics.math3d import quaternion_of_yaw
from crazychoir.runtime.clock import run_wall
from crazychoir.runtime.mailbox import Call

pytestmark = [pytest.mark.system, pytest.mark.real_time]
HANGS = "import ctypes\n\ndef connect(system, settings):\n    ctypes.PyDLL(None).pause()  # in C, the lock is kept\n"
NAMES = ("cf0", "wing")
library = pytest.mark.skipif(
    importlib.util.find_spec("motioncapture") is None, reason="needs the extra `mocap`"
)


def pose(i, k):
    """Return the pose of body i in frame k; no two poses are the same."""
    return np.array([float(i), 0.001 * k, 0.5 + 0.1 * i, *quaternion_of_yaw(0.01 * k)])


def flight(count=3000):
    return [
        PoseFrame(k, 0.01 * k, {name: pose(i, k) for i, name in enumerate(NAMES)})
        for k in range(count)
    ]


class Server(asyncio.DatagramProtocol):
    """Stands in for virtual Crazyflies: sends these frames, 100 a second, to each process that asks."""

    def __init__(self, frames):
        self.frames, self.asked = iter(frames), {}

    def connection_made(self, transport):
        self.transport = transport

    def datagram_received(self, data, addr):
        if data == FRAME_PROTOCOL.request:
            self.asked[addr] = None

    async def run(self):
        for frame in self.frames:
            for addr in self.asked:
                self.transport.sendto(frame.packed(), addr)
            await asyncio.sleep(0.01)

    @classmethod
    @contextlib.asynccontextmanager
    async def at(cls, port, frames):
        loop = asyncio.get_running_loop()
        transport, server = await loop.create_datagram_endpoint(
            lambda: cls(frames), local_addr=("127.0.0.1", port)
        )
        running = asyncio.create_task(server.run())
        try:
            yield server
        finally:
            running.cancel()
            transport.close()


def swarm(name, **mocap):
    drones = [
        {"id": i, "home": [float(i), 0.0, 0.0], "uri": f"udp://127.0.0.1:{19850 + i}"}
        for i in range(2)
    ]
    drones[1]["body"] = "wing"
    config = SwarmConfig.of(
        {
            "name": name,
            "drones": drones,
            "mocap": {"noise": 0.0, "noise_angle": 0.0, "tilt_spread": 0.0, **mocap},
        }
    )
    return config.replace(base_port=free_ports(list(Addresses(config).endpoints())))


def udp_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.asynccontextmanager
async def subscribed(clock, config):
    """What a process of the network hears of each drone: {i: [pose]}."""
    link, heard = (
        make_observer_link(clock, config),
        {i: [] for i in config.topology.seen},
    )
    (address,) = link.bus.ports
    for i, kept in heard.items():
        box = Call(clock, lambda value, age, kept=kept: kept.append(value))
        link.bus.subscribe(
            DRONE_TOPICS.pose, PORT_ADDRESSES.camera_offset + i, address, box
        )
    async with run_attached(link):
        yield heard


async def started(config, folder, *words):
    path = folder / f"{config.name}.json"
    path.write_text(config.dumps())
    return await Program.start(*MOCAP, "--swarm", path, "--json", *words)


def told(poses, i):
    """They are those of the flight, one after the other; returns the numbers of their frames."""
    ks = [round(one.p[1] / 0.001) for one in poses]
    assert ks == sorted(set(ks))
    assert all(
        np.array_equal(one.flat, pose(i, k)) for one, k in zip(poses, ks, strict=True)
    )
    return ks


def test_a_virtual_source_and_a_replay_give_the_same_poses_and_a_hung_one_ends(
    tmp_path, monkeypatch
):
    with FrameRecorder(tmp_path / "flight.csv") as recorder:
        for frame in flight():
            recorder.write(frame, frame.time)
    (tmp_path / "motioncapture.py").write_text(HANGS)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}")
    virtual = swarm("virtual", port=udp_port())
    replay = swarm("replay", source="replay", file=str(tmp_path / "flight.csv"))
    hanging = swarm(
        "hanging", source="vicon", hostname="10.0.0.5", connect_deadline=1.0
    )

    async def main(clock):
        async with (
            Server.at(virtual.mocap.port, flight()),
            subscribed(clock, virtual) as simulated,
            subscribed(clock, replay) as replayed,
        ):
            programs = [
                await started(virtual, tmp_path, "--record", tmp_path / "seen.csv"),
                await started(replay, tmp_path),
                await started(hanging, tmp_path),
            ]
            try:
                line = await programs[2].says("no connection within 1 s")
                both = [*simulated.values(), *replayed.values()]
                await until(
                    lambda: all(len(one) > 50 for one in both),
                    20.0,
                    lambda: programs[0].text,
                )
                for program in programs:
                    program.signal(signal.SIGTERM)
                ended = [
                    await program.end(15.0) for program in programs
                ]  # the hanging program too
                return line, simulated, replayed, ended
            finally:
                for program in programs:
                    await program.kill()

    line, simulated, replayed, ended = run_wall(main)
    assert line.startswith("vicon at 10.0.0.5: no connection within 1 s")
    assert [one["code"] for one in ended] == [0, 0, 1], (
        "the hanging program saw no frame"
    )
    assert "no frame was seen" in ended[2]["reason"]
    for i in virtual.topology.seen:
        assert min(len(told(simulated[i], i)), len(told(replayed[i], i))) > 50, (
            "not a digit differs"
        )
    seen = read_recording(tmp_path / "seen.csv")
    first = round(float(seen[0].bodies["cf0"][1]) / 0.001)
    assert [round(float(f.bodies["cf0"][1]) / 0.001) for f in seen] == list(
        range(first, first + len(seen))
    )
    assert ended[0]["recorded"] == {
        "file": str(tmp_path / "seen.csv"),
        "frames": len(seen),
        "error": "",
    }
    assert ended[0]["seen"] == {"0": len(seen), "1": len(seen)}


@library
@pytest.mark.parametrize(
    ("system", "words"),
    [("mock", "was never seen. No body is seen"), ("vicon", "no connection")],
)
def test_the_library_itself(tmp_path, system, words):
    config = swarm(system, source=system, hostname="127.0.0.1", connect_deadline=1.5)

    async def main(clock):
        program = await started(config, tmp_path)
        try:
            line = await program.says(words, 20.0)
            program.signal(signal.SIGTERM)
            return line, await program.end(10.0)
        finally:
            await program.kill()

    line, ended = run_wall(main)
    assert line.startswith(f"{system} at 127.0.0.1: ")
    assert ended["code"] == 1, "no drone got a pose"
    assert ended["success"] is False
    assert (ended["frames"] > 0) == (system == "mock")
