"""A bad cable between two namespaces."""

import asyncio
import contextlib
import json
import secrets
import sys
from collections.abc import AsyncIterator
from pathlib import Path

from system.agents import Program

from crazychoir.launch.namespaces import (
    NAMESPACE_DEVICE,
    connect_devices,
    make_namespace,
    run_iproute,
)

RELAY = (sys.executable, str(Path(__file__).with_name("relay.py")))


class Cable:
    """Two hosts on it: namespaces, by their names."""

    def __init__(
        self, names: dict[str, str], process: asyncio.subprocess.Process
    ) -> None:
        self.names, self.process = names, process

    def command(self, host: str) -> list[str]:
        return ["ip", "netns", "exec", self.names[host]]

    def change(self, **now_on: float) -> None:
        """loss: share of frames, each way;  delay: s, each way;  cut: 1 lets nothing pass."""
        self.process.stdin.write(json.dumps(now_on).encode() + b"\n")


@contextlib.asynccontextmanager
async def wired(addresses: dict[str, str], **now_on: float) -> AsyncIterator[Cable]:
    """Two hosts, by name and IPv4 address, at the ends of a cable that is as bad as `Cable.change` says."""
    token, middle = secrets.token_hex(3), []
    async with contextlib.AsyncExitStack() as stack:
        between = stack.enter_context(make_namespace(f"cc-{token}-cable"))
        names = {host: f"cc-{token}-{k}" for k, host in enumerate(addresses)}
        for host, address in addresses.items():
            stack.enter_context(make_namespace(names[host]))
            middle.append(f"end{len(middle)}")
            connect_devices((names[host], NAMESPACE_DEVICE), (between, middle[-1]))
            run_iproute(
                "-n",
                names[host],
                "address",
                "add",
                f"{address}/24",
                "dev",
                NAMESPACE_DEVICE,
            )
            done = await Program.start(
                "ip", "netns", "exec", names[host], *RELAY, NAMESPACE_DEVICE
            )
            assert (await done.end(20.0))["code"] == 0, done.text
        process = await asyncio.create_subprocess_exec(
            "ip",
            "netns",
            "exec",
            between,
            *RELAY,
            *middle,
            stdin=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        try:
            assert (
                await asyncio.wait_for(process.stderr.readline(), 20.0) == b"relaying\n"
            )
            made = Cable(names, process)
            made.change(**now_on)
            yield made
        finally:
            process.kill()
            await process.wait()
