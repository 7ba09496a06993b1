"""A valid host that floods: what 100 000 frames a second do to the 100 Hz ticks of the process that gets them.

    python tests/bench/flood.py

There are three kinds of turns: no flood, a flood at an unrelated process of this machine, and a flood at the host with
the measured ticks. All three processes run in each turn, over mutual TLS.
"""

import argparse
import asyncio
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from crazychoir.config.access import access_of
from crazychoir.config.addresses import Addresses

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import zenoh
from ports import free_ports
from system.link_process import linked, wall_clock

from crazychoir.bus.frames import Frame, encode_frame
from crazychoir.bus.network import authority
from crazychoir.bus.network.authority import KEY_FILES
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig

ARMS = ("nobody", "unrelated", "itself")
RATE, EACH = 100_000, 100
"""Frames/s of the flood, and at a time."""
SETTLE = 1.0
"""s of a turn before ticks count."""
TLS, BLOCK = "transport/link/tls", zenoh.CongestionControl.BLOCK


def swarm(folder: Path, port: int) -> SwarmConfig:
    """Return a swarm with drone 0 on host a and drone 1 on host b; host b floods."""
    return SwarmConfig.of(
        {
            "name": f"flooded{port}",
            "hosts": {"a": "127.0.0.1", "b": "127.0.0.1"},
            "base_port": port,
            "security": {"insecure": False, "operators": ["a"], "keys": str(folder)},
            "drones": [
                {"id": i, "home": [1.0 * i, 0, 0], "host": "ab"[i]} for i in range(2)
            ],
        }
    )


async def receive(folder: Path, port: int) -> None:
    """The process of drone 0: ticks at 100 Hz for as many s as each line of its standard input says."""
    config = swarm(folder, port)
    async with wall_clock() as clock:
        listen, access = [Addresses(config).endpoint(0)], access_of(config, "a")
        async with linked(
            clock, "0-1", config.name, [0], host="a", listen=listen, access=access
        ) as link:
            print("ready", flush=True)
            while line := await asyncio.to_thread(sys.stdin.readline):
                ends, late = clock.now() + float(line), []
                before = count(link)
                async for due_ns in clock.ticks(100.0):
                    late.append((clock.now_ns() - due_ns) / 1e6)
                    if clock.now() > ends:
                        break
                arrived, flooded = (
                    now - then for now, then in zip(count(link), before, strict=True)
                )
                told = {
                    "late": late[round(100 * SETTLE) :],
                    "arrived": arrived,
                    "flooded": flooded,
                }
                print(json.dumps(told), flush=True)


def count(link: ZenohLink) -> tuple[int, int]:
    """Return the number of frames that have come, and the number of frames that were cut off."""
    counters = link.counters
    return (
        counters.frames_received + counters.strangers + counters.flooded,
        counters.flooded,
    )


def flood(folder: Path) -> None:
    """Flood from a session of host b. Each line of standard input gives a port and the s; port 0 means no flood."""
    for line in sys.stdin:
        port, seconds = line.split()
        sent = send(folder, int(port), float(seconds)) if int(port) else 0
        print(json.dumps({"sent": sent}), flush=True)


def send(folder: Path, port: int, seconds: float) -> int:
    """Send EACH frames at a time, RATE a second, and return how many were sent."""
    keys = folder / "b"
    tls = {
        "root_ca_certificate": str(keys / KEY_FILES.authority_certificate),
        "connect_private_key": str(keys / KEY_FILES.private_key),
        "connect_certificate": str(keys / KEY_FILES.certificate),
        "enable_mtls": True,
        "verify_name_on_connect": False,
    }
    config = zenoh.Config()
    settings = {
        "connect/endpoints": [f"tls/127.0.0.1:{port}"],
        "scouting/multicast/enabled": False,
        TLS: tls,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    frame, sent = encode_frame(Frame("1-f", 1, DRONE_TOPICS.status.klass, [])), 0
    with zenoh.open(config) as session:
        began = time.monotonic()
        while (spent := time.monotonic() - began) < seconds:
            while sent < RATE * spent:
                for _ in range(EACH):
                    session.put(
                        f"choir/flooded{port}/f/0-1/b/1-f/control",
                        frame,
                        congestion_control=BLOCK,
                    )
                sent += EACH
            time.sleep(EACH / RATE)
    return sent


@contextmanager
def process(*words: str) -> Iterator[subprocess.Popen[str]]:
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, __file__, *words], stdin=pipe, stdout=pipe, text=True
    ) as made:
        try:
            yield made
        finally:
            made.kill()


def turns(
    count: int, seconds: float, console: Console
) -> dict[str, list[dict[str, Any]]]:
    """Each arm so many times, one after the other."""
    found: dict[str, list[dict[str, Any]]] = {arm: [] for arm in ARMS}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "keys"
        authority.make_authority(folder)
        for host in "ab":
            authority.add_host(folder, host)
        ports = {
            "itself": free_ports([0, 1]),
            "unrelated": free_ports([0, 1]) + 10,
            "nobody": 0,
        }
        roles = [("receive", str(ports[arm])) for arm in ("itself", "unrelated")] + [
            ("flood", "0")
        ]
        with ExitStack() as stack:
            own, other, flooding = (
                stack.enter_context(process(*role, str(folder))) for role in roles
            )
            for made in (own, other):
                assert made.stdout.readline() == "ready\n"
            for k in track(range(count * len(ARMS)), "turns", console=console):
                arm = ARMS[k % len(ARMS)]
                flooding.stdin.write(f"{ports[arm]} {seconds + SETTLE}\n")
                for made in (own, other):
                    made.stdin.write(f"{seconds + SETTLE}\n")
                for made in (own, other, flooding):
                    made.stdin.flush()
                said = [
                    json.loads(made.stdout.readline())
                    for made in (own, other, flooding)
                ]
                target = said[1] if arm == "unrelated" else said[0]
                late = np.array(said[0]["late"])
                p50, p99 = np.percentile(late, [50, 99])
                per_s = {
                    key: target[key] / (seconds + SETTLE)
                    for key in ("arrived", "flooded")
                }
                found[arm].append(
                    {
                        "p50": p50,
                        "p99": p99,
                        "max": float(late.max()),
                        **per_s,
                        "sent": said[2]["sent"] / (seconds + SETTLE),
                    }
                )
    return found


def show(found: dict[str, list[dict[str, Any]]], console: Console) -> None:
    """Medians over the turns."""
    table = Table(
        "flood to", "frames/s sent", "arrived", "cut off", "late p50, ms", "p99", "max"
    )
    for arm, rows in found.items():
        middle = {key: statistics.median(row[key] for row in rows) for key in rows[0]}
        figures = [f"{middle[key]:.0f}" for key in ("sent", "arrived", "flooded")]
        table.add_row(
            arm, *figures, *(f"{middle[key]:.2f}" for key in ("p50", "p99", "max"))
        )
    console.print(table)
    beyond = [
        own["p99"] - other["p99"]
        for own, other in zip(found["itself"], found["unrelated"], strict=True)
    ]
    each = " ".join(f"{one:.2f}" for one in beyond)
    said = f"p99 beyond the unrelated flood: {statistics.median(beyond):.2f} ms (each turn {each})"
    console.print(said, highlight=False)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "role", nargs="?", choices=("receive", "flood"), help=argparse.SUPPRESS
    )
    parser.add_argument("port", nargs="?", type=int, help=argparse.SUPPRESS)
    parser.add_argument("folder", nargs="?", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each turn")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    if chosen.role == "receive":
        asyncio.run(receive(chosen.folder, chosen.port))
    elif chosen.role == "flood":
        flood(chosen.folder)
    else:
        found = turns(chosen.turns, chosen.seconds, Console(stderr=True))
        if chosen.json:
            print(json.dumps(found))
        else:
            show(found, Console())


if __name__ == "__main__":
    main()
