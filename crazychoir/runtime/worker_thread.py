"""Run an event loop in a worker thread where a loop runs already, as in a notebook.

A thread has at most one running loop. If the calling thread has one, a function that runs a loop of
its own to the end runs in a worker thread; the caller waits for it, as for any function.
"""

import asyncio
import contextvars
import ctypes
import signal
import threading
from collections.abc import Callable, Coroutine
from typing import Any, Generic, TypeVar

C = TypeVar("C")
"""The clock that the worker passes to `main`."""
T = TypeVar("T")
"""The result of `main`."""
LOOK_INTERVAL = 0.05
"""Seconds between two checks of the waiting thread for an interruption."""
GRACE_TIME = 1.0
"""Seconds in which a step of the worker may return to its loop.

Then it is interrupted where it computes.
"""
MAIN_THREAD = threading.main_thread()
"""The thread in which Python handles signals."""


def is_inside_loop() -> bool:
    """Return whether the calling thread has a running event loop."""
    return asyncio._get_running_loop() is not None


def add_signal_handler(
    number: signal.Signals, handler: Callable[..., object], *args: Any
) -> None:
    """Call `handler(*args)` in the running loop when this process receives a signal.

    Python handles signals in the main thread only. In another thread this does nothing: the thread
    that waits for the worker receives Ctrl-C, and cancels the worker's task.
    """
    if threading.current_thread() is MAIN_THREAD:
        asyncio.get_running_loop().add_signal_handler(number, handler, *args)


class Worker(Generic[C, T]):
    """A thread that runs an event loop while the calling thread waits.

    The thread has the caller's context (contextvars), so that its prints appear in the caller's
    cell of a notebook.

    An interruption of the waiting thread cancels the worker's main task. It is Ctrl-C, the interrupt
    of a notebook's kernel, Hung from a watchdog, or the cancellation of a task of the waiting loop.
    If the worker does not return to its loop within GRACE_TIME, or a second interruption comes,
    KeyboardInterrupt is raised in the code that it executes. When the worker has ended, the
    interruption is raised in the caller.

    run: runs the coroutine `main(clock)` in a new loop, and returns its result
    """

    def __init__(
        self, run: Callable[[Callable[[C], Coroutine[Any, Any, T]]], T]
    ) -> None:
        self._run = run
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[T] | None = None
        self._is_stopped = False
        self._is_cancelled = threading.Event()
        self._has_ended = threading.Event()
        self._result: T
        self._error: BaseException | None = None

    def result(self, main: Callable[[C], Coroutine[Any, Any, T]]) -> T:
        """Run `main` to its end. Return its result, or raise its error."""
        context = contextvars.copy_context()
        thread = threading.Thread(
            target=context.run, args=(self._work, main), name="event loop", daemon=True
        )
        try:
            thread.start()
            self._wait()
        except BaseException:
            # KeyboardInterrupt too: the worker must end before its caller goes on.
            self._stop(thread)
            raise
        if self._error is not None:
            try:
                raise self._error
            finally:
                self._error = None  # no cycle of error, traceback, frame and worker
        return self._result

    def _work(self, main: Callable[[C], Coroutine[Any, Any, T]]) -> None:
        try:
            self._result = self._run(lambda clock: self._cancellable(main(clock)))
        except BaseException as error:  # noqa: BLE001 - the waiting thread raises it
            self._error = error
        finally:
            self._has_ended.set()

    async def _cancellable(self, inner: Coroutine[Any, Any, T]) -> T:
        self._task = asyncio.current_task()
        self._loop = asyncio.get_running_loop()
        if self._is_stopped:
            inner.close()
            raise asyncio.CancelledError
        return await inner

    def _wait(self) -> None:
        """Wait for the end of the worker.

        The calling loop is blocked and runs no task. Only the handler of Ctrl-C of asyncio.run can
        cancel one of its tasks.

        Raises KeyboardInterrupt if a task of the calling loop is cancelled meanwhile.
        """
        loop = asyncio.get_running_loop()
        cancellations = _cancellations(loop)
        while not self._has_ended.wait(LOOK_INTERVAL):
            if _cancellations(loop) > cancellations:
                raise KeyboardInterrupt

    def _stop(self, thread: threading.Thread) -> None:
        """Cancel the worker, and wait for its end."""
        self._is_stopped = True
        self._cancel()
        while thread.is_alive():
            try:
                if (
                    not self._has_ended.wait(GRACE_TIME)
                    and not self._is_cancelled.is_set()
                ):
                    self._throw(thread)
                thread.join(LOOK_INTERVAL)
            except KeyboardInterrupt:
                self._throw(thread)

    def _cancel(self) -> None:
        loop = self._loop
        task = self._task
        if loop is None or task is None:
            # The worker has not begun; it checks `_is_stopped` first.
            return

        def cancel_task() -> None:
            self._is_cancelled.set()
            task.cancel()

        try:
            loop.call_soon_threadsafe(cancel_task)
        except RuntimeError:  # the loop is closed: the worker has ended
            return

    def _throw(self, thread: threading.Thread) -> None:
        """Raise KeyboardInterrupt in the worker, at its next line of Python."""
        if thread.ident is not None and not self._has_ended.is_set():
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(thread.ident), ctypes.py_object(KeyboardInterrupt)
            )


def _cancellations(loop: asyncio.AbstractEventLoop) -> int:
    """Return how many times the tasks of a loop have been cancelled."""
    return sum(task.cancelling() for task in asyncio.all_tasks(loop))
