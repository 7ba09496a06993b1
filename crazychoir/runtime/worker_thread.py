"""An event loop beside the one that runs: a notebook's cell and a mission are inside a loop already.

A thread has one running loop at most. A function that runs a loop of its own to its end is therefore run in a worker
thread where the calling thread has a running loop; the caller waits for it, as for any function.
"""

import asyncio
import contextvars
import ctypes
import signal
import threading
from collections.abc import Callable, Coroutine
from typing import Any, Generic, TypeVar

C = TypeVar("C")
T = TypeVar("T")
LOOK_INTERVAL = 0.05
"""s between two looks of the waiting thread at what may interrupt it."""
GRACE_TIME = 1.0
"""s that a step of the worker gets to give its loop back, before it is interrupted where it computes."""
MAIN_THREAD = threading.main_thread()


def is_inside_loop() -> bool:
    """Return whether the calling thread has a running event loop."""
    return asyncio._get_running_loop() is not None


def add_signal_handler(
    number: signal.Signals, handler: Callable[..., object], *args: Any
) -> None:
    """Call `handler(*args)` in the running loop when this process receives a signal.

    Python lets the main thread alone handle signals. In another thread nothing is done: the thread that waits for the
    worker receives Ctrl-C, and cancels the worker's task.
    """
    if threading.current_thread() is MAIN_THREAD:
        asyncio.get_running_loop().add_signal_handler(number, handler, *args)


class Worker(Generic[C, T]):
    """A thread that runs `run(main)`, while the calling thread waits.

    The worker has the caller's context (contextvars), so that what it prints reaches the caller's cell.
    What interrupts the waiting thread (Ctrl-C, the interrupt of a kernel, Hung of a watchdog, or a cancellation of a
    task of its loop) cancels the worker's main task. A worker that does not return to its loop within GRACE_TIME, and
    any that is interrupted again, gets KeyboardInterrupt where it computes. The interruption is raised in the caller
    when the worker has ended.
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
        """Run `main` to its end; return its result, or raise its error."""
        context = contextvars.copy_context()
        thread = threading.Thread(
            target=context.run, args=(self._work, main), name="event loop", daemon=True
        )
        try:
            thread.start()
            self._wait()
        except (
            BaseException
        ):  # a KeyboardInterrupt too: the worker ends before its caller goes on
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
        """Wait for the end of the worker; raise KeyboardInterrupt if a task of the blocked loop is cancelled meanwhile.

        The blocked loop runs no task, so that a handler of Ctrl-C alone can cancel one: that of asyncio.run.
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
        if (
            loop is None or task is None
        ):  # it is about to begin, and looks at `_is_stopped` first
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
    """Return how often the tasks of a loop have been cancelled."""
    return sum(task.cancelling() for task in asyncio.all_tasks(loop))
