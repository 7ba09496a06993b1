"""Agents as real processes, and an observer: start them, read what they say, stop them."""

import asyncio
import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.feedback import LAW_TASK

AGENT = (sys.executable, "-m", "crazychoir.cli.fly.agent")
CRAZYCHOIR = (sys.executable, "-m", "crazychoir.cli.main")
WORLD = (sys.executable, "-m", "crazychoir.cli.fly.world")
MOCAP = (sys.executable, "-m", "crazychoir.cli.fly.mocap")
RADIO = (sys.executable, "-m", "crazychoir.cli.fly.radio_owner")
OBSERVER = (sys.executable, str(Path(__file__).with_name("observer.py")))
BRISK = {
    "takeoff_height": 0.5,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.6,
}

Place = Callable[[int], list[str]]
"""What the command line of a drone's process begins with."""


@dataclass
class Program:
    """A running process: lines of its standard error as they come, one JSON object at its end."""

    process: asyncio.subprocess.Process
    said: list[str] = field(default_factory=list)
    ended: float = float("nan")
    _reading: list["asyncio.Task[Any]"] = field(default_factory=list)

    @classmethod
    async def start(cls, *command: str | Path) -> "Program":
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(
            *map(str, command),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=pipe,
            stderr=pipe,
            limit=1 << 24,
            env={**os.environ, "PYTHONFAULTHANDLER": "1"},
        )
        program = cls(process)
        program._reading = [
            asyncio.create_task(process.stdout.read()),
            asyncio.create_task(program._listen()),
        ]
        return program

    async def _listen(self) -> None:
        async for line in self.process.stderr:
            self.said.append(line.decode(errors="replace").rstrip())
        self.ended = time.monotonic()

    def signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(number)

    async def end(self, seconds: float) -> dict[str, Any]:
        """Wait for its end; returns its JSON object, if that is what it answered, with the exit code and the answer."""
        _, reading = await asyncio.wait(self._reading, timeout=seconds)
        if reading:
            self.signal(signal.SIGABRT)  # it says where all of its threads are
            await asyncio.wait(reading, timeout=1.0)
            raise AssertionError(
                f"still running after {seconds:g} s; it said: {self.text}"
            )
        code, out = await self.process.wait(), self._reading[0].result()
        told = json.loads(out) if out.startswith(b"{") else {}
        return {**told, "code": code, "answer": out.decode()}

    async def says(self, text: str, seconds: float = 40.0) -> str:
        """Wait until a line of its standard error contains the text; returns the line."""
        await until(
            lambda: text in self.text, seconds, lambda: f"{text!r} not in {self.text}"
        )
        return next(line for line in self.said if text in line)

    @property
    def text(self) -> str:
        return "\n".join(self.said)

    async def kill(self) -> None:
        if self.process.returncode is None:
            self.signal(signal.SIGKILL)
        await self.process.wait()
        for task in self._reading:
            task.cancel()
        await asyncio.gather(*self._reading, return_exceptions=True)


async def until(
    condition: Callable[[], Any], seconds: float, why: Callable[[], str] = str
) -> None:
    ends = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < ends, f"not within {seconds:g} s: {why()}"
        await asyncio.sleep(0.01)


class Team:
    """The processes of one swarm, by their lowest drone, and an observer of it."""

    def __init__(self, config: SwarmConfig, folder: Path, place: Place) -> None:
        self.config, self.path, self.place = config, folder / "swarm.json", place
        folder.mkdir(exist_ok=True)
        self.path.write_text(config.dumps())
        self.agents: dict[int, Program] = {}
        self.observer: Program
        self._statuses: list[dict[str, Any]] = []
        self._read = 0

    async def look(self) -> None:
        self.observer = await Program.start(
            *self.place(self.config.ids[0]), *OBSERVER, self.path
        )

    async def start(self, *groups: tuple[int, ...]) -> None:
        for group in groups:
            ids = [word for i in group for word in ("--id", str(i))]
            command = (
                *self.place(group[0]),
                *AGENT,
                "--swarm",
                self.path,
                "--json",
                *ids,
            )
            self.agents[group[0]] = await Program.start(*command)

    def statuses(self, drone: int | None = None) -> list[dict[str, Any]]:
        """What the observer has heard, oldest first."""
        said = self.observer.said
        for line in said[self._read :]:
            heard = json.loads(line) if line.startswith("{") else {}
            if "status" in heard:
                self._statuses.append(
                    heard["status"] | {"t": heard["t"], "drone": heard["drone"]}
                )
        self._read = len(said)
        return [status for status in self._statuses if drone in (None, status["drone"])]

    def newest(self) -> list[dict[str, Any]]:
        """Return the last status of every drone; the status of an unheard drone has an empty phase and task."""
        return [
            (self.statuses(i) or [{"phase": "", "task": ""}])[-1]
            for i in self.config.ids
        ]

    def planning_round(self) -> int:
        """Return the highest round that was seen in planning; -1 as soon as a drone agrees or flies."""
        seen = self.statuses()
        if any(status["task"].startswith(("agreeing", "flying")) for status in seen):
            return -1
        return max(
            (
                status["round"]
                for status in seen
                if status["task"].startswith("planning")
            ),
            default=0,
        )

    async def in_planning(self, k: int) -> None:
        await until(
            lambda: self.planning_round() >= k or self.planning_round() < 0,
            60,
            lambda: self.text,
        )
        assert self.planning_round() >= k, "planning was over before the test saw it"

    async def phase(self, *phases: str, seconds: float = 40.0) -> None:
        """Wait until every drone was seen in one of these phases."""
        await until(
            lambda: all(
                any(s["phase"] in phases for s in self.statuses(i))
                for i in self.config.ids
            ),
            seconds,
            lambda: f"not all {phases}: {self.text}",
        )

    async def law(self, seconds: float = 40.0) -> None:
        """Wait until every drone was seen in the law of its mission: they have met in the air."""
        await until(
            lambda: all(
                any(s["task"] == LAW_TASK for s in self.statuses(i))
                for i in self.config.ids
            ),
            seconds,
            lambda: f"not all in the law: {self.text}",
        )

    async def end(self, seconds: float, *without: int) -> dict[int, dict[str, Any]]:
        """What each process says at its end, by its lowest drone."""
        there = {i: program for i, program in self.agents.items() if i not in without}
        ended = await asyncio.gather(
            *(program.end(seconds) for program in there.values())
        )
        return dict(zip(there, ended, strict=True))

    @property
    def text(self) -> str:
        return "\n".join(f"{i}: {program.text}" for i, program in self.agents.items())


@contextlib.asynccontextmanager
async def flying(
    config: SwarmConfig, folder: Path, place: Place = lambda i: []
) -> AsyncIterator[Team]:
    """All processes of the swarm file; killed afterwards."""
    team = Team(config, folder, place)
    try:
        await team.look()
        await team.start(*Addresses(config).groups())
        yield team
    finally:
        await asyncio.gather(
            *(program.kill() for program in [team.observer, *team.agents.values()])
        )


def seen(
    ended: dict[int, dict[str, Any]], i: int, j: int, state: str, after: float
) -> float:
    """s after `after` at which drone i began to hold j for `state`."""
    history = ended[i]["presence"][str(i)]
    times = [t for t, who, what in history if (who, what) == (j, state) and t > after]
    assert times, f"drone {i} never saw drone {j} {state}: {history}"
    return times[0] - after


def results(ended: dict[int, dict[str, Any]]) -> dict[int, dict[str, Any]]:
    """Each drone's result."""
    return {
        int(i): result
        for one in ended.values()
        for i, result in one.get("results", {}).items()
    }
