"""How many messages a second a recorder takes, and at what CPU: `recording.py [drones] [Hz] [seconds]`.

Drones say their states on one bus, in real time, each in its turn, and a recorder writes them: nothing may be lost.
Prints one JSON object: messages said, written and lost, and CPU s of the process for each second of flight, with what
the drones cost alone, on the same bus, where nobody records. Where the wall time is longer than the seconds that were
asked for, the machine was too slow or too busy, and the drones have said less a second.
"""

import asyncio
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.local import Bus
from crazychoir.bus.topics import STATE
from crazychoir.recording.file import RecordingFile
from crazychoir.recording.recorder import Recorder
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.types import State

VALUES = 512
"""States that differ in all digits, said over and over: making them is no work of the recorder."""


async def said(clock: Clock, bus: Bus, drones: int, rate: float, seconds: float) -> int:
    """Let each drone say a state a period; returns how many were said."""
    draw = np.random.default_rng(0)
    states = [State(draw.normal(size=13)) for _ in range(VALUES)]
    ports, count = [bus.ports[i] for i in range(drones)], 0
    async for _ in clock.ticks(rate):
        for port in ports:
            port.publish(STATE, states[count % VALUES])
            count += 1
        if count >= drones * rate * seconds:
            return count
    return count


def run(drones: int, rate: float, seconds: float, path: Path | None) -> dict[str, Any]:
    """CPU s a second of flight, and what was recorded into `path`; None: nobody records."""

    async def main(clock: Clock) -> dict[str, Any]:
        bus = Bus(clock)
        for i in range(drones):
            bus.port(i)
        file = RecordingFile(path, {"version": "bench"}, "{}", durable=True) if path else None
        recorder = Recorder(bus, range(drones), file) if file else None
        supervisor = Supervisor(clock, "bench")
        running = asyncio.create_task(supervisor.run([recorder] if recorder else []))
        began, cpu = time.perf_counter(), time.process_time()
        count = await said(clock, bus, drones, rate, seconds)
        supervisor.stop()
        await running
        wall, used = time.perf_counter() - began, time.process_time() - cpu
        told = recorder.result() if recorder else {}
        return {"said": count, "wall_s": wall, "cpu": used * drones * rate / count, **told}

    return run_wall(main)


def measure(drones: int, rate: float, seconds: float) -> dict[str, Any]:
    """Both runs, and the size of the file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.mcap"
        alone = run(drones, rate, seconds, None)
        recorded = run(drones, rate, seconds, path)
        size = path.stat().st_size
    return {
        "drones": drones, "rate_hz": rate, "said": recorded["said"], "written": recorded["messages"],
        "lost": recorded["lost"], "error": recorded["error"], "wall_s": round(recorded["wall_s"], 3),
        "cpu_alone": round(alone["cpu"], 3), "cpu": round(recorded["cpu"], 3),
        "bytes_a_message": round(size / max(1, recorded["messages"]), 1),
    }  # fmt: skip


if __name__ == "__main__":
    words = [float(word) for word in sys.argv[1:]] + [1000.0, 100.0, 10.0][len(sys.argv) - 1 :]
    print(json.dumps(measure(int(words[0]), words[1], words[2])))
