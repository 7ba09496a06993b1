"""Interrupt user code that does not return: in virtual time, and in the hooks of a mission file.

The watchdog of real time (runtime/watchdog.py) does not run there.
"""

import contextlib
import logging
import threading
from collections.abc import Callable, Coroutine, Generator, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

from crazychoir.runtime.clock import Stopwatch
from crazychoir.runtime.watchdog import InterruptGuard, standing_place

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class UserCodeTimes:
    """How long the code of a user may run, and when a long computation is logged."""

    step_limit: float = 60.0
    """Seconds of real time for one step of a law."""
    mission_limit: float = 600.0
    """Seconds of real time for one turn of a mission: its code between two awaits."""
    hook_limit: float = 300.0
    """Seconds of real time for a hook of a mission file."""
    check_interval: float = 0.25
    """Seconds of real time between two checks."""
    first_report: float = 5.0
    """Seconds of real time after which a computation is logged.

    It is logged again each time they have doubled.
    """


USER_CODE_TIMES = UserCodeTimes()


log = logging.getLogger(__name__)


class GuardFactory(Protocol):
    """Frees the loop from user code that hangs: see `Watchdog.guard`."""

    def guard(self, actor: str, patient: bool = False) -> InterruptGuard:
        """Return a context in which code that does not return is interrupted by Hung.

        actor: name for reports
        patient: True for code that may take its time
        """
        ...


class HangWatch:
    """Frees the loop from user code that hangs in virtual time.

    No virtual time passes while code computes, so slow code harms no drone. Therefore the limits
    are longer than those of the watchdog in real time.
    """

    def __init__(self) -> None:
        self._guard = InterruptGuard(Stopwatch())
        self._thread = threading.get_ident()
        self._ending = threading.Event()

    def guard(self, actor: str, patient: bool = False) -> InterruptGuard:
        """Return a context in which code is interrupted by Hung after a limit of UserCodeTimes.

        actor: name for reports
        patient: True for `mission_limit`, False for `step_limit`
        """
        guard = self._guard
        guard.actor = actor
        guard.limit = (
            USER_CODE_TIMES.mission_limit if patient else USER_CODE_TIMES.step_limit
        )
        return guard

    def within(self, seconds: float, actor: str) -> InterruptGuard:
        """Return a context in which code is interrupted by Hung after so many seconds.

        seconds: s of real time
        actor: name for reports
        """
        self._guard.actor = actor
        self._guard.limit = seconds
        return self._guard

    @property
    def is_free(self) -> bool:
        """True if it watches this thread, and no code that it would have to interrupt."""
        return threading.get_ident() == self._thread and not self._guard.since_ns

    def __enter__(self) -> "HangWatch":
        threading.Thread(target=self._watch, name="hang watch", daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ending.set()

    def _watch(self) -> None:
        guard = self._guard
        since_ns = 0
        say_at = USER_CODE_TIMES.first_report
        while not self._ending.wait(USER_CODE_TIMES.check_interval):
            if guard.since_ns != since_ns:
                since_ns = guard.since_ns
                say_at = USER_CODE_TIMES.first_report
            if (seconds := guard.seconds()) >= say_at:
                say_at = 2.0 * seconds
                text = "%s has computed for %.0f s, in %s; it is given up after %g s"
                log.warning(
                    text,
                    guard.actor,
                    seconds,
                    standing_place(self._thread),
                    guard.limit,
                )
            guard.interrupt(self._thread)


_SHARED_WATCH: ContextVar[HangWatch | None] = ContextVar("shared_watch", default=None)
"""The watch that all hooks of a `share_watch` use."""


@contextlib.contextmanager
def share_watch() -> Iterator[None]:
    """Let one thread watch all hooks that are called inside this context.

    Use it where many hooks are called: to start a thread takes longer than most hooks.
    """
    with HangWatch() as watch:
        token = _SHARED_WATCH.set(watch)
        try:
            yield
        finally:
            _SHARED_WATCH.reset(token)


@contextlib.contextmanager
def limit_duration(seconds: float, name: str) -> Iterator[None]:
    """Interrupt the code in this context by Hung after so many seconds.

    Use it for the hooks of a mission file, which run before the first drone flies or after all have
    landed. A hook that is called inside another one has a watch of its own.

    seconds: s of real time
    name: name for reports
    """
    shared = _SHARED_WATCH.get()
    if shared is not None and shared.is_free:
        with shared.within(seconds, name):
            yield
    else:
        with HangWatch() as watch, watch.within(seconds, name):
            yield


class GuardedCoroutine(Generic[T]):
    """A coroutine that may not hang between two of its awaits: each turn runs under a guard.

    inner: the coroutine
    guards: gives the guard
    actor: name for reports
    patient: called before each turn; True if that turn may take its time
    """

    def __init__(
        self,
        inner: Coroutine[Any, Any, T],
        guards: GuardFactory,
        actor: str,
        patient: Callable[[], bool],
    ) -> None:
        self.inner = inner
        self.guards = guards
        self.actor = actor
        self.patient = patient

    def __await__(self) -> Generator[Any, Any, T]:
        turn = partial(self.inner.send, None)
        while True:
            try:
                with self.guards.guard(self.actor, self.patient()):
                    waits = turn()
            except StopIteration as end:
                result: T = end.value
                return result
            try:
                turn = partial(self.inner.send, (yield waits))
            except BaseException as error:  # noqa: BLE001 - the coroutine receives it
                turn = partial(self.inner.throw, error)
