"""Zenoh alone: each agent has a publisher, and a subscriber for each of its neighbours.

A callback in Zenoh's thread wakes uvloop. Puts wait if a queue is full, so no message is lost.
"""

import asyncio
import importlib
import json
import time
from collections import deque
from typing import Any

from crazychoir.bench.peers.peers import specification
from crazychoir.bench.peers.round_inbox import (
    MESSAGE_LAYOUT,
    RoundInbox,
    run_agents,
)

LOOK_INTERVAL = 0.05
"""Seconds between two looks for the tokens of the others."""


def open_session(spec: dict[str, Any]) -> Any:
    """Open a session that listens and connects as the argument of the program says."""
    zenoh = importlib.import_module("zenoh")
    config = zenoh.Config()
    for key in ("listen", "connect"):
        config.insert_json5(f"{key}/endpoints", json.dumps(spec[key]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def meet(session: Any, spec: dict[str, Any], processes: int) -> list[Any]:
    """Wait until each process sees the tokens of all, and return those of this process.

    The subscribers of a process are known before its token. Tokens that are not kept disappear.
    """
    tokens = []
    for word in ("here", "met"):
        key = f"{spec['swarm']}/{word}"
        tokens.append(session.liveliness().declare_token(f"{key}/{spec['process']}"))
        while len(list(session.liveliness().get(f"{key}/*"))) < processes:
            time.sleep(LOOK_INTERVAL)
    return tokens


class ZenohAgents:
    """The agents of one process."""

    def __init__(self, spec: dict[str, Any]) -> None:
        zenoh = importlib.import_module("zenoh")
        self._loop = asyncio.get_running_loop()
        self.tokens: list[Any] = []
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._is_woken = False
        self.session = open_session(spec)
        self.inboxes = {i: RoundInbox(len(spec["neighbors"][i])) for i in spec["mine"]}
        self._publishers = {
            i: self.session.declare_publisher(
                f"{spec['swarm']}/{i}",
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            for i in spec["mine"]
        }
        self._subscribers = [
            self.session.declare_subscriber(f"{spec['swarm']}/{j}", self._listener(i))
            for i in spec["mine"]
            for j in spec["neighbors"][i]
        ]

    def _listener(self, i: int) -> Any:
        def listen(sample: Any) -> None:
            self._waiting.append((i, sample.payload.to_bytes()))
            if not self._is_woken:
                self._is_woken = True
                self._loop.call_soon_threadsafe(self._drain)

        return listen

    def _drain(self) -> None:
        self._is_woken = False
        for _ in range(len(self._waiting)):
            i, data = self._waiting.popleft()
            source, k, *_ = MESSAGE_LAYOUT.unpack(data)
            self.inboxes[i].put(source, k)

    def publish(self, i: int, data: bytes) -> None:
        """Send a message of an agent to all that read it."""
        self._publishers[i].put(data)


async def main() -> None:
    """Find the others, wait for go, and exchange until killed."""
    spec = specification()
    agents = ZenohAgents(spec)
    agents.tokens = meet(agents.session, spec, 1 + len(spec["connect"]))
    await run_agents(spec, agents.inboxes, agents.publish)


if __name__ == "__main__":
    importlib.import_module("uvloop").run(main())
