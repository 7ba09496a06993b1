"""A recorded flight said again, on the topics of its drones: at its own pace, faster, or step by step."""

from collections.abc import Awaitable, Callable
from pathlib import Path

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import BY_NAME, OBSERVABLE, Topic
from crazychoir.recording.mcap.decode import Values
from crazychoir.recording.mcap.sequence import told
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import SECOND

Step = Callable[[], Awaitable[float]]
"""Waits until the replay may go on, and says by how many s of the flight."""


class Replayer(Actor):
    """Says all that was recorded of the observable topics, each at the address where it was said.

    speed: how many times faster than it was;  step: asked for every part of the flight instead, which is then said at
    once;  source: the address that says a topic of a drone. Raises ConfigError where a message is of another version.
    said: messages so far;  at: s of the flight that are over.
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
        """From the first message to the last."""
        values = Values(self.path)
        first_ns = -1
        began_ns = self.clock.now_ns()
        for message in told(self.path):
            topic = BY_NAME.get(message.source.topic.partition("/")[0])
            if topic is None or topic.name not in OBSERVABLE:
                continue
            if first_ns < 0:
                first_ns = message.came_ns
            at = (message.came_ns - first_ns) / SECOND
            if at > self.at:
                await self._wait(at, began_ns)
                self.at = at
            address = self.source(topic, message.source.drone)
            port = self.bus.ports.get(address) or self.bus.port(address)
            port.publish(
                topic,
                values.of(message),
                max(0.0, (message.came_ns - message.born_ns) / SECOND),
            )
            self.said += 1

    async def _wait(self, at: float, began_ns: int) -> None:
        """Until it is time for what came so many s after the first message."""
        if self.step is None:
            await self.clock.sleep_until(began_ns + round(at / self.speed * SECOND))
            return
        while at > self._may:
            self._may += await self.step()
