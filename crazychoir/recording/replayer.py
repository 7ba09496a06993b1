"""Publish a recorded flight again on the topics of its drones.

The replay runs at the flight's own speed, faster, or step by step.
"""

from collections.abc import Awaitable, Callable
from pathlib import Path

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import OBSERVABLE_TOPICS, TOPIC_BY_NAME, Topic
from crazychoir.recording.mcap.decode import MessageDecoder
from crazychoir.recording.mcap.sequence import read_messages
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND

Step = Callable[[], Awaitable[float]]
"""Coroutine function: waits until the replay may go on, and returns the s of flight to publish next."""


class Replayer(Actor):
    """Publishes the messages of a recording again, if their topics are in OBSERVABLE_TOPICS.

    bus: the bus to publish on
    path: the recording
    speed: factor on the speed of the flight; 2 is twice as fast
    step: for a replay step by step, without `speed`. It is awaited, and returns the s of flight to
        publish next, without waiting in between
    source: returns the address that publishes a topic of a drone
    said: number of messages published so far
    at: s of the flight that have been replayed
    Raises ConfigError if a message has another version.
    """

    name = "replay"

    def __init__(
        self,
        bus: Bus,
        path: Path,
        speed: float = 1.0,
        step: Step | None = None,
        source: Callable[[Topic, int], int] = lambda topic, i: i,
    ) -> None:
        self.bus = bus
        self.clock = bus.clock
        self.path = path
        self.speed = speed
        self.step = step
        self.source = source
        self.said = 0
        self.at = 0.0
        self._may = 0.0

    async def run(self) -> None:
        """Publish from the first message to the last."""
        values = MessageDecoder(self.path)
        first_ns = -1
        began_ns = self.clock.now_ns()
        for message in read_messages(self.path):
            topic = TOPIC_BY_NAME.get(message.source.topic.partition("/")[0])
            if topic is None or topic.name not in OBSERVABLE_TOPICS:
                continue
            if first_ns < 0:
                first_ns = message.came_ns
            at = (message.came_ns - first_ns) / NS_PER_SECOND
            if at > self.at:
                await self._wait(at, began_ns)
                self.at = at
            address = self.source(topic, message.source.drone)
            port = self.bus.ports.get(address) or self.bus.port(address)
            port.publish(
                topic,
                values.of(message),
                max(0.0, (message.came_ns - message.born_ns) / NS_PER_SECOND),
            )
            self.said += 1

    async def _wait(self, at: float, began_ns: int) -> None:
        """Wait until a message that came `at` s after the first message is due."""
        if self.step is None:
            await self.clock.sleep_until(
                began_ns + round(at / self.speed * NS_PER_SECOND)
            )
            return
        while at > self._may:
            self._may += await self.step()
