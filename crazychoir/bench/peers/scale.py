"""The program of `bench scale`: agents of a process exchange with four neighbours each.

Most neighbours are in other processes.
"""

import asyncio
import os
import resource
import time
from pathlib import Path
from typing import Any

from crazychoir.bench.peers.crazychoir_peer import exchange_forever, join_others
from crazychoir.bench.peers.peers import say, specification, wait_for_go
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.port import Bus
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph


def private_memory() -> int:
    """Return the bytes of memory that only this process uses."""
    lines = Path("/proc/self/smaps_rollup").read_text(encoding="utf-8").splitlines()
    return 1024 * sum(
        int(line.split()[1]) for line in lines if line.startswith("Private_")
    )


def read_process_counters(
    bus: Bus, link: ZenohLink | None, rounds: dict[int, int]
) -> dict[str, float]:
    """Return the counters up to now."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    found = {
        "t": time.perf_counter(),
        "cpu": used.ru_utime + used.ru_stime,
        "steps": float(sum(rounds.values())),
    }
    found |= {
        "messages": float(sum(port.counters.sent for port in bus.ports.values())),
        "frames": 0.0,
        "bytes": 0.0,
    }
    if link is not None:
        found |= {
            "frames": float(link.counters.frames_sent),
            "bytes": float(link.counters.bytes_sent),
        }
    return found


async def main(clock: Clock) -> None:
    """Join, wait for go, exchange, and print the cost of a window."""
    spec: dict[str, Any] = specification()
    bus = Bus(clock, process=spec["process"], host=spec["host"])
    link = None
    team = Graph.from_neighbors(spec["neighbors"])
    mine = spec["mine"]
    members = [Communicator(bus.port(i), team) for i in mine]
    rounds = dict.fromkeys(mine, 0)
    async with asyncio.TaskGroup() as group:
        if spec["processes"] > 1:
            link = await join_others(group, bus, team, spec)
        say({"ready": True})
        await asyncio.to_thread(wait_for_go)
        running = [
            group.create_task(exchange_forever(member, rounds)) for member in members
        ]
        await clock.sleep(spec["warm"])
        first = read_process_counters(bus, link, rounds)
        await clock.sleep(spec["seconds"])
        last = read_process_counters(bus, link, rounds)
        seconds = last["t"] - first["t"]
        figures = {
            key: (last[key] - first[key]) / seconds for key in last if key != "t"
        }
        others = [j for i in mine for j in spec["neighbors"][i]]
        far = sum(j not in rounds for j in others) / len(others)
        say(
            {
                **figures,
                "far": far,
                "memory": private_memory(),
                "threads": len(os.listdir("/proc/self/task")),
            }
        )
        await asyncio.to_thread(wait_for_go)
        for task in running:
            task.cancel()


if __name__ == "__main__":
    run_wall(main)
