"""Asynchronous objects for programs without an event loop: their loop runs in a thread."""

import asyncio
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from contextlib import AbstractAsyncContextManager
from types import MethodType
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar, overload

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
Enter = Callable[[], AbstractAsyncContextManager[T]]
"""Returns the asynchronous context that a thread keeps open."""


class LoopThread(Generic[T]):
    """A thread with an event loop that keeps an asynchronous context open.

    enter: returns the context
    Raises all errors of entering the context.
    """

    def __init__(self, enter: Enter[T]) -> None:
        self._ready: Future[T] = Future()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ending: asyncio.Event | None = None
        self._thread = threading.Thread(
            target=self._run, args=(enter,), name="swarm", daemon=True
        )
        self._thread.start()
        self.value: T = self._ready.result()
        """What the context gives."""

    def _run(self, enter: Enter[T]) -> None:
        import uvloop

        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run(self._keep_open(enter))

    async def _keep_open(self, enter: Enter[T]) -> None:
        self._loop = asyncio.get_running_loop()
        self._ending = asyncio.Event()
        try:
            async with enter() as value:
                self._ready.set_result(value)
                await self._ending.wait()
        except BaseException as error:
            if self._ready.done():
                raise
            self._ready.set_exception(error)

    def call(self, work: Coroutine[Any, Any, R]) -> R:
        """Run a coroutine in the loop, and return its result. Ctrl-C cancels it."""
        if self._loop is None or not self._thread.is_alive():
            work.close()
            raise RuntimeError("the connection to the swarm is closed")
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def close(self) -> None:
        """Leave the context, and end the thread."""
        if self._loop is not None and self._ending is not None:
            if self._thread.is_alive():
                self._loop.call_soon_threadsafe(self._ending.set)
            self._thread.join()


class HasThread(Protocol):
    """An object with an asynchronous counterpart that lives in a thread."""

    @property
    def thread(self) -> LoopThread[Any]:
        """The thread of the loop."""
        ...

    @property
    def counterpart(self) -> Any:
        """The asynchronous object."""
        ...


class BlockingVerb(Generic[P, R]):
    """A coroutine function of an asynchronous object, as a method that waits for its result.

    Arguments, defaults and documentation stay those of the coroutine function.
    """

    def __init__(
        self, verb: Callable[Concatenate[Any, P], Coroutine[Any, Any, R]]
    ) -> None:
        self.verb = verb
        self.__doc__ = verb.__doc__

    @overload
    def __get__(self, owner: None, kind: type) -> "BlockingVerb[P, R]": ...
    @overload
    def __get__(self, owner: HasThread, kind: type) -> Callable[P, R]: ...
    def __get__(
        self, owner: HasThread | None, kind: type
    ) -> "BlockingVerb[P, R] | Callable[..., R]":
        if owner is None:
            return self
        return MethodType(_call_verb, (owner, self.verb))


def _call_verb(
    bound: tuple[HasThread, Callable[..., Coroutine[Any, Any, R]]],
    *args: Any,
    **kwargs: Any,
) -> R:
    """Run a coroutine function of the counterpart of an object in its thread."""
    owner, verb = bound
    return owner.thread.call(verb(owner.counterpart, *args, **kwargs))
