"""Coroutines of a mission that remember whether they were awaited.

A forgotten `await` is therefore reported.
"""

import dis
import functools
import inspect
import sys
import weakref
from collections.abc import Callable, Coroutine, Generator
from types import TracebackType
from typing import Any, Generic, ParamSpec, TypeVar

from crazychoir.errors import exit_call

P = ParamSpec("P")
R = TypeVar("R")


IS_WATCHED = "_is_watched"
"""The attribute of functions that are decorated here."""
MOST_REMEMBERED_CALLS = 10
"""Places with forgotten calls that are remembered with their text; of others only their number is."""


class UnawaitedCalls:
    """The calls of one guidance that nothing has awaited.

    waiting: by their identity, the calls that still exist and may be awaited.
    dropped: "file:line" and the function's name of each call that the line which made it has thrown away.
    left: the calls that were kept, and thrown away later.
    more: how many were thrown away beyond MOST_REMEMBERED_CALLS places.
    """

    def __init__(self) -> None:
        self.waiting: dict[int, weakref.ref[GuidanceCall[Any]]] = {}
        self.dropped: dict[tuple[str, str], None] = {}
        self.left: dict[tuple[str, str], None] = {}
        self.more = 0

    def throw_away(self, call: tuple[str, str], line: str) -> None:
        """Remember a call that does not exist any more.

        call: its "file:line", and the name of the function.
        line: "file:line" that was executed when it was thrown away.
        """
        calls = self.dropped if line == call[0] else self.left
        if len(calls) < MOST_REMEMBERED_CALLS:
            calls[call] = None
        elif call not in calls:
            self.more += 1


class GuidanceCall(Coroutine[Any, Any, R], Generic[R]):
    """A call of a coroutine function of a guidance.

    Nothing happens before it is awaited or made a task.

    inner: the coroutine.
    name: name of the function, such as "take_off".
    place: where it is called, as "file:line".
    unawaited: the calls of this guidance that have not begun yet. This call leaves it when it
        begins.
    """

    def __init__(
        self,
        inner: Coroutine[Any, Any, R],
        name: str,
        place: str,
        unawaited: UnawaitedCalls,
    ) -> None:
        self.inner = inner
        self.name = name
        self.place = place
        self._unawaited = unawaited
        unawaited.waiting[id(self)] = weakref.ref(self)

    def __del__(self) -> None:
        """End a coroutine that never began, and remember where it was thrown away."""
        unawaited = getattr(self, "_unawaited", None)
        if unawaited is not None and unawaited.waiting.pop(id(self), None):
            at = sys._getframe(1)
            # An error that unwinds the same line leaves calls over, too: they were not dropped.
            operation = dis.opname[at.f_code.co_code[at.f_lasti]]
            is_dropped = operation == "POP_TOP" or operation.startswith("STORE_")
            line = f"{at.f_code.co_filename}:{at.f_lineno}" if is_dropped else ""
            unawaited.throw_away((self.place, self.name), line)
            self.inner.close()

    def _begin(self) -> Coroutine[Any, Any, R]:
        self._unawaited.waiting.pop(id(self), None)
        return self.inner

    def __await__(self) -> Generator[Any, Any, R]:
        return self._begin().__await__()

    def send(self, value: Any) -> Any:
        """Continue the coroutine, as a task does.

        SystemExit becomes a RuntimeError, because a task that raises SystemExit would end the
        process.
        """
        try:
            return self._begin().send(value)
        except SystemExit as end:
            text = f"self.{self.name}(...) called {exit_call(end)}"
            raise RuntimeError(text).with_traceback(end.__traceback__) from end

    def throw(
        self, kind: Any, value: Any = None, traceback: TracebackType | None = None
    ) -> Any:
        """Raise an exception in the coroutine, as a cancelled task does."""
        error = kind
        if not isinstance(kind, BaseException):
            error = kind() if value is None else kind(value)
        return self._begin().throw(error)

    def close(self) -> None:
        """End the coroutine on purpose."""
        self._begin().close()

    @property
    def cr_await(self) -> Any:
        """What the coroutine waits for."""
        return getattr(self.inner, "cr_await", None)

    @property
    def cr_frame(self) -> Any:
        """The frame of the coroutine."""
        return getattr(self.inner, "cr_frame", None)

    @property
    def cr_code(self) -> Any:
        """The code of the coroutine."""
        return getattr(self.inner, "cr_code", None)

    @property
    def cr_running(self) -> bool:
        """The coroutine runs now."""
        return bool(getattr(self.inner, "cr_running", False))

    def __repr__(self) -> str:
        return f"<call of {self.name} at {self.place}>"


def remember_calls(
    function: Callable[P, Coroutine[Any, Any, R]],
) -> Callable[P, Coroutine[Any, Any, R]]:
    """Decorate a coroutine function of a guidance: remember its calls until they are awaited."""
    own = function.__code__.co_varnames[0:1]

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> Coroutine[Any, Any, R]:
        caller = sys._getframe(1)
        guidance = args[0] if args else next((kwargs.get(name) for name in own), None)
        if not hasattr(guidance, "__dict__"):
            return function(*args, **kwargs)
        return find_call_from(
            caller.f_code.co_filename,
            caller.f_lineno,
            guidance,
            function,
            *args,
            **kwargs,
        )

    setattr(called, IS_WATCHED, True)
    return as_coroutine_function(called)


Function = TypeVar("Function", bound=Callable[..., Any])


def as_coroutine_function(function: Function) -> Function:
    """Let inspect.iscoroutinefunction see a coroutine function, in Python 3.12 or newer."""
    mark = getattr(inspect, "markcoroutinefunction", None)
    if mark is not None:
        mark(function)
    return function


def find_call_from(
    file: str,
    line: int,
    guidance: object,
    function: Callable[..., Coroutine[Any, Any, R]],
    *args: Any,
    **kwargs: Any,
) -> Coroutine[Any, Any, R]:
    """Return the call of a coroutine function, made in this line of this file for this guidance."""
    calls: UnawaitedCalls | None = guidance.__dict__.get("_unawaited")
    if calls is None:
        calls = guidance.__dict__["_unawaited"] = UnawaitedCalls()
    return GuidanceCall(
        function(*args, **kwargs), function.__name__, f"{file}:{line}", calls
    )


def watch_coroutines(kind: type, kept: frozenset[str]) -> None:
    """Decorate the coroutine functions that a user's class defines itself.

    kind: the class.
    kept: names of functions that stay unchanged, because the runtime inspects them.
    """
    for name, value in list(vars(kind).items()):
        is_watched = hasattr(value, IS_WATCHED) or name in kept
        if inspect.iscoroutinefunction(value) and not is_watched:
            setattr(kind, name, remember_calls(value))


def describe_forgotten_calls(guidance: object, has_ended_by_itself: bool) -> str:
    """Say which calls of a guidance nothing has awaited, and what to write; empty if there are none. They are ended.

    has_ended_by_itself: whether the mission has returned. If an error or a command has ended it, calls that it has kept
    are no mistake: it would have awaited them later. Calls that were dropped where they were made always are one.
    """
    calls: UnawaitedCalls | None = getattr(guidance, "__dict__", {}).get("_unawaited")
    if calls is None:
        return ""
    waiting = [call for made in calls.waiting.values() if (call := made()) is not None]
    found = list(calls.dropped)
    if has_ended_by_itself:
        found += [*calls.left, *((call.place, call.name) for call in waiting)]
    for call in waiting:
        call.close()
    texts = [
        f"{place}: self.{name}(...) was called without await, so it did nothing: "
        f"write `await self.{name}(...)`"
        for place, name in dict.fromkeys(found)
    ]
    more = calls.more + max(0, len(texts) - MOST_REMEMBERED_CALLS)
    if more and texts:
        texts[MOST_REMEMBERED_CALLS:] = [f"and {more} more calls without await"]
    return "; ".join(texts)
