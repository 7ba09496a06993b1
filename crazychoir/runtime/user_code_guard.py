"""User code that does not return, where no watchdog of real time runs: in virtual time, and in the hooks of a file."""

import contextlib
import logging
import threading
from collections.abc import Callable, Coroutine, Generator, Iterator
from functools import partial
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

from crazychoir.runtime.clock import Stopwatch
from crazychoir.runtime.watchdog import Guard, standing

T = TypeVar("T")
STEP, MISSION, HOOK = 60.0, 600.0, 300.0
"""s of real time that a step of a law, a turn of a mission, and a hook of a mission file may take."""
LOOK = 0.25
SAID = 5.0
"""s of real time after which it is said that something computes; again when they have doubled."""
log = logging.getLogger(__name__)


class Guards(Protocol):
    """What frees the loop from user code that hangs: see `Watchdog.guard`."""

    def guard(self, actor: str, patient: bool = False) -> Guard:
        """Code in `with guards.guard(actor):` is interrupted by Hung when it does not return."""
        ...


class HangWatch:
    """The same in virtual time, where no time passes while code computes: it may take long, but not forever."""

    def __init__(self) -> None:
        self._guard = Guard(Stopwatch())
        self._thread = threading.get_ident()
        self._ending = threading.Event()

    def guard(self, actor: str, patient: bool = False) -> Guard:
        """Code in `with watch.guard(actor):` gets Hung after STEP s; if it is patient after MISSION s."""
        return self.within(MISSION if patient else STEP, actor)

    def within(self, seconds: float, actor: str) -> Guard:
        """Code in `with watch.within(seconds, actor):` gets Hung after so many s; actor: who is named meanwhile."""
        self._guard.actor = actor
        self._guard.limit = seconds
        return self._guard

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
        say_at = SAID
        while not self._ending.wait(LOOK):
            if guard.since_ns != since_ns:
                since_ns = guard.since_ns
                say_at = SAID
            if (seconds := guard.seconds()) >= say_at:
                say_at = 2.0 * seconds
                text = "%s has computed for %.0f s, in %s; it is given up after %g s"
                log.warning(
                    text, guard.actor, seconds, standing(self._thread), guard.limit
                )
            guard.interrupt(self._thread)


@contextlib.contextmanager
def limited(seconds: float, who: str) -> Iterator[None]:
    """Code that gets Hung after so many s: of a hook, before anybody flies or after all have."""
    with HangWatch() as watch, watch.within(seconds, who):
        yield


class Guarded(Generic[T]):
    """A coroutine each turn of which runs under a guard: between two of its awaits it may not hang.

    patient: asked before each turn, whether that may take its time.
    """

    def __init__(
        self,
        inner: Coroutine[Any, Any, T],
        guards: Guards,
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
            except BaseException as error:  # noqa: BLE001 - it is handed on to the coroutine
                turn = partial(self.inner.throw, error)
