"""A thread that watches the event loop: who keeps it, where, for how long; and frees it from user code."""

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
from crazychoir.runtime.clock import SECOND, Clock, thread_seconds

log = logging.getLogger(__name__)
LATE = 0.100
"""s: a loop that is late by this is reported."""
HAND_OVER = 0.300
"""s: the owner of a radio hands its drones to the onboard landing."""
INTERRUPT = 1.000
"""s: user code that runs under `guard` is interrupted."""
PATIENT = 8.000
"""s: the same of code that may take its time, as a mission that plans on the ground; before the process gives up."""
GIVE_UP = 10.000
"""s: the process ends itself: its drones' own safety, and the other drones, must not wait for it."""
FROZEN = 0.500
"""s between two looks of the watchdog: then the whole process stood still (SIGSTOP), and the loop is not to blame."""
QUIET = 10.000
"""s in which short stalls, below HAND_OVER, of one actor, or of nobody, are said once."""
STUCK = 15.000
"""s without a turn of this thread, as foreign code keeps the interpreter's lock: the process is ended from C. So is one
that was stopped (SIGSTOP) for that long: the others have lost it by then."""
STDERR = 2
EXIT_CODE = 70
BEAT = 0.020


@dataclass(frozen=True)
class Stall:
    """One report: how late the loop is, which actor has it (empty: none), and where its code stands."""

    seconds: float
    actor: str
    place: str
    more: int = 0
    """Short ones of the same actor since the last report."""

    def __str__(self) -> str:
        more = f" ({self.more} more since it was said last)" if self.more else ""
        if self.actor:
            return f"{self.actor} keeps the event loop for {self.seconds:.2f} s, in {self.place}{more}"
        return f"the event loop was not served for {self.seconds:.2f} s (machine busy?), at {self.place}{more}"


class Watchdog:
    """Start it inside the running loop, in real time only; `on_stall` is called from its own thread.

    A stall is reported when it reaches LATE, HAND_OVER and INTERRUPT, and then whenever it has doubled; short ones of
    one actor, or of no task and no guarded code, once in QUIET s, with their number.
    soon: code under `guard` is interrupted when it has computed for HAND_OVER s: bodies elsewhere would fall, and other
    drones of the process would not be flown.
    stalls: how many there were;  worst: s, the longest.
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
        self.worst = 0.0
        self._loop = asyncio.get_running_loop()
        self._loop_thread = threading.get_ident()
        self._beat_ns = clock.now_ns()
        self._guard = Guard(clock)
        self._ending = threading.Event()
        self._report_at = LATE
        self._said: dict[
            str, tuple[int, int]
        ] = {}  # by actor: when, and how many short ones were not said since
        self._entered: tuple[int, float] = (
            0,
            0.0,
        )  # when guarded code began, and s of processor time by then
        self._thread = threading.Thread(
            target=self._watch, name="watchdog", daemon=True
        )

    def start(self) -> None:
        """Begin to watch."""
        self._beat()
        self._thread.start()

    def stop(self) -> None:
        """End the thread, and with it what would end a process that hangs."""
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def guard(self, actor: str, patient: bool = False) -> "Guard":
        """Code in `with watchdog.guard(actor):` is interrupted by `Hung` once it has kept the loop for a second.

        It may not await and not nest. Code that swallows Hung gets it again a second later.
        actor: who is named in a report;  patient: only after PATIENT s.
        """
        self._guard.actor = actor
        self._guard.limit = PATIENT if patient else INTERRUPT
        return self._guard

    def _beat(self) -> None:
        self._beat_ns = self.clock.now_ns()
        self._guard.since_ns = 0
        if not self._ending.is_set():
            self.clock.call_at(self._beat_ns + round(BEAT * SECOND), self._beat)

    def _watch(self) -> None:
        looked_ns = self.clock.now_ns()
        frozen = 0.0
        armed_ns = 0
        while not self._ending.wait(BEAT):
            now_ns = self.clock.now_ns()
            if now_ns - armed_ns > SECOND:
                armed_ns = now_ns
                faulthandler.dump_traceback_later(STUCK, exit=True, file=STDERR)
            late = (now_ns - self._beat_ns) / SECOND - BEAT
            if self.soon and late > BEAT:
                self._computed()
            looked_ns, gap = now_ns, (now_ns - looked_ns) / SECOND
            frozen = 0.0 if late < LATE else frozen + gap if gap > FROZEN else frozen
            self.worst = max(self.worst, late)
            if late < LATE:
                self._report_at = LATE
                continue
            if late >= self._report_at:
                self._report(late)
            if late - frozen >= INTERRUPT:
                self._guard.interrupt(self._loop_thread)
            elif (
                self.soon
                and late >= HAND_OVER
                and self._computed() >= HAND_OVER - 2.0 * BEAT
            ):
                self._guard.interrupt(self._loop_thread, HAND_OVER)
            if late - frozen >= GIVE_UP:
                self._give_up(late)
        faulthandler.cancel_dump_traceback_later()

    def _computed(self) -> float:
        """s of processor time that the guarded code has used since the watchdog saw it first: not those it waited."""
        since_ns = self._guard.since_ns
        used = thread_seconds(self._loop_thread)
        if since_ns != self._entered[0]:
            self._entered = since_ns, used
        return used - self._entered[1] if since_ns else 0.0

    def _give_up(self, late: float) -> None:
        """Nothing of ours can free a loop that hangs in foreign code."""
        log.critical(
            "the event loop hangs for %.0f s: this process ends itself. Where its threads are:",
            late,
        )
        faulthandler.dump_traceback(all_threads=True)
        logging.shutdown()
        os._exit(EXIT_CODE)

    def _report(self, late: float) -> None:
        begins = self._report_at == LATE
        self.stalls += begins
        self._report_at = next(
            (limit for limit in (HAND_OVER, INTERRUPT) if limit > late), 2.0 * late
        )
        task = asyncio.current_task(self._loop)
        actor = (
            self._guard.actor
            if self._guard.since_ns
            else task.get_name()
            if task
            else ""
        )
        now_ns = self.clock.now_ns()
        said_ns, more = self._said.get(actor, (None, 0))
        if (
            late < HAND_OVER
            and said_ns is not None
            and now_ns - said_ns < QUIET * SECOND
        ):
            self._said[actor] = said_ns, more + 1
            return
        self._said[actor] = now_ns, 0
        more -= bool(more) and not begins  # its own beginning
        stall = Stall(late, actor, standing(self._loop_thread), more)
        log.warning("%s", stall)
        try:
            self.on_stall(stall)
        except Exception:
            log.exception("watchdog: error in what hears of the stall")


def standing(thread: int) -> str:
    """Where the code of a thread stands: file, line, function."""
    frame = sys._current_frames().get(thread)
    stack = traceback.extract_stack(frame)[-1] if frame else None
    return f"{stack.filename}:{stack.lineno} {stack.name}" if stack else "unknown code"


class Guard:
    """A region of the loop's thread in which Hung may be raised, and nowhere else: see `Watchdog.guard`."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.actor = ""
        self.limit = INTERRUPT
        self.since_ns = 0
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        self.since_ns = self.clock.now_ns()

    def __exit__(self, *error: object) -> None:
        # An interruption that came before this lock is raised before the call returns; none comes after it.
        # One that strikes before the first line leaves `since_ns` as it is; the next beat of the loop clears it.
        with self._lock:
            self.since_ns = 0

    def seconds(self) -> float:
        """s for which code has been inside; 0 outside."""
        since_ns = self.since_ns
        return (self.clock.now_ns() - since_ns) / SECOND if since_ns else 0.0

    def interrupt(self, thread: int, sooner: float | None = None) -> None:
        """Raise Hung in that thread, if it has been inside for its limit; from another thread.

        sooner: s, instead of the limit of code that is not patient.
        """
        limit = self.limit if sooner is None or self.limit > INTERRUPT else sooner
        with self._lock:
            now_ns = self.clock.now_ns()
            if self.since_ns and now_ns - self.since_ns >= limit * SECOND:
                self.since_ns = now_ns
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    ctypes.c_ulong(thread), ctypes.py_object(Hung)
                )
