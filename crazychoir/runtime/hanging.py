"""User code that does not return, where no watchdog of real time runs: in virtual time, and in the hooks of a file."""

import contextlib
import threading
from collections.abc import Callable, Coroutine, Generator, Iterator
from functools import partial
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

from crazychoir.runtime.clock import Stopwatch
from crazychoir.runtime.watchdog import Guard

T = TypeVar("T")
STEP, MISSION, HOOK = 60.0, 600.0, 300.0
"""s of real time that a step of a law, a turn of a mission, and a hook of a mission file may take."""
LOOK = 0.25


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
        self._guard.actor, self._guard.limit = actor, MISSION if patient else STEP
        return self._guard

    def __enter__(self) -> "HangWatch":
        threading.Thread(target=self._watch, name="hang watch", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()

    def _watch(self) -> None:
        while not self._ending.wait(LOOK):
            self._guard.interrupt(self._thread)


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Code that gets Hung after so many s: of a hook, before anybody flies or after all have."""
    with HangWatch() as watch:
        watch._guard.limit = seconds
        with watch._guard:
            yield


class Guarded(Generic[T]):
    """A coroutine each turn of which runs under a guard: between two of its awaits it may not hang.

    patient: asked before each turn, whether that may take its time.
    """

    def __init__(
        self, inner: Coroutine[Any, Any, T], guards: Guards, actor: str, patient: Callable[[], bool]
    ) -> None:
        self.inner, self.guards, self.actor, self.patient = inner, guards, actor, patient

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
