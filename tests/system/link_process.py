"""A process with a Zenoh link, obeying the test: one JSON command a line in, one JSON answer a line out.

python link_process.py '{"process": "b-1", "swarm": "x", "listen": [...], "connect": [...], "drones": [2, 3]}'
"""

import asyncio
import contextlib
import itertools
import json
import sys
import time
from collections.abc import AsyncIterator
from typing import Any

import numpy as np

from crazychoir.bus.frames import Envelope
from crazychoir.bus.message import Message
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.network.zenoh_session import SessionEndpoints
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import TOPIC_BY_NAME, MessageClass
from crazychoir.errors import CrazyChoirError, Refused, SolverError
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, WallClock, run_wall
from crazychoir.team.algorithm_run import run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import ring

STREAMED_TOPICS = ("answer", "estop", "result", "sought")
"""Topics of numbered messages: of the classes rounds, estop, bulk and control."""


@contextlib.asynccontextmanager
async def linked(
    clock: Clock, process: str, swarm: str, drones: list[int], **options: Any
) -> AsyncIterator[ZenohLink]:
    """A bus with ports, linked and saying HELLO; closed at the end."""
    bus = Bus(clock, process=process, host=options.pop("host", "here"))
    for i in drones:
        bus.port(i)
    own = Introduction(swarm, incarnation=7, version=options.pop("version", "1"))
    reach = SessionEndpoints(
        listen=options.pop("listen", []),
        connect=options.pop("connect", []),
        lease=options.pop("lease", 1.0),
    )
    link = ZenohLink(bus, own, reach, **options)
    link.open()
    running = asyncio.create_task(link.run())
    try:
        yield link
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running
        await link.on_stop()


@contextlib.asynccontextmanager
async def wall_clock() -> AsyncIterator[WallClock]:
    """A clock on the running loop."""
    clock = WallClock(asyncio.get_running_loop())
    try:
        yield clock
    finally:
        clock.close()


async def consensus(
    communicator: Communicator, rounds: int, channel: str = "main"
) -> list[float]:
    """Averaging on the graph, from x = id."""
    x = np.full(6, float(communicator.id))
    for _ in range(rounds):
        heard = await communicator.neighbors_exchange(x, channel=channel, deadline=20.0)
        x = (x + sum(heard.values())) / (1 + len(heard))
    return x.tolist()


async def consensus_here(
    link: ZenohLink, size: int, rounds: int, channel: str = "main"
) -> dict[str, list[float]]:
    """All drones of this process take part."""
    team = [Communicator(port, ring(size)) for port in link.bus.ports.values()]
    results = await asyncio.gather(
        *(consensus(member, rounds, channel) for member in team)
    )
    await asyncio.gather(*(member.close() for member in team))
    return {str(member.id): x for member, x in zip(team, results, strict=True)}


class Failing:
    """Counts rounds; agent 1 cannot go on after five."""

    done = False

    def __init__(self, i: int) -> None:
        self.i, self.k = i, 0

    def message(self) -> int:
        return self.k

    def step(self, heard: dict[int, Any]) -> None:
        self.k += 1
        if (self.i, self.k) == (1, 5):
            raise SolverError("agent 1: local problem, row 2", "infeasible, b = -3")


async def endings_here(link: ZenohLink, size: int, loss: float) -> dict[str, str]:
    """What the agents of this process end with."""
    link.bus.impairment.update({"loss": loss})

    async def part(member: Communicator) -> str:
        try:
            await run_algorithm(member, Failing(member.id))
        except CrazyChoirError as error:
            return f"{type(error).__name__}: {error}"
        return "none"

    team = [Communicator(port, ring(size)) for port in link.bus.ports.values()]
    ends = await asyncio.gather(*map(part, team))
    return {str(member.id): end for member, end in zip(team, ends, strict=True)}


class Arrivals:
    """The numbered messages that the drones of this process have received, of some topics."""

    def __init__(self, link: ZenohLink) -> None:
        self.messages: list[tuple[str, int, int]] = []
        """Topic, source and number of each message, in the order of arrival."""
        self.worst_age: dict[int, float] = {}
        """s, by source."""
        for port in link.bus.ports.values():
            for name in STREAMED_TOPICS:
                port.handlers[TOPIC_BY_NAME[name].number] = self._take

    def _take(self, message: Message, age: float) -> None:
        source = message.source
        self.messages.append((message.topic.name, source, message.number))
        self.worst_age[source] = max(self.worst_age.get(source, 0.0), age)


class Commands:
    """What the test can ask for."""

    def __init__(self, link: ZenohLink) -> None:
        self.link = link
        self.refused: list[str] = []
        self.boxes: dict[str, Any] = {}
        self.arrivals_here = Arrivals(link)
        self.running: dict[str, asyncio.Task[Any]] = {}

    async def status(self) -> dict[str, Any]:
        """Return the processes that we have heard, the processes that have heard us, and all counters."""
        known = [peer for peer in self.link.peers.values() if peer.hello is not None]
        heard_by = [peer.process for peer in known if self.link.table.mutual(peer)]
        boxes = {name: box.received for name, box in self.boxes.items()}
        return {
            "heard": [peer.process for peer in known],
            "heard_by": heard_by,
            "refused": self.refused,
            "received": boxes,
            "messages": sum(
                port.counters.received for port in self.link.bus.ports.values()
            ),
            "counters": vars(self.link.counters),
            "connected": [
                peer.process
                for peer in known
                if peer.process in self.link.sockets.connections
            ],
            "path": self.link.sockets.address.path,
        }

    async def begin(self, work: str, **arguments: Any) -> dict[str, Any]:
        """Start another command."""
        self.running[work] = asyncio.create_task(getattr(self, work)(**arguments))
        return {}

    async def finish(self, work: str) -> dict[str, Any]:
        """Return the answer of a command that was started."""
        return await self.running.pop(work)

    async def cancel(self, work: str) -> dict[str, Any]:
        """Give up a command that was started."""
        task = self.running.pop(work)
        task.cancel()
        await asyncio.wait([task])
        return {}

    async def consensus(
        self, size: int, rounds: int, channel: str = "main"
    ) -> dict[str, Any]:
        """The averages of our drones."""
        return await consensus_here(self.link, size, rounds, channel)

    async def send(
        self,
        to: list[int],
        count: int,
        size: int,
        topic: str = "answer",
        first: int = 0,
    ) -> dict[str, Any]:
        """Send numbered messages of our first drone at once."""
        port = next(iter(self.link.bus.ports.values()))
        for number in range(first, first + count):
            message = Message(TOPIC_BY_NAME[topic], port.address, bytes(size), number)
            port.send(message, to)
            self.link.outbox.flush()
        return {}

    async def stream(
        self, to: list[int], period: float, size: int = 100
    ) -> dict[str, Any]:
        """Send one numbered message of our first drone each period, until cancelled."""
        for first in itertools.count():
            await self.send(to, 1, size, first=first)
            await asyncio.sleep(period)
        return {}

    async def flood(self, process: str, seconds: float) -> dict[str, Any]:
        """Send frames to a process as fast as its socket takes them; return how many went a second."""
        port = next(iter(self.link.bus.ports.values()))
        there = self.link.peers[process].hello.drones[0]
        message = Envelope(
            TOPIC_BY_NAME["answer"].number, port.address, (there,), 1, 0, 0.0, "", b""
        )
        frame = self.link.outbox.encode(MessageClass.ROUNDS, message)
        ends = time.perf_counter() + seconds
        sent = 0
        while time.perf_counter() < ends:
            for _ in range(500):
                sent += self.link.sockets.send(process, MessageClass.ROUNDS, frame)
            await asyncio.sleep(0)
        return {"rate": sent / seconds}

    async def ticks(self, seconds: float) -> dict[str, Any]:
        """How late the ticks of a controller are: the 99th percentile in ms."""
        clock = self.link.bus.clock
        ticks = clock.ticks(100.0)
        ends_ns = clock.now_ns() + round(seconds * NS_PER_SECOND)
        late_ns = []
        async for due_ns in ticks:
            late_ns.append(clock.now_ns() - due_ns)
            if clock.now_ns() > ends_ns:
                break
        p99 = float(np.percentile(late_ns, 99)) / NS_PER_SECOND
        return {"p99_ms": 1000.0 * p99, "missed": ticks.missed}

    async def arrivals(self) -> dict[str, Any]:
        """Return what our drones have received, and forget it."""
        here = self.arrivals_here
        found = {"messages": here.messages, "worst_age": here.worst_age}
        here.messages, here.worst_age = [], {}
        return found

    async def endings(self, size: int, loss: float) -> dict[str, Any]:
        """What our drones end with."""
        return await endings_here(self.link, size, loss)

    async def subscribe(
        self, topic: str, source: int, reader: int, rate: float = 0.0
    ) -> dict[str, Any]:
        """Read a topic of a drone."""
        row = TOPIC_BY_NAME[topic]
        self.boxes[topic] = row.mailbox(self.link.bus.clock)
        self.link.bus.subscribe(row, source, reader, self.boxes[topic], rate)
        return {}

    async def get(self, topic: str, seconds: float = 5.0) -> dict[str, Any]:
        """The next message of a topic."""
        async with asyncio.timeout(seconds):
            return {"value": repr(await self.boxes[topic].get())}


def answer(value: dict[str, Any]) -> None:
    """One line."""
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


async def obey(clock: Clock, options: dict[str, Any]) -> None:
    """Until standard input ends."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), sys.stdin
    )
    refused: list[str] = []

    def on_refused(error: Refused) -> None:
        refused.append(str(error))

    async with linked(clock, **options, on_refused=on_refused) as link:
        commands = Commands(link)
        commands.refused = refused
        answer({"open": link.bus.process})
        while line := await reader.readline():
            name, arguments = json.loads(line)
            answer(await getattr(commands, name)(**arguments))


if __name__ == "__main__":
    run_wall(lambda clock: obey(clock, json.loads(sys.argv[1])))
