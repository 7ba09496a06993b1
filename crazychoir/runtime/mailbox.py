"""Mailboxes: where a message waits for its actor. The policy says what happens when it is not read in time.

A mailbox belongs to the drone, not to the actor: it survives a restart of its reader. Ages are kept instead
of time stamps: a message arrives with its age, and grows older by the receiver's own clock.
"""

import asyncio
import sys
from collections import deque
from collections.abc import Callable
from math import inf
from typing import Any, Generic, TypeVar

from crazychoir.runtime.clock import SECOND, Clock, wake

T = TypeVar("T")
SAME_TIME = 1_000
"""ns by which two ages may be wrong: they are rounded."""


class Mailbox(Generic[T]):
    """What the policies share: counters, and one reader that waits."""

    def __init__(self, clock: Clock, name: str = "") -> None:
        self.clock = clock
        self.name = name
        self.received = 0
        self.dropped = 0
        self.stale = 0
        self._waiter: asyncio.Future[None] | None = None

    def put(self, value: T, age: float = 0.0) -> None:
        """Leave a message that is `age` s old; never waits."""
        raise NotImplementedError

    def clear(self) -> None:
        """Forget the content, as when the reader restarts."""
        raise NotImplementedError

    def _wake(self) -> None:
        if self._waiter is not None:
            waiter = self._waiter
            self._waiter = None
            wake(waiter)

    async def _wait(self) -> None:
        self._waiter = asyncio.get_running_loop().create_future()
        await self._waiter


class Latest(Mailbox[T]):
    """One slot: a message replaces an older one; `dropped` counts those that nobody read, and those that came late."""

    def __init__(
        self, clock: Clock, name: str = "", max_age: float | None = None
    ) -> None:
        super().__init__(clock, name)
        self.max_age = max_age
        self._now_ns = clock.now_ns
        self.version = 0
        self._seen = 0
        self._value: T | None = None
        self._born_ns = -sys.maxsize

    def put(self, value: T, age: float = 0.0) -> None:
        """Replace the content, unless that is newer: on the way one message may overtake another."""
        self.received += 1
        born_ns = self._now_ns() - round(age * SECOND) if age else self._now_ns()
        if born_ns < self._born_ns - SAME_TIME:
            self.dropped += 1
            return
        if self.version > self._seen:
            self.dropped += 1
        self.version += 1
        self._value = value
        self._born_ns = born_ns
        if self._waiter is not None:
            self._wake()

    async def get(self) -> T:
        """Wait for a message that was not read yet."""
        while self.version == self._seen:
            await self._wait()
        self._seen = self.version
        return self._value  # type: ignore[return-value]

    def peek(self) -> T | None:
        """The content, however old; None before the first message."""
        self._seen = self.version
        return self._value

    def fresh(self) -> T | None:
        """The content if it is not beyond `max_age`, else None and counted as stale."""
        return self.fresh_with_age()[0]

    def fresh_with_age(self) -> tuple[T | None, float]:
        """`fresh()`, and the age of what is there."""
        age = (self._now_ns() - self._born_ns) / SECOND if self.version else inf
        if self.max_age is not None and age > self.max_age:
            self.stale += self.version > 0
            return None, age
        self._seen = self.version
        return self._value, age

    def age(self) -> float:
        """Seconds since the content was born; infinite before the first message."""
        return (self._now_ns() - self._born_ns) / SECOND if self.version else inf

    def clear(self) -> None:
        """Back to before the first message."""
        self.version = self._seen = 0
        self._value = None
        self._born_ns = -sys.maxsize


class DropOldest(Mailbox[T]):
    """A queue of at most `size`: when full, the oldest message goes."""

    def __init__(self, clock: Clock, name: str = "", size: int = 64) -> None:
        super().__init__(clock, name)
        self._queue: deque[T] = deque(maxlen=size)

    def put(self, value: T, age: float = 0.0) -> None:
        """Append, dropping the oldest if need be."""
        self.received += 1
        if len(self._queue) == self._queue.maxlen:
            self.dropped += 1
        self._queue.append(value)
        self._wake()

    async def get(self) -> T:
        """Wait for the oldest message."""
        while not self._queue:
            await self._wait()
        return self._queue.popleft()

    def take(self) -> list[T]:
        """All that is there, oldest first."""
        content = list(self._queue)
        self._queue.clear()
        return content

    def clear(self) -> None:
        """Empty the queue."""
        self._queue.clear()


class Block(Mailbox[T]):
    """A queue of at most `size` whose sender waits for room; inside a process only."""

    def __init__(self, clock: Clock, name: str = "", size: int = 64) -> None:
        super().__init__(clock, name)
        self._queue: asyncio.Queue[T] = asyncio.Queue(size)

    def put(self, value: T, age: float = 0.0) -> None:
        """Append; raises asyncio.QueueFull when there is no room."""
        self._queue.put_nowait(value)
        self.received += 1

    async def put_wait(self, value: T) -> None:
        """Append as soon as there is room."""
        await self._queue.put(value)
        self.received += 1

    async def get(self) -> T:
        """Wait for the oldest message."""
        return await self._queue.get()

    def clear(self) -> None:
        """Empty the queue and let waiting senders in."""
        while not self._queue.empty():
            self._queue.get_nowait()


class Call(Mailbox[T]):
    """No slot: a function takes each message at once, with its age."""

    def __init__(
        self, clock: Clock, function: Callable[[T, float], None], name: str = ""
    ) -> None:
        super().__init__(clock, name)
        self.function = function

    def put(self, value: T, age: float = 0.0) -> None:
        """Call it."""
        self.received += 1
        self.function(value, age)

    def clear(self) -> None:
        """Nothing is kept."""


AnyMailbox = Mailbox[Any]
