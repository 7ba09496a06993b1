"""A process that records one drone's states in real time until it is killed: `recording_process.py FILE`.

It prints the number of each state that it has published; the number is the state's x.
"""

import asyncio
import sys
from itertools import count
from pathlib import Path

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.recording.mcap.file import RecordingFile
from crazychoir.recording.recorder import Recorder
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.types import State


async def main(clock: Clock) -> None:
    bus = Bus(clock)
    port = bus.port(0)
    file = RecordingFile(Path(sys.argv[1]), {"version": "test"}, "{}", durable=True)
    recording = asyncio.create_task(
        Supervisor(clock, "test").run([Recorder(bus, (0,), file)])
    )
    numbers = count()
    async for _ in clock.ticks(DRONE_TOPICS.state.rate):
        k = next(numbers)
        port.publish(DRONE_TOPICS.state, State.at((k, 0.0, 0.0)))
        sys.stdout.write(f"{k}\n")
        sys.stdout.flush()
    await recording


if __name__ == "__main__":
    run_wall(main)
