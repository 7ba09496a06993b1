"""How many messages a second a recorder takes, and at what CPU: `recording.py [drones] [Hz] [seconds] [--processes n]`.

Drones say their states in real time, each in its turn, and a recorder writes them: on one bus, or from n processes over
Zenoh. On one bus nothing may be lost. Prints one JSON object: messages said, written, lost and missed, and CPU s of the
recorder's process for each second of flight; on one bus also the CPU s of the drones without a recorder. If the wall
time is longer than the requested seconds, the machine was too slow or too busy, and the drones have said less a second.
"""

import argparse
import asyncio
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.network.hello import PACKAGE_VERSION
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.network.zenoh_session import SessionEndpoints
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.launch.network import isolate_swarm, make_observer_link, run_attached
from crazychoir.recording.mcap.file import RecordingFile
from crazychoir.recording.recorder import Recorder
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.types import State

VALUES = 512
"""States that differ in all digits, said over and over: making them is no work of the recorder."""
START = 30.0
"""s within which all processes are there."""


async def said(
    clock: Clock, bus: Bus, ids: Sequence[int], rate: float, seconds: float
) -> int:
    """Let each drone say a state a period; returns how many were said."""
    draw = np.random.default_rng(0)
    states = [State(draw.normal(size=13)) for _ in range(VALUES)]
    ports, count = [bus.ports[i] for i in ids], 0
    async for _ in clock.ticks(rate):
        for port in ports:
            port.publish(DRONE_TOPICS.state, states[count % VALUES])
            count += 1
        if count >= len(ids) * rate * seconds:
            return count
    return count


def run(drones: int, rate: float, seconds: float, path: Path | None) -> dict[str, Any]:
    """Return CPU s a second of flight, and what was recorded into `path`; without a path there is no recorder."""

    async def main(clock: Clock) -> dict[str, Any]:
        bus = Bus(clock)
        for i in range(drones):
            bus.port(i)
        file = (
            RecordingFile(path, {"version": "bench"}, "{}", durable=True)
            if path
            else None
        )
        recorder = Recorder(bus, range(drones), file) if file else None
        supervisor = Supervisor(clock, "bench")
        running = asyncio.create_task(supervisor.run([recorder] if recorder else []))
        began, cpu = time.perf_counter(), time.process_time()
        count = await said(clock, bus, range(drones), rate, seconds)
        wall = time.perf_counter() - began
        supervisor.stop()
        await running
        used = time.process_time() - cpu
        told = recorder.result() if recorder else {}
        return {
            "said": count,
            "wall_s": wall,
            "cpu": used * drones * rate / count,
            **told,
        }

    return run_wall(main)


def on_one_bus(drones: int, rate: float, seconds: float, path: Path) -> dict[str, Any]:
    """Return the results with a recorder, and the CPU s without a recorder."""
    alone = run(drones, rate, seconds, None)
    recorded = run(drones, rate, seconds, path)
    return {**recorded, "cpu_alone": alone["cpu"]}


def swarm(drones: int, processes: int) -> SwarmConfig:
    """Return a swarm of so many drones in so many processes; no drone flies."""
    places = [
        {"id": i, "home": [float(i % 40), float(i // 40), 0.0]} for i in range(drones)
    ]
    fence = {"min": [-2, -2, 0], "max": [42, 42, 3]}
    raw = {
        "name": "recorded",
        "mission": "figure",
        "drones": places,
        "graph": "ring",
        "fence": fence,
    }
    return isolate_swarm(SwarmConfig.of(raw), processes)


def speak(path: str, group: int, rate: float, seconds: float) -> None:
    """Publish the states of the drones of one process once a recorder reads them; print how many they have said."""
    config = SwarmConfig.load(path)
    ids = Addresses(config).groups()[group]

    async def main(clock: Clock) -> None:
        bus = Bus(clock, process=f"speaker-{group}", host="bench")
        for i in ids:
            bus.port(i)
        link = ZenohLink(
            bus,
            Introduction(config.name, group + 1, PACKAGE_VERSION),
            SessionEndpoints([Addresses(config).endpoint(ids[0])], []),
        )
        async with run_attached(link):
            async with asyncio.timeout(START):
                while not any(
                    peer.hello and peer.hello.interests for peer in link.peers.values()
                ):
                    await clock.sleep(0.1)
            await clock.sleep(2.0)  # all others are read, too
            began = time.perf_counter()
            count = await said(clock, bus, ids, rate, seconds)
            print(
                json.dumps({"said": count, "wall_s": time.perf_counter() - began}),
                flush=True,
            )
            await clock.sleep(2.0)

    run_wall(main)


def over_zenoh(
    drones: int, rate: float, seconds: float, path: Path, processes: int
) -> dict[str, Any]:
    """Record as an observer, as `crazychoir record` does, and return the result."""
    config = swarm(drones, processes)
    file = path.with_name("swarm.json")
    file.write_text(config.dumps())

    async def main(clock: Clock) -> dict[str, Any]:
        link = make_observer_link(clock, config)
        bus, address = (
            link.bus,
            next(a for a in link.bus.ports if a >= PORT_ADDRESSES.first_observer),
        )
        opened = RecordingFile(path, {"version": "bench"}, "{}", durable=True)
        recorder = Recorder(bus, config.ids, opened, address, topics=["state"])
        async with run_attached(link, recorder):
            words = [
                [
                    sys.executable,
                    __file__,
                    "--speak",
                    str(file),
                    str(k),
                    str(rate),
                    str(seconds),
                ]
                for k in range(processes)
            ]
            speakers = [
                await asyncio.create_subprocess_exec(*line, stdout=subprocess.PIPE)
                for line in words
            ]
            try:
                async with asyncio.timeout(START):
                    while not opened.written:
                        await clock.sleep(0.05)
                cpu = time.process_time()
                async with asyncio.timeout(START + 4 * seconds):
                    told = [
                        json.loads((await speaker.communicate())[0])
                        for speaker in speakers
                    ]
                used = time.process_time() - cpu
            finally:
                for speaker in speakers:
                    if speaker.returncode is None:
                        speaker.kill()
        count = sum(one["said"] for one in told)
        wall = max(one["wall_s"] for one in told)
        return {
            "said": count,
            "wall_s": wall,
            "cpu": used * drones * rate / count,
            **recorder.result(),
        }

    return run_wall(main)


def measure(drones: int, rate: float, seconds: float, processes: int) -> dict[str, Any]:
    """One run, and the size of the file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.mcap"
        if processes:
            found = over_zenoh(drones, rate, seconds, path, processes)
        else:
            found = on_one_bus(drones, rate, seconds, path)
        size = path.stat().st_size
    written = found.pop("messages")
    del found["file"]
    figures = {
        name: round(value, 3) if isinstance(value, float) else value
        for name, value in found.items()
    }
    return {
        "drones": drones,
        "rate_hz": rate,
        "processes": processes,
        "written": written,
        **figures,
        "bytes_a_message": round(size / max(1, written), 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("drones", type=int, nargs="?", default=1000)
    parser.add_argument("rate", type=float, nargs="?", default=100.0)
    parser.add_argument("seconds", type=float, nargs="?", default=10.0)
    parser.add_argument(
        "--processes", type=int, default=0, help="over Zenoh, of so many; 0: on one bus"
    )
    if sys.argv[1:2] == ["--speak"]:
        path, group, rate, seconds = sys.argv[2:]
        speak(path, int(group), float(rate), float(seconds))
        return
    chosen = parser.parse_args()
    print(
        json.dumps(
            measure(chosen.drones, chosen.rate, chosen.seconds, chosen.processes)
        )
    )


if __name__ == "__main__":
    main()
