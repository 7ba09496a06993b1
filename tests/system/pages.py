"""A page's server as a process, and a page without a browser: what it is told, and what it asks for."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
from system.agents import CRAZYCHOIR, Program, until
from websockets.asyncio.client import connect

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.launch.network import isolate_swarm

FLIGHT = {
    "takeoff_height": 0.6,
    "speed_limit": 1.5,
    "acceleration_limit": 3.0,
    "landing_speed": 0.6,
    "operator": True,
}
COLUMNS = 17


def six(mission: str = "figure", processes: int = 3, **tables: Any) -> SwarmConfig:
    """Six drones of a mission that waits for its operator."""
    drones = [
        {"id": i, "home": [1.2 * (i % 3) - 1.2, 1.4 * (i // 3) - 0.7, 0.0]}
        for i in range(6)
    ]
    raw = {
        "name": "six",
        "mission": mission,
        "seed": 1,
        "drones": drones,
        "flight": FLIGHT,
        **tables,
    }
    return isolate_swarm(SwarmConfig.of(raw), processes)


class Seen:
    """A page that looks on: receipts by number, the newest table, the newest frame, the log."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.about: dict[str, Any] = {}
        self.receipts: dict[int, dict[str, Any]] = {}
        self.drones: list[dict[str, Any]] = []
        self.log: list[dict[str, Any]] = []
        self.replies: list[dict[str, Any]] = []
        self.frames = 0
        self.rows = np.empty((0, COLUMNS))
        self.news: dict[str, Any] = {}

    async def read(self) -> None:
        async for message in self.socket:
            if isinstance(message, bytes):
                self.frames += 1
                self.rows = np.frombuffer(message, "<f4", offset=8).reshape(-1, COLUMNS)
                continue
            told = json.loads(message)
            self.about = told.pop("about", self.about)
            self.drones = told.pop("drones", self.drones)
            self.log += told.pop("log", [])
            self.receipts |= {
                receipt["number"]: receipt for receipt in told.pop("receipts", [])
            }
            if "refused" in told or "plan" in told:
                self.replies.append(told)
            self.news |= told

    async def ask(self, ask: str, **words: Any) -> None:
        await self.socket.send(json.dumps({"ask": ask, **words}))

    def phases(self) -> list[str]:
        return [drone["phase"] for drone in self.drones]

    async def receipt(self, verb: str, seconds: float = 40.0) -> dict[str, Any]:
        """The newest receipt of a verb, when all have answered."""

        def newest() -> dict[str, Any]:
            found = [
                receipt for receipt in self.receipts.values() if receipt["verb"] == verb
            ]
            return found[-1] if found else {"answers": {}}

        def answered() -> bool:
            kinds = [kind for kind, _ in newest()["answers"].values()]
            return bool(kinds) and not {"sent", "accepted"} & set(kinds)

        await until(answered, seconds, lambda: f"{verb}: {newest()}; {self.replies}")
        return newest()

    async def does(
        self, verb: str, ask: str = "order", seconds: float = 40.0, **words: Any
    ) -> dict[str, Any]:
        """Ask, and see it done by all that were asked."""
        await self.ask(ask, **({"verb": verb} if ask == "order" else {}), **words)
        await until(
            lambda: any(r["verb"] == verb for r in self.receipts.values()),
            5.0,
            lambda: str(self.replies),
        )
        receipt = await self.receipt(verb, seconds)
        assert {kind for kind, _ in receipt["answers"].values()} == {"done"}, receipt
        return receipt

    async def sees(self, *phases: str, seconds: float = 40.0) -> None:
        await until(
            lambda: self.drones and set(self.phases()) <= set(phases),
            seconds,
            lambda: str(self.drones),
        )


async def dashboard(path: Path | str, *words: str) -> tuple[Program, str]:
    """A page's server; its process, and its address."""
    program = await Program.start(*CRAZYCHOIR, "dashboard", "--swarm", path, *words)
    line = await program.says("Ctrl-C ends it", 60.0)
    return program, line.split(": ", 1)[1].split(";")[0]


@contextlib.asynccontextmanager
async def looking_on(address: str) -> AsyncIterator[Seen]:
    """A page, as soon as it has been told all that there is."""
    async with connect(
        address.replace("http", "ws") + "/line", origin=address, max_size=None
    ) as socket:
        seen = Seen(socket)
        reading = asyncio.create_task(seen.read())
        await until(lambda: seen.about and seen.drones and seen.frames > 2, 20.0)
        try:
            yield seen
        finally:
            reading.cancel()
            await asyncio.wait([reading])
