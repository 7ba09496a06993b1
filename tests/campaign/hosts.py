"""Hosts in virtual time: each has its own bus, a clock that may be ahead, and a way to the drones of other hosts."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.message import Message
from crazychoir.bus.port import Bus
from crazychoir.runtime.clock import NS_PER_SECOND, Alarm, Clock

T = TypeVar("T")


class Skewed(Clock):
    """The time of another clock, so many seconds ahead."""

    virtual = True

    def __init__(self, clock: Clock, ahead: float) -> None:
        super().__init__()
        self._clock, self._loop, self._ahead_ns = (
            clock,
            clock._loop,
            round(ahead * NS_PER_SECOND),
        )

    def now_ns(self) -> int:
        return self._clock.now_ns() + self._ahead_ns

    def push(self, when_ns: int, alarm: Alarm, priority: int, drone: int) -> None:
        self._clock.push(when_ns - self._ahead_ns, alarm, priority, drone)

    async def compute(self, function: Callable[..., T], *args: Any) -> T:
        return await self._clock.compute(function, *args)


class Way:
    """A way for messages from one host to all others, without delay."""

    def __init__(self, own: Bus, others: Sequence[Bus]) -> None:
        self.own, self.others = own, others

    def forward(self, message: Message, to: list[int], age: float) -> None:
        for j in to:
            for bus in self.others:
                port = bus.ports.get(j)
                if port is not None:
                    bus.deliver(message, (j,), age)
                    break
            else:
                self.own.unroutable += 1

    def then(self, work: Callable[[], None]) -> None:
        self.own.clock.soon(work)

    def interested(self) -> None:
        """Do nothing: no program here reads the topics of another host."""


def hosts(
    clock: Clock, ahead: Sequence[float], impairment: Callable[[], Impairment]
) -> list[Bus]:
    """A bus for each number of seconds that its clock is ahead."""
    made = [
        Bus(Skewed(clock, seconds), impairment(), process=f"p{k}", host=f"h{k}")
        for k, seconds in enumerate(ahead)
    ]
    for own in made:
        own.forwarder = Way(own, [bus for bus in made if bus is not own])
    return made
