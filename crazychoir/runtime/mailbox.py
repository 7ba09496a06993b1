"""Mailboxes: a message waits here for its actor.

The policy decides what happens if it is not read in time. A mailbox belongs to the drone, not to
the actor: it survives a restart of its reader. A message carries its age and not a time stamp; the
receiver's own clock then adds to this age.
"""

import asyncio
import sys
from collections import deque
from collections.abc import Callable
from math import inf
from typing import Any, Generic, TypeVar

from crazychoir.runtime.clock import NS_PER_SECOND, Clock, wake_waiter

T = TypeVar("T")
AGE_TOLERANCE = 1_000
"""Nanoseconds by which two ages may differ although they are equal: ages are rounded."""


class Mailbox(Generic[T]):
    """A mailbox of any policy: its counters, and the one reader that waits."""

    def __init__(self, clock: Clock, name: str = "") -> None:
        self.clock = clock
        self.name = name
        self.received = 0
        """Messages put into the mailbox."""
        self.dropped = 0
        """Messages lost without being read."""
        self.stale = 0
        """Reads that found only a message older than `max_age`."""
        self._waiter: asyncio.Future[None] | None = None

    def put(self, value: T, age: float = 0.0) -> None:
        """Put a message that is `age` seconds old; never wait."""
        raise NotImplementedError

    def clear(self) -> None:
        """Forget the content, for example when the reader restarts."""
        raise NotImplementedError

    def _wake(self) -> None:
        if self._waiter is not None:
            waiter = self._waiter
            self._waiter = None
            wake_waiter(waiter)

    async def _wait(self) -> None:
        self._waiter = asyncio.get_running_loop().create_future()
        await self._waiter


class Latest(Mailbox[T]):
    """A mailbox of one slot: a message replaces an older one.

    `dropped` counts the messages that were replaced before they were read or came after a newer
    message.

    max_age: s: beyond it `fresh` returns no message; None: messages do not become stale
    """

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
        """Replace the content, unless it is newer: one message may overtake another on the way."""
        self.received += 1
        born_ns = self._now_ns() - round(age * NS_PER_SECOND) if age else self._now_ns()
        if born_ns < self._born_ns - AGE_TOLERANCE:
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
        """Wait for a message that was not read yet, and return it."""
        while self.version == self._seen:
            await self._wait()
        self._seen = self.version
        return self._value  # type: ignore[return-value]

    def peek(self) -> T | None:
        """Return the content, however old; None before the first message."""
        self._seen = self.version
        return self._value

    def fresh(self) -> T | None:
        """Return the content if it is not older than `max_age`.

        Otherwise count it as stale and return None.
        """
        return self.fresh_with_age()[0]

    def fresh_with_age(self) -> tuple[T | None, float]:
        """Return `fresh()` and the age of the content in s."""
        age = (self._now_ns() - self._born_ns) / NS_PER_SECOND if self.version else inf
        if self.max_age is not None and age > self.max_age:
            self.stale += self.version > 0
            return None, age
        self._seen = self.version
        return self._value, age

    def age(self) -> float:
        """Return the age of the content in s; infinite before the first message."""
        return (self._now_ns() - self._born_ns) / NS_PER_SECOND if self.version else inf

    def clear(self) -> None:
        """Return to the state before the first message."""
        self.version = self._seen = 0
        self._value = None
        self._born_ns = -sys.maxsize


class DropOldest(Mailbox[T]):
    """A queue of at most `size` messages: when it is full, the oldest message is dropped."""

    def __init__(self, clock: Clock, name: str = "", size: int = 64) -> None:
        super().__init__(clock, name)
        self._queue: deque[T] = deque(maxlen=size)

    def put(self, value: T, age: float = 0.0) -> None:
        """Append a message; drop the oldest if the queue is full."""
        self.received += 1
        if len(self._queue) == self._queue.maxlen:
            self.dropped += 1
        self._queue.append(value)
        self._wake()

    async def get(self) -> T:
        """Wait for the oldest message, and return it."""
        while not self._queue:
            await self._wait()
        return self._queue.popleft()

    def take(self) -> list[T]:
        """Empty the queue and return its messages, oldest first."""
        content = list(self._queue)
        self._queue.clear()
        return content

    def clear(self) -> None:
        """Empty the queue."""
        self._queue.clear()


class BlockingQueue(Mailbox[T]):
    """A queue of at most `size` messages; the sender waits for room.

    Use it inside one process only.
    """

    def __init__(self, clock: Clock, name: str = "", size: int = 64) -> None:
        super().__init__(clock, name)
        self._queue: asyncio.Queue[T] = asyncio.Queue(size)

    def put(self, value: T, age: float = 0.0) -> None:
        """Append a message. Raises asyncio.QueueFull if there is no room."""
        self._queue.put_nowait(value)
        self.received += 1

    async def put_wait(self, value: T) -> None:
        """Append a message as soon as there is room."""
        await self._queue.put(value)
        self.received += 1

    async def get(self) -> T:
        """Wait for the oldest message, and return it."""
        return await self._queue.get()

    def clear(self) -> None:
        """Empty the queue and let waiting senders in."""
        while not self._queue.empty():
            self._queue.get_nowait()


class Call(Mailbox[T]):
    """A mailbox without a slot: a function takes each message at once, with its age."""

    def __init__(
        self, clock: Clock, function: Callable[[T, float], None], name: str = ""
    ) -> None:
        super().__init__(clock, name)
        self.function = function

    def put(self, value: T, age: float = 0.0) -> None:
        """Call the function with the message and its age."""
        self.received += 1
        self.function(value, age)

    def clear(self) -> None:
        """Do nothing: this mailbox keeps no messages."""


AnyMailbox = Mailbox[Any]
"""A mailbox of messages of any type."""
