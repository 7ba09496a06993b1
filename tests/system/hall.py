"""A hall of virtual Crazyflies in a process of its own, and runs that fly them through cflib in other processes."""

import asyncio
import json
import os
import signal
import socket
import subprocess
from pathlib import Path
from typing import Any, Self

from system.agents import CRAZYCHOIR, Program

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.launch.network import isolate_swarm
from crazychoir.radio.virtual.control import ask_server


def udp_block(count: int) -> int:
    """Return the first of so many free UDP ports in a row; the port below the first is free too.

    The search begins at a port that depends on the id of this process. The programs of an earlier test process may
    still send to its ports for some seconds.
    """
    for first in range(21_000 + 97 * (os.getpid() % 200), 60_000, 97):
        kept = []
        try:
            for port in range(first - 1, first + count):
                probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                kept.append(probe)
                probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        else:
            return first
        finally:
            for probe in kept:
                probe.close()
    raise AssertionError("no free UDP ports")


def reached(
    config: SwarmConfig,
    ids: tuple[int, ...] | None = None,
    per_dongle: int = 2,
    **tables: Any,
) -> SwarmConfig:
    """The swarm with these drones (None: all) behind udp:// uris, so many a dongle; nothing else changes but tables."""
    first = udp_block(len(config.ids))
    raw = json.loads(config.dumps())
    named = [drone for drone in raw["drones"] if ids is None or drone["id"] in ids]
    for k, drone in enumerate(named):
        drone |= {"uri": f"udp://127.0.0.1:{first + k}", "dongle": k // per_dongle}
    raw["mocap"]["port"] = first - 1
    for name, values in tables.items():
        raw[name] = raw[name] | values if isinstance(values, dict) else values
    return isolate_swarm(SwarmConfig.of(raw), None)


def processes(pattern: str) -> list[int]:
    """Return the ids of the processes with a command line that matches."""
    found = subprocess.run(
        ["pgrep", "-f", pattern], capture_output=True, text=True, check=False
    ).stdout
    return [int(word) for word in found.split()]


class Hall:
    """The virtual drones of a swarm, served while the context lasts."""

    def __init__(self, config: SwarmConfig, folder: Path, *options: str) -> None:
        self.config, self.options = config, options
        self.path = folder / "swarm.json"
        self.path.write_text(config.dumps())
        self.programs: list[Program] = []

    async def __aenter__(self) -> Self:
        await self._start("virtual", "--swarm", str(self.path), *self.options)
        for _ in range(600):
            try:
                self.state()
                return self
            except Refused:  # it is starting
                await asyncio.sleep(0.1)
        raise AssertionError(f"the hall does not open: {self.programs[0].text}")

    async def __aexit__(self, *_: object) -> None:
        for program in reversed(self.programs):
            await program.kill()

    async def _start(self, *command: str) -> Program:
        program = await Program.start(*CRAZYCHOIR, *command)
        self.programs.append(program)
        return program

    async def fly(self, *options: str) -> Program:
        """A run of the swarm, begun."""
        return await self._start("run", str(self.path), "--json", *options)

    def ask(self, question: dict[str, Any]) -> dict[str, Any]:
        """An answer of the hall."""
        return ask_server(question, port=self.config.mocap.port)

    def state(self) -> dict[int, dict[str, Any]]:
        """The truth about each drone."""
        return {
            int(i): said for i, said in self.ask({"ask": "state"})["drones"].items()
        }

    def fault(self, drone: int | str, **faults: Any) -> None:
        """Let something go wrong, or right again."""
        self.ask({"faults": {str(drone): faults}})

    async def until(
        self, holds: Any, seconds: float = 60.0
    ) -> dict[int, dict[str, Any]]:
        """Wait until the truth is so; returns it."""
        loop = asyncio.get_running_loop()
        ends = loop.time() + seconds
        while not holds(state := self.state()):
            assert loop.time() < ends, (
                f"not so within {seconds:g} s: {state}; {[p.text for p in self.programs]}"
            )
            await asyncio.sleep(0.05)
        return state

    async def end(self, program: Program, seconds: float = 120.0) -> dict[str, Any]:
        """What the run says at its end."""
        return await program.end(seconds)

    def interrupt(self, program: Program) -> None:
        """Ctrl-C."""
        program.signal(signal.SIGINT)
