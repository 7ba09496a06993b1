"""Processes with a Zenoh link, which a test starts and asks: see link_process.py."""

import asyncio
import contextlib
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

CHILD = Path(__file__).with_name("link_process.py")


def endpoint(port: int) -> str:
    return f"tcp/127.0.0.1:{port}"


async def until(condition: Callable[[], Any], seconds: float = 10.0) -> float:
    """Wait for it; returns how long that took."""
    began = time.perf_counter()
    async with asyncio.timeout(seconds):
        while not condition():  # noqa: ASYNC110 - of another process or thread
            await asyncio.sleep(0.001)
    return time.perf_counter() - began


class Child:
    """Another process, and its answers."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process

    @classmethod
    async def start(
        cls, options: dict[str, Any], stack: contextlib.AsyncExitStack
    ) -> "Child":
        """Start a process and wait until its link is open; `stack` ends it."""
        pipe = asyncio.subprocess.PIPE
        started = await asyncio.create_subprocess_exec(
            sys.executable,
            CHILD,
            json.dumps(options),
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
        )
        stack.push_async_callback(reap, started)
        child = cls(started)
        assert await child.answer() == {"open": options["process"]}
        return child

    async def ask(self, command: str, **arguments: Any) -> dict[str, Any]:
        self.process.stdin.write(json.dumps([command, arguments]).encode() + b"\n")
        return await self.answer()

    async def answer(self) -> dict[str, Any]:
        async with asyncio.timeout(30):
            line = await self.process.stdout.readline()
        assert line, (await self.process.stderr.read()).decode()
        return json.loads(line)

    async def when(self, name: str, empty: bool = False) -> dict[str, Any]:
        """Return the status of the child as soon as an entry is there (or gone)."""
        async with asyncio.timeout(5):
            while bool((status := await self.ask("status"))[name]) is empty:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        return status

    async def end(self) -> str:
        """Close its input and wait; returns what it wrote to standard error."""
        self.process.stdin.close()
        async with asyncio.timeout(10):
            errors = await self.process.stderr.read()
            assert await self.process.wait() == 0, errors.decode()
        return errors.decode()


async def reap(process: asyncio.subprocess.Process) -> None:
    if process.returncode is None:
        process.kill()
    await process.wait()
    process._transport.close()
