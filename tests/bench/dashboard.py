"""The page of 100 drones: its server's share of a processor, how soon a click is answered; and what a swarm notices.

python tests/bench/dashboard.py            # 100 drones that only speak, a browser that looks on and clicks
python tests/bench/dashboard.py --flying   # six that fly, with and without a page, in turns of one flight
"""

import argparse
import asyncio
import contextlib
import fcntl
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from crazychoir.config.addresses import Addresses

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from playwright.async_api import async_playwright
from system.agents import Program, flying
from system.browsers import FLAGS
from system.pages import dashboard, looking_on, six

from crazychoir.bus.commands import CommandServer
from crazychoir.bus.network.hello import PACKAGE_VERSION
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.network.zenoh_session import SessionEndpoints
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.launch.network import isolate_swarm, run_attached
from crazychoir.runtime.clock import run_wall
from crazychoir.types import FullState, State, Status

SECONDS, CLICKS, TURN = 20.0, 20, 10.0
TICKING = '''
import json
from pathlib import Path
from crazychoir import CFDistributedFeedback
from crazychoir.types import Acceleration

class Ticking(CFDistributedFeedback):
    """Hovers, and notes when each of its ticks came."""
    duration = DURATION

    def step(self, me, heard):
        self.ticks = getattr(self, "ticks", [])
        self.ticks.append(self.member.clock.now())
        return None

    async def mission(self):
        result = await super().mission()
        Path("FOLDER", f"ticks{self.id}.json").write_text(json.dumps(self.ticks))
        return result

def guidance(i, config):
    return Ticking()
'''


def hundred(processes: int = 4) -> SwarmConfig:
    drones = [
        {"id": i, "home": [1.0 * (i % 10), 1.0 * (i // 10), 0.0]} for i in range(100)
    ]
    fence = {"min": [-2, -2, 0], "max": [12, 12, 3]}
    raw = {
        "name": "hundred",
        "mission": "figure",
        "drones": drones,
        "graph": "ring",
        "fence": fence,
    }
    return isolate_swarm(SwarmConfig.of(raw), processes)


def speak(path: str, group: int) -> None:
    """Drones of one process that say 100 times a second where they are, and obey at once."""
    config = SwarmConfig.load(path)
    ids = Addresses(config).groups()[group]

    async def main(clock):
        bus = Bus(clock, process=f"speaker-{group}", host="bench")
        for i in ids:
            CommandServer(
                bus.port(i),
                lambda verb, arguments: asyncio.sleep(0, "done"),
                lambda on: None,
            )
        link = ZenohLink(
            bus,
            Introduction(config.name, group + 1, PACKAGE_VERSION),
            SessionEndpoints([Addresses(config).endpoint(ids[0])], []),
        )
        async with run_attached(link):
            k = 0
            async for _ in clock.ticks(100.0):
                for i in ids:
                    p = np.array([i % 10 + 0.3 * np.sin(0.01 * k), i // 10, 1.0])
                    bus.ports[i].publish(
                        DRONE_TOPICS.state, State.at(p, (0.1, 0.0, 0.0))
                    )
                    bus.ports[i].publish(DRONE_TOPICS.reference, FullState.at(p))
                    if k % 25 == 0:
                        bus.ports[i].publish(
                            DRONE_TOPICS.status,
                            Status(
                                "hovering",
                                "waits",
                                sent=k,
                                process="bench",
                                host="here",
                            ),
                        )
                k += 1

    run_wall(main)


def cpu(pid: int) -> float:
    """s of a processor that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def watch_hundred(folder: Path) -> dict[str, float]:
    config = hundred()
    path = folder / "swarm.json"
    path.write_text(config.dumps())
    speakers = [
        await Program.start(sys.executable, __file__, "--speak", path, str(k))
        for k in range(4)
    ]
    program, address = await dashboard(path)
    try:
        async with async_playwright() as playwright:
            chromium = await playwright.chromium.launch(
                executable_path=shutil.which("chromium"), args=FLAGS
            )
            page = await chromium.new_page(viewport={"width": 1400, "height": 900})
            page.set_default_timeout(120_000)
            await page.goto(address)
            await page.wait_for_function(
                "window.choir?.seen.drones.length && choir.seen.drones.every(d => d.heard)"
            )
            await asyncio.sleep(5.0)
            began, used, frames = (
                time.monotonic(),
                cpu(program.process.pid),
                await page.evaluate("choir.seen.received"),
            )
            await asyncio.sleep(SECONDS)
            seconds = time.monotonic() - began
            share = (cpu(program.process.pid) - used) / seconds
            rate = (await page.evaluate("choir.seen.received") - frames) / seconds
            clicks = [await page.evaluate(CLICK) for _ in range(CLICKS)]
            await page.screenshot(path=folder / "hundred.png")
            await chromium.close()
    finally:
        for one in (program, *speakers):
            await one.kill()
    return {
        "server_share_of_a_core": round(share, 3),
        "frames_hz": round(rate, 1),
        "click_to_receipt_ms_median": round(float(np.median(clicks)), 1),
        "click_to_receipt_ms_worst": max(clicks),
    }


CLICK = """
() => new Promise((done) => {
  const list = document.getElementById("receipts"), began = performance.now();
  const watcher = new MutationObserver(() => { watcher.disconnect(); done(Math.round(performance.now() - began)); });
  watcher.observe(list, { childList: true });
  document.querySelector('[data-action="order(\\'hold\\')"]').click();
})
"""


async def watch_flying(folder: Path) -> dict[str, object]:
    """A page comes and goes every TURN s; how late the ticks of six drones are with it, and without."""
    turns = 8
    mission = folder / "ticking.py"
    mission.write_text(
        TICKING.replace("FOLDER", str(folder)).replace(
            "DURATION", str((turns + 2) * TURN)
        )
    )
    config = six(str(mission)).replace(
        flight={"takeoff_height": 0.6, "operator": False}
    )
    spans: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    async with flying(config, folder) as team:
        await team.law()
        program, address = await dashboard(team.path)
        try:
            for turn in range(turns):
                open_now = turn % 2 == 1
                async with contextlib.AsyncExitStack() as stack:
                    if open_now:
                        program.signal(signal.SIGCONT)
                        await stack.enter_async_context(looking_on(address))
                    else:
                        program.signal(signal.SIGSTOP)
                    await asyncio.sleep(1.0)
                    began = time.monotonic()
                    await asyncio.sleep(TURN - 2.0)
                    spans[open_now].append((began, time.monotonic()))
        finally:
            await program.kill()
        await team.end(60.0 + TURN * turns)
    found: dict[str, object] = {}
    for open_now, name in ((False, "without"), (True, "with_page")):
        late = []
        for i in config.ids:
            ticks = np.array(json.loads((folder / f"ticks{i}.json").read_text()))
            gaps = np.abs(np.diff(ticks) - 0.01)
            for began, ended in spans[open_now]:
                late.append(gaps[(ticks[1:] > began) & (ticks[1:] < ended)])
        everything = 1e3 * np.concatenate(late)
        found[name] = {
            "ticks": len(everything),
            **{
                f"late_ms_p{q}": round(float(np.percentile(everything, q)), 3)
                for q in (50, 95, 99)
            },
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--speak", nargs=2)
    parser.add_argument("--flying", action="store_true")
    chosen = parser.parse_args()
    if chosen.speak:
        speak(chosen.speak[0], int(chosen.speak[1]))
        return
    turn = os.open(tempfile.gettempdir(), os.O_RDONLY)
    fcntl.flock(turn, fcntl.LOCK_EX)  # no test runs in real time meanwhile
    with tempfile.TemporaryDirectory() as folder:
        work = watch_flying if chosen.flying else watch_hundred
        print(json.dumps(asyncio.run(work(Path(folder))), indent=2))


if __name__ == "__main__":
    main()
