"""A thread that watches the event loop: it reports what blocks the loop, where and for how long.

It interrupts user code that blocks the loop, and ends the process if foreign code does.
"""

import asyncio
import ctypes
import faulthandler
import logging
import os
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass

from crazychoir.errors import Hung
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, thread_seconds

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class WatchdogTimes:
    """Delays of the event loop at which the watchdog acts, and how often it looks."""

    report_delay: float = 0.100
    """Seconds of delay from which a late loop is reported."""
    hand_over_delay: float = 0.300
    """Seconds of delay after which the owner of a radio hands its drones to the on-board landing.
    """
    interrupt_limit: float = 1.000
    """Seconds after which user code under `guard` is interrupted."""
    patient_limit: float = 8.000
    """Seconds after which patient code under `guard` is interrupted. An example is a mission that
    plans on the ground. It is less than give_up_delay: the code is interrupted before the
    process ends itself.
    """
    give_up_delay: float = 10.000
    """Seconds of delay after which the process ends itself.

    The drones' own safety functions, and the other drones, must not wait for it.
    """
    frozen_gap: float = 0.500
    """Seconds between two checks of the watchdog from which on it assumes that the whole process was
    stopped (SIGSTOP). Such a pause does not count as a delay of the loop.
    """
    quiet_time: float = 10.000
    """Seconds in which short stalls of one actor are logged once. A stall is short below
    hand_over_delay. Stalls without an actor count together as one actor.
    """
    stuck_time: float = 15.000
    """Seconds for which the watchdog's thread gets no turn, after which a timer in C ends the process.

    Foreign code then holds the interpreter's lock. A process that was stopped (SIGSTOP) for that long
    ends too: the other processes have lost it by then.
    """
    beat_interval: float = 0.020
    """Seconds between two beats of a loop that is not late, and between two checks of the watchdog.

    The first beat comes earlier, because beats are due together with the ticks of flight.
    """


WATCHDOG_TIMES = WatchdogTimes()


STDERR_DESCRIPTOR = 2
"""File descriptor of standard error."""
EXIT_CODE = 70
"""Exit code of a process that ends itself."""


@dataclass(frozen=True)
class Stall:
    """A report that the event loop is late."""

    seconds: float
    """s: delay of the loop."""
    actor: str
    """Actor that blocks the loop; empty if there is none."""
    place: str
    """File, line and function at which its code stands."""
    more: int = 0
    """Short stalls of the same actor since the last report."""

    def __str__(self) -> str:
        more = f" ({self.more} more since it was said last)" if self.more else ""
        if self.actor:
            return f"{self.actor} keeps the event loop for {self.seconds:.2f} s, in {self.place}{more}"
        return f"the event loop was not served for {self.seconds:.2f} s (machine busy?), at {self.place}{more}"


class Watchdog:
    """Watches the running loop from a thread of its own.

    Start it inside the loop, in real time only. A stall is reported when it reaches the delays of
    WATCHDOG_TIMES, and then each time it has doubled. Short stalls of one actor, or outside every
    task and guarded code, are reported once in WATCHDOG_TIMES.quiet_time, with their number.

    clock: the clock of the loop
    on_stall: called with each report, in the watchdog's thread
    soon: interrupt guarded code already after `hand_over_delay` of processor time. Otherwise bodies
        in the world of another process would fall, and the other drones of this process would get
        no commands.
    """

    def __init__(
        self,
        clock: Clock,
        on_stall: Callable[[Stall], None] = lambda stall: None,
        soon: bool = False,
    ) -> None:
        self.clock = clock
        self.on_stall = on_stall
        self.soon = soon
        self.stalls = 0
        """Stalls so far."""
        self.worst = 0.0
        """s: longest delay so far."""
        self._loop = asyncio.get_running_loop()
        self._loop_thread = threading.get_ident()
        self._beat_ns = clock.now_ns()
        self._guard = InterruptGuard(clock)
        self._ending = threading.Event()
        self._report_at = WATCHDOG_TIMES.report_delay
        # By actor: ns of its last report, and its short stalls since then that were not reported.
        self._said: dict[str, tuple[int, int]] = {}
        # ns at which guarded code began, and s of processor time of the loop's thread by then.
        self._entered: tuple[int, float] = (0, 0.0)
        self._thread = threading.Thread(
            target=self._watch, name="watchdog", daemon=True
        )

    def start(self) -> None:
        """Start to watch."""
        self._beat()
        self._thread.start()

    def stop(self) -> None:
        """End the thread, so that it no longer ends a process that hangs."""
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def guard(self, actor: str, patient: bool = False) -> "InterruptGuard":
        """Return a context in which Hung interrupts code that blocks the loop for too long.

        The code may not await, and guards may not nest. Code that swallows Hung gets it again as
        many seconds later.

        actor: name for reports
        patient: interrupt only after WATCHDOG_TIMES.patient_limit
        """
        self._guard.actor = actor
        self._guard.limit = (
            WATCHDOG_TIMES.patient_limit if patient else WATCHDOG_TIMES.interrupt_limit
        )
        return self._guard

    def _beat(self) -> None:
        self._beat_ns = self.clock.now_ns()
        self._guard.since_ns = 0
        if not self._ending.is_set():
            interval_ns = round(WATCHDOG_TIMES.beat_interval * NS_PER_SECOND)
            last_ns = self.clock.find_last_tick(interval_ns)
            self.clock.call_at(last_ns + interval_ns, self._beat)

    def _watch(self) -> None:
        looked_ns = self.clock.now_ns()
        frozen = 0.0
        armed_ns = 0
        while not self._ending.wait(WATCHDOG_TIMES.beat_interval):
            now_ns = self.clock.now_ns()
            if now_ns - armed_ns > NS_PER_SECOND:
                armed_ns = now_ns
                faulthandler.dump_traceback_later(
                    WATCHDOG_TIMES.stuck_time, exit=True, file=STDERR_DESCRIPTOR
                )
            late = (
                now_ns - self._beat_ns
            ) / NS_PER_SECOND - WATCHDOG_TIMES.beat_interval
            if self.soon and late > WATCHDOG_TIMES.beat_interval:
                self._computed()
            looked_ns, gap = now_ns, (now_ns - looked_ns) / NS_PER_SECOND
            self.worst = max(self.worst, late)
            if late < WATCHDOG_TIMES.report_delay:
                frozen = 0.0
                self._report_at = WATCHDOG_TIMES.report_delay
                continue
            if gap > WATCHDOG_TIMES.frozen_gap:
                frozen += gap
            if late >= self._report_at:
                self._report(late)
            if late - frozen >= WATCHDOG_TIMES.interrupt_limit:
                self._guard.interrupt(self._loop_thread)
            elif (
                self.soon
                and late >= WATCHDOG_TIMES.hand_over_delay
                and self._computed()
                >= WATCHDOG_TIMES.hand_over_delay - 2.0 * WATCHDOG_TIMES.beat_interval
            ):
                self._guard.interrupt(self._loop_thread, WATCHDOG_TIMES.hand_over_delay)
            if late - frozen >= WATCHDOG_TIMES.give_up_delay:
                self._give_up(late)
        faulthandler.cancel_dump_traceback_later()

    def _computed(self) -> float:
        """Return the processor time in s of the guarded code since the watchdog first saw it.

        Time in which the code waited does not count.
        """
        since_ns = self._guard.since_ns
        used = thread_seconds(self._loop_thread)
        if since_ns != self._entered[0]:
            self._entered = since_ns, used
        return used - self._entered[1] if since_ns else 0.0

    def _give_up(self, late: float) -> None:
        """End the process: Python cannot free a loop that hangs in foreign code."""
        log.critical(
            "the event loop hangs for %.0f s: this process ends itself. Where its threads are:",
            late,
        )
        faulthandler.dump_traceback(all_threads=True)
        logging.shutdown()
        os._exit(EXIT_CODE)

    def _report(self, late: float) -> None:
        begins = self._report_at == WATCHDOG_TIMES.report_delay
        self.stalls += begins
        self._report_at = next(
            (
                limit
                for limit in (
                    WATCHDOG_TIMES.hand_over_delay,
                    WATCHDOG_TIMES.interrupt_limit,
                )
                if limit > late
            ),
            2.0 * late,
        )
        task = asyncio.current_task(self._loop)
        actor = ""
        if self._guard.since_ns:
            actor = self._guard.actor
        elif task:
            actor = task.get_name()
        now_ns = self.clock.now_ns()
        said_ns, more = self._said.get(actor, (None, 0))
        if (
            late < WATCHDOG_TIMES.hand_over_delay
            and said_ns is not None
            and now_ns - said_ns < WATCHDOG_TIMES.quiet_time * NS_PER_SECOND
        ):
            self._said[actor] = said_ns, more + 1
            return
        self._said[actor] = now_ns, 0
        more -= bool(more) and not begins  # do not count this stall's own beginning
        stall = Stall(late, actor, standing_place(self._loop_thread), more)
        log.warning("%s", stall)
        try:
            self.on_stall(stall)
        except Exception:
            log.exception("watchdog: error in what hears of the stall")


def standing_place(thread: int) -> str:
    """Return the file, line and function at which the code of a thread stands."""
    frame = sys._current_frames().get(thread)
    stack = traceback.extract_stack(frame)[-1] if frame else None
    return f"{stack.filename}:{stack.lineno} {stack.name}" if stack else "unknown code"


class InterruptGuard:
    """A region of the loop's thread in which Hung may be raised, and nowhere else.

    See `Watchdog.guard`.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.actor = ""
        self.limit = WATCHDOG_TIMES.interrupt_limit
        self.since_ns = 0
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        self.since_ns = self.clock.now_ns()

    def __exit__(self, *error: object) -> None:
        # An interruption requested before this lock is taken is raised before this call returns;
        # none comes later.
        # If it is raised before the first line, `since_ns` stays set; the next beat of the loop
        # clears it.
        with self._lock:
            self.since_ns = 0

    def seconds(self) -> float:
        """Return for how many s code has been inside; 0 if none is."""
        since_ns = self.since_ns
        return (self.clock.now_ns() - since_ns) / NS_PER_SECOND if since_ns else 0.0

    def interrupt(self, thread: int, sooner: float | None = None) -> None:
        """Raise Hung in a thread if its code has been inside for its limit.

        Called from another thread.

        thread: identifier of the thread
        sooner: s, used instead of the limit unless the code is patient
        """
        limit = (
            self.limit
            if sooner is None or self.limit > WATCHDOG_TIMES.interrupt_limit
            else sooner
        )
        with self._lock:
            now_ns = self.clock.now_ns()
            if self.since_ns and now_ns - self.since_ns >= limit * NS_PER_SECOND:
                self.since_ns = now_ns
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    ctypes.c_ulong(thread), ctypes.py_object(Hung)
                )
