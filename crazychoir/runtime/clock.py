"""Time: a wall clock that ticks from a timerfd, and a virtual clock that jumps to the next event.

Both count integer nanoseconds, and keep one heap of alarms, ordered by (time, priority, drone,
sequence). This is the only file that reads the machine's clock.
"""

import asyncio
import contextlib
import ctypes
import datetime
import gc
import heapq
import os
import selectors
import sys
import time
from collections import deque
from collections.abc import Callable, Coroutine, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import Context, copy_context
from enum import IntEnum
from types import FrameType
from typing import Any, TypeVar

from crazychoir.errors import Deadlock, Livelock
from crazychoir.runtime.worker_thread import Worker, is_inside_loop

T = TypeVar("T")
NS_PER_SECOND = 1_000_000_000
"""Nanoseconds in a second."""
NS_PER_MS = 1_000_000
"""Nanoseconds in a millisecond."""
MS_PER_SECOND = 1000
"""Milliseconds in a second."""
LIVELOCK_PASSES = 100_000
"""Loop passes at one instant of virtual time that count as a livelock."""

SWITCH_INTERVAL = 0.0005
"""Seconds after which a computing thread gives up the interpreter.

The event loop does not wait longer.
"""


class AlarmPriority(IntEnum):
    """Order of the alarms of one instant: the lowest comes first."""

    WORLD = 0
    """The simulated world moves first."""
    TICK = 1
    """Ticks."""
    MESSAGE = 2
    """Messages."""
    TIMEOUT = 3
    """Timeouts come last."""


class Alarm:
    """A callback that waits to be called, on the heap of a clock or in its loop.

    It takes the place of asyncio's Handle, which takes twice as long to make.
    """

    __slots__ = ("_args", "_callback", "_cancelled", "_context")

    def __init__(
        self,
        callback: Callable[..., object],
        args: tuple[Any, ...],
        context: Context | None = None,
    ) -> None:
        self._callback = callback
        self._args = args
        self._context = copy_context() if context is None else context
        self._cancelled = False

    def cancel(self) -> None:
        """Do not call the callback, and forget it: the alarm stays on the heap until it is due."""
        self._cancelled = True
        self._callback = _do_nothing
        self._args = ()

    def cancelled(self) -> bool:
        """Return whether the alarm was cancelled."""
        return self._cancelled

    def __repr__(self) -> str:
        return f"<Alarm {self._callback!r}>"


def _do_nothing() -> None:
    """Take the place of a callback that was cancelled."""


def thread_seconds(thread: int) -> float:
    """Return the processor time in s that the thread with this identifier has used."""
    return time.clock_gettime(time.pthread_getcpuclockid(thread))


class Clock:
    """A clock of either kind: the heap of alarms, sleeping and ticking."""

    virtual = False
    """True in virtual time."""
    epoch_ns = 0
    """Nanoseconds from the start of 1970 to the instant at which `now_ns` was 0.

    It is 0 in virtual time.
    """

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, int, int, Alarm | asyncio.TimerHandle]] = []
        self._sequence = 0
        self._loop: asyncio.AbstractEventLoop

    def now_ns(self) -> int:
        """Return the nanoseconds since a fixed instant. The value never decreases."""
        raise NotImplementedError

    def now(self) -> float:
        """Return the seconds since the same fixed instant."""
        return self.now_ns() / NS_PER_SECOND

    def call_at(
        self,
        when_ns: int,
        callback: Callable[..., object],
        *args: Any,
        priority: int = AlarmPriority.TICK,
        drone: int = -1,
    ) -> Alarm:
        """Call `callback(*args)` at `when_ns`; the returned alarm can be cancelled."""
        alarm = Alarm(callback, args)
        self.push(when_ns, alarm, priority, drone)
        return alarm

    def call_about(
        self, when_ns: int, callback: Callable[[], object], drone: int = -1
    ) -> Alarm | asyncio.TimerHandle:
        """Do the same as `call_at`; in real time the call may be 2 ms late, and costs much less."""
        return self.call_at(when_ns, callback, drone=drone)

    def find_last_tick(self, period_ns: int) -> int:
        """Return the time of the last aligned tick, ns: not after now, and less than a period ago.

        period_ns: ns, of the ticks
        """
        return self.now_ns()

    def future(self) -> "asyncio.Future[None]":
        """Return a future of this clock's loop."""
        return asyncio.Future(loop=self._loop)

    def soon(self, callback: Callable[[], object]) -> None:
        """Call the callback in the next pass of the loop."""
        self._loop.call_soon(callback)

    def push(
        self,
        when_ns: int,
        alarm: Alarm | asyncio.TimerHandle,
        priority: int,
        drone: int,
    ) -> None:
        """Put an alarm on the heap."""
        self._sequence += 1
        heapq.heappush(self._heap, (when_ns, priority, drone, self._sequence, alarm))
        self._arm()

    async def sleep_until(
        self, when_ns: int, priority: int = AlarmPriority.TICK, drone: int = -1
    ) -> None:
        """Wait until `when_ns`."""
        await ClockWait(self, when_ns, priority, drone)

    async def sleep(self, seconds: float, drone: int = -1) -> None:
        """Wait for so many seconds."""
        due_ns = self.now_ns() + round(seconds * NS_PER_SECOND)
        await ClockWait(self, due_ns, AlarmPriority.TICK, drone)

    def ticks(
        self,
        hz: float,
        priority: int = AlarmPriority.TICK,
        drone: int = -1,
        aligned: bool = False,
    ) -> "Ticks":
        """Return an absolute schedule of `hz` ticks a second, for `async for`.

        aligned: True to begin at the last aligned tick, False to begin now. In real time the aligned
            ticks of a process are due together, if one period is a multiple of the other in whole ns.
            Together they wake it once. Ticks that send by radio are better spread.
        """
        return Ticks(self, hz, priority, drone, aligned)

    async def compute(self, function: Callable[..., T], *args: Any) -> T:
        """Run a slow function outside the event loop, and return its result."""
        raise NotImplementedError

    def _arm(self) -> None:
        """Make sure that the loop notices the earliest alarm."""

    def _run_alarm(self, alarm: Any) -> None:
        """Call the callback of an alarm or a handle; its error is reported, as asyncio does."""
        try:
            alarm._context.run(alarm._callback, *alarm._args)
        except (SystemExit, KeyboardInterrupt):
            raise
        except BaseException as error:  # noqa: BLE001 - the loop goes on, as asyncio's does
            message = f"Exception in callback {alarm._callback!r}"
            self._loop.call_exception_handler(
                {"message": message, "exception": error, "handle": alarm}
            )


Main = Callable[[Clock], Coroutine[Any, Any, T]]
"""The coroutine function that a clock's loop runs."""


def wake_waiter(waiter: "asyncio.Future[None]") -> None:
    """Resolve a waiter, unless it is resolved or cancelled already."""
    if not waiter.done():
        waiter.set_result(None)


class ClockWait:
    """A wait for one instant of a clock.

    A task awaits this object itself, by the protocol of asyncio's futures: the alarm runs the
    waiting task at once, without a future and a loop pass for each wait. One task at a time may
    await it.
    """

    _asyncio_future_blocking = False

    def __init__(self, clock: Clock, due_ns: int, priority: int, drone: int) -> None:
        self.clock = clock
        self.due_ns = due_ns
        """ns: the instant."""
        self.priority = priority
        self.drone = drone
        self._cancelled = False
        self._message: Any = None

    def __await__(self) -> Generator["ClockWait", None, int]:
        self._asyncio_future_blocking = True
        self._cancelled = False
        try:
            yield self
        finally:
            # The alarm knows this object: without it the task can be freed at once.
            del self._alarm
        return self.due_ns

    # The protocol of a future: asyncio's Task calls these.

    def get_loop(self) -> asyncio.AbstractEventLoop:
        """Return the loop of the clock."""
        return self.clock._loop

    def add_done_callback(
        self,
        wakeup: Callable[["ClockWait"], object],
        *,
        context: Context | None = None,
    ) -> None:
        """Set an alarm that wakes the waiting task."""
        self._alarm = Alarm(wakeup, (self,), context)
        self.clock.push(self.due_ns, self._alarm, self.priority, self.drone)

    def cancel(self, msg: Any = None) -> bool:
        """Cancel the wait: the waiting task wakes up in the next pass of the loop."""
        if self._cancelled:
            return False
        self._cancelled = True
        self._message = msg
        wakeup = self._alarm._callback
        context = self._alarm._context
        self._alarm.cancel()
        self.clock._loop.call_soon(wakeup, self, context=context)
        return True

    def result(self) -> None:
        """Return None to the task that wakes up; raise CancelledError if the wait was cancelled."""
        if self._cancelled:
            raise asyncio.CancelledError(*filter(None, [self._message]))


class Ticks(ClockWait):
    """Ticks at k / hz s from a start, for `async for`: each is the due time in ns.

    A tick that is missed is counted in `missed` and never made up for.
    """

    def __init__(
        self, clock: Clock, hz: float, priority: int, drone: int, aligned: bool
    ) -> None:
        self.period_ns = round(NS_PER_SECOND / hz)
        start_ns = clock.find_last_tick(self.period_ns) if aligned else clock.now_ns()
        super().__init__(clock, start_ns, priority, drone)
        self.missed = 0
        """Ticks that were skipped."""

    def __aiter__(self) -> "Ticks":
        return self

    def __anext__(self) -> "Ticks":
        """Wait for the next tick; its value is the due time in ns."""
        self.due_ns += self.period_ns
        self.skip()
        return self

    def skip(self) -> None:
        """Go on to the newest tick that is due, and count the ticks before it as missed."""
        behind = (self.clock.now_ns() - self.due_ns) // self.period_ns
        if behind > 0:
            self.missed += behind
            self.due_ns += behind * self.period_ns


class Stopwatch(Clock):
    """Real time for code that only reads the time, with or without a loop."""

    now_ns = staticmethod(time.monotonic_ns)


def date_and_time() -> datetime.datetime:
    """Return the date and time of day of this host, in UTC.

    Use it for things that expire on a date, never for anything in flight.
    """
    return datetime.datetime.now(datetime.UTC)


class WallClock(Clock):
    """Real time from CLOCK_MONOTONIC, with one timerfd per process in the event loop (Linux)."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._loop = loop
        self.future = loop.create_future  # type: ignore[method-assign]
        self._fd = Timerfd()
        self._start_ns = time.monotonic_ns()
        self.epoch_ns = time.time_ns() - self._start_ns
        self._armed_ns = 0
        # One processor stays free for the event loop.
        spare = max(1, min(4, (os.cpu_count() or 1) - 1))
        self._pool = ThreadPoolExecutor(max_workers=spare, thread_name_prefix="compute")
        loop.add_reader(self._fd.fileno, self._fire)

    # Without a Python frame of its own: it is called very often.
    now_ns = staticmethod(time.monotonic_ns)

    def call_about(
        self, when_ns: int, callback: Callable[[], object], drone: int = -1
    ) -> Alarm | asyncio.TimerHandle:
        """Let the event loop call, without the timer: to set that is expensive."""
        # The loop counts whole ms, from a time that may be a ms ago.
        wait_ms = 1 - (time.monotonic_ns() - when_ns) // NS_PER_MS
        return self._loop.call_later(max(0, wait_ms) / MS_PER_SECOND, callback)

    def find_last_tick(self, period_ns: int) -> int:
        """Return the last time up to now that is whole periods after the creation of this clock, ns."""
        now_ns = time.monotonic_ns()
        return now_ns - (now_ns - self._start_ns) % period_ns

    async def compute(self, function: Callable[..., T], *args: Any) -> T:
        """Run the function in a thread: HiGHS and compiled kernels release the interpreter."""
        return await self._loop.run_in_executor(self._pool, function, *args)

    def close(self) -> None:
        """Release the timer and the threads."""
        self._loop.remove_reader(self._fd.fileno)
        self._fd.close()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _arm(self) -> None:
        first = self._heap[0][0]
        if not self._armed_ns or first < self._armed_ns:
            self._armed_ns = first
            self._fd.set(first)

    def _fire(self) -> None:
        now = time.monotonic_ns()
        self._armed_ns = 1  # new alarms do not arm the timer: the last lines do
        due = deque[tuple[int, int, int, int, Alarm | asyncio.TimerHandle]]()
        while self._heap and self._heap[0][0] <= now:
            due.append(heapq.heappop(self._heap))
        # Alarms that these add for now or earlier run next time, so that other tasks run in
        # between.
        try:
            while due:
                alarm = due.popleft()[-1]
                if not alarm.cancelled():
                    self._run_alarm(alarm)
        finally:
            # After SystemExit or KeyboardInterrupt the others run next time.
            for entry in due:
                heapq.heappush(self._heap, entry)
            self._armed_ns = self._heap[0][0] if self._heap else 0
            self._fd.set(self._armed_ns)


class Timerfd:
    """The kernel's timer as a file descriptor. The `os` module has it only from Python 3.13."""

    _CLOCK_MONOTONIC = 1
    _NONBLOCK = 0o4000
    _CLOEXEC = 0o2000000
    _ABSTIME = 1

    class _Spec(ctypes.Structure):
        _fields_ = [
            (name, ctypes.c_long)
            for name in ("interval_s", "interval_ns", "value_s", "value_ns")
        ]

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self.fileno = self._libc.timerfd_create(
            self._CLOCK_MONOTONIC, self._NONBLOCK | self._CLOEXEC
        )
        if self.fileno < 0:
            raise OSError(
                ctypes.get_errno(),
                "timerfd_create failed: real time needs Linux; use virtual time (--fast)",
            )
        self._spec = self._Spec()
        self._arguments = (self.fileno, self._ABSTIME, ctypes.byref(self._spec), None)

    def set(self, when_ns: int) -> None:
        """Fire at this instant of CLOCK_MONOTONIC, or at once if it has passed; 0: never.

        The descriptor is not readable until then.
        """
        self._spec.value_s, self._spec.value_ns = divmod(when_ns, NS_PER_SECOND)
        self._libc.timerfd_settime(*self._arguments)

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self.fileno)


class VirtualClock(Clock):
    """Virtual time: it stands still while any task can run, then jumps to the next alarm."""

    virtual = True

    def __init__(self) -> None:
        super().__init__()
        self._now_ns = 0
        self._passes = 0
        self._loop: VirtualLoop = VirtualLoop(self)

    @property
    def loop(self) -> "VirtualLoop":
        """The event loop that runs in this time."""
        return self._loop

    def now_ns(self) -> int:
        """Return the virtual nanoseconds since the loop was created."""
        return self._now_ns

    async def compute(self, function: Callable[..., T], *args: Any) -> T:
        """Run the function at once: it takes no virtual time."""
        return function(*args)

    def count_pass(self) -> None:
        """Count one loop pass, or one alarm, without progress of time.

        Raises Livelock after LIVELOCK_PASSES of them at one instant.
        """
        self._passes += 1
        if self._passes > LIVELOCK_PASSES:
            raise Livelock(
                f"{LIVELOCK_PASSES} loop passes at {self.now():.9f} s of virtual time. "
                f"A task runs for ever without waiting on the clock. {describe_tasks(self._loop)}"
            )

    def run_next_alarm(self) -> None:
        """Jump to the next alarm that is not cancelled, and run it.

        Raises Deadlock if there is none.
        """
        heap = self._heap
        while heap:
            when_ns, _, _, _, alarm = heapq.heappop(heap)
            if not alarm._cancelled:
                break
        else:
            raise Deadlock(
                f"at {self.now():.9f} s of virtual time no task can continue. {describe_tasks(self._loop)}"
            )
        if when_ns > self._now_ns:
            self._now_ns = when_ns
            self._passes = 0
        else:
            self.count_pass()
        self._run_alarm(alarm)


class VirtualLoop(asyncio.SelectorEventLoop):
    """asyncio's loop, but where asyncio would wait for a selector it advances the virtual clock."""

    _ready: deque[Any]
    _stopping: bool

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        super().__init__(_Selector())

    def time(self) -> float:
        """Return the virtual time in s."""
        return self._clock.now_ns() / NS_PER_SECOND

    def call_soon(  # type: ignore[override]
        self,
        callback: Callable[..., object],
        *args: Any,
        context: Context | None = None,
    ) -> Alarm:
        """Do the same as asyncio's `call_soon`, without its checks."""
        handle = Alarm(callback, args, context)
        self._ready.append(handle)
        return handle

    def _run_once(self) -> None:
        """Run callbacks until the loop is to stop; whenever none is ready, run the next alarm."""
        ready = self._ready
        clock = self._clock
        while True:
            if ready or self._stopping:
                clock.count_pass()
                for _ in range(len(ready)):
                    handle = ready.popleft()
                    if not handle._cancelled:
                        clock._run_alarm(handle)
                if self._stopping:
                    return
            else:
                clock.run_next_alarm()
                if self._stopping:
                    return

    def call_at(  # type: ignore[override]
        self,
        when: float,
        callback: Callable[..., object],
        *args: Any,
        context: Any = None,
    ) -> asyncio.TimerHandle:
        """Put a timer of asyncio itself (a timeout) on the clock's heap."""
        alarm = asyncio.TimerHandle(when, callback, args, self, context)
        self._clock.push(
            max(round(when * NS_PER_SECOND), self._clock.now_ns()),
            alarm,
            AlarmPriority.TIMEOUT,
            -1,
        )
        return alarm

    def call_later(  # type: ignore[override]
        self,
        delay: float,
        callback: Callable[..., object],
        *args: Any,
        context: Any = None,
    ) -> asyncio.TimerHandle:
        """Do the same as `call_at`, with a delay in s from now."""
        return self.call_at(self.time() + delay, callback, *args, context=context)

    def run_in_executor(  # type: ignore[override]
        self, executor: Any, func: Callable[..., T], *args: Any
    ) -> "asyncio.Future[T]":
        """Run the function at once, in this thread."""
        future: asyncio.Future[T] = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:  # noqa: BLE001 - the awaiting task raises it
            future.set_exception(error)
        return future


class _Selector(selectors.BaseSelector):
    """A selector that only registers the loop's own pipe; `select` never finds an event."""

    def __init__(self) -> None:
        self._keys: dict[Any, selectors.SelectorKey] = {}

    def register(
        self, fileobj: Any, events: int, data: Any = None
    ) -> selectors.SelectorKey:
        key = selectors.SelectorKey(
            fileobj,
            fileobj if isinstance(fileobj, int) else fileobj.fileno(),
            events,
            data,
        )
        self._keys[fileobj] = key
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return self._keys.pop(fileobj)

    def select(
        self, timeout: float | None = None
    ) -> list[tuple[selectors.SelectorKey, int]]:
        return []

    def get_map(self) -> Any:
        return self._keys


def describe_tasks(loop: asyncio.AbstractEventLoop) -> str:
    """Return a text that names every task and the line at which it waits."""
    tasks = sorted(asyncio.all_tasks(loop), key=lambda task: task.get_name())
    return "; ".join(
        f"{task.get_name()} waits in {_waiting_line(task)}" for task in tasks
    )


def _waiting_line(task: "asyncio.Task[Any]") -> str:
    coroutine: Any = task.get_coro()
    while getattr(coroutine, "cr_await", None) is not None and hasattr(
        coroutine.cr_await, "cr_frame"
    ):
        coroutine = coroutine.cr_await
    frame: FrameType | None = getattr(coroutine, "cr_frame", None)
    if frame is None:
        return "nothing"
    owner = getattr(frame.f_locals.get("self"), "name", "")
    code = frame.f_code
    where = f"{os.path.basename(code.co_filename)}:{frame.f_lineno} {code.co_qualname}"
    return f"{where} ({owner})" if owner else where


def run_virtual(main: Main[T]) -> T:
    """Run `main(clock)` to its end in virtual time.

    If a loop runs already, as in a notebook, `main` runs in a worker thread.
    """
    return (
        Worker[Clock, T](_run_virtual).result(main)
        if is_inside_loop()
        else _run_virtual(main)
    )


def run_wall(main: Main[T]) -> T:
    """Run `main(clock)` to its end in real time, on uvloop, inside `without_pauses`.

    If a loop runs already, as in a notebook, `main` runs in a worker thread.
    """
    return (
        Worker[Clock, T](_run_wall).result(main)
        if is_inside_loop()
        else _run_wall(main)
    )


def _run_virtual(main: Main[T]) -> T:
    clock = VirtualClock()
    with asyncio.Runner(loop_factory=lambda: clock.loop) as runner:
        return runner.run(main(clock))


def _run_wall(main: Main[T]) -> T:
    import uvloop

    async def with_clock() -> T:
        clock = WallClock(asyncio.get_running_loop())
        try:
            return await main(clock)
        finally:
            clock.close()

    with without_pauses(), asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        return runner.run(with_clock())


@contextlib.contextmanager
def without_pauses() -> Iterator[None]:
    """Avoid pauses by other threads and by the garbage collector inside this context.

    Threads give up the interpreter after SWITCH_INTERVAL. The garbage collector ignores what is
    loaded now: a full collection over the imported packages takes 45 ms, in which no tick runs.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)
