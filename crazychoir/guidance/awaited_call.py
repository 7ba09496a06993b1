"""The mission's coroutines, which remember whether they were awaited: a forgotten `await` is named, not lost."""

import functools
import inspect
import sys
from collections.abc import Callable, Coroutine, Generator
from types import TracebackType
from typing import Any, Generic, ParamSpec, TypeVar

from crazychoir.errors import exit_call

P = ParamSpec("P")
R = TypeVar("R")


class Call(Coroutine[Any, Any, R], Generic[R]):
    """A call of a coroutine function of a guidance: nothing happens before it is awaited, or made into a task.

    inner: the coroutine.
    name: of the function, such as "take_off".
    place: where it is called, as "file:line".
    unawaited: the calls of this guidance that nothing has awaited yet; this one leaves it when it begins.
    """

    def __init__(
        self,
        inner: Coroutine[Any, Any, R],
        name: str,
        place: str,
        unawaited: "dict[int, Call[Any]]",
    ) -> None:
        self.inner = inner
        self.name = name
        self.place = place
        self._unawaited = unawaited
        unawaited[id(self)] = self

    def _begin(self) -> Coroutine[Any, Any, R]:
        self._unawaited.pop(id(self), None)
        return self.inner

    def __await__(self) -> Generator[Any, Any, R]:
        return self._begin().__await__()

    def send(self, value: Any) -> Any:
        """Go on with the coroutine, as a task does: a task that calls sys.exit would end the process."""
        try:
            return self._begin().send(value)
        except SystemExit as end:
            text = f"self.{self.name}(...) called {exit_call(end)}"
            raise RuntimeError(text).with_traceback(end.__traceback__) from end

    def throw(
        self, kind: Any, value: Any = None, traceback: TracebackType | None = None
    ) -> Any:
        """Raise an exception in the coroutine, as a task does that is cancelled."""
        error = (
            kind
            if isinstance(kind, BaseException)
            else kind(*([] if value is None else [value]))
        )
        return self._begin().throw(error)

    def close(self) -> None:
        """End the coroutine on purpose."""
        self._begin().close()

    @property
    def cr_await(self) -> Any:
        """What it waits for, as of a coroutine."""
        return getattr(self.inner, "cr_await", None)

    @property
    def cr_frame(self) -> Any:
        """Where it stands, as of a coroutine."""
        return getattr(self.inner, "cr_frame", None)

    @property
    def cr_code(self) -> Any:
        """Its code, as of a coroutine."""
        return getattr(self.inner, "cr_code", None)

    @property
    def cr_running(self) -> bool:
        """Whether it runs now, as of a coroutine."""
        return bool(getattr(self.inner, "cr_running", False))

    def __repr__(self) -> str:
        return f"<call of {self.name} at {self.place}>"


def awaited(
    function: Callable[P, Coroutine[Any, Any, R]],
) -> Callable[P, Coroutine[Any, Any, R]]:
    """Decorate a coroutine function of a guidance: its calls are known until they are awaited."""

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> Coroutine[Any, Any, R]:
        caller = sys._getframe(1)
        return called_from(
            caller.f_code.co_filename,
            caller.f_lineno,
            args[0],
            function,
            *args,
            **kwargs,
        )

    return called


def called_from(
    file: str,
    line: int,
    guidance: object,
    function: Callable[..., Coroutine[Any, Any, R]],
    *args: Any,
    **kwargs: Any,
) -> Coroutine[Any, Any, R]:
    """Return the call of a coroutine function, made in this line of this file for this guidance."""
    calls: dict[int, Call[Any]] = guidance.__dict__.setdefault("_unawaited", {})
    return Call(function(*args, **kwargs), function.__name__, f"{file}:{line}", calls)


def watch_coroutines(kind: type, kept: frozenset[str]) -> None:
    """Decorate the coroutine functions that a class of a user defines itself.

    kept: names that stay as they are, as the runtime looks at them.
    """
    for name, value in list(vars(kind).items()):
        if inspect.iscoroutinefunction(value) and name not in kept:
            setattr(kind, name, awaited(value))


def forgotten(guidance: object) -> str:
    """Say which calls of a guidance nothing has awaited, and what to write; empty if there are none. They are ended."""
    calls: dict[int, Call[Any]] = getattr(guidance, "__dict__", {}).get(
        "_unawaited", {}
    )
    texts = [
        f"{call.place}: self.{call.name}(...) was called without await, so it did nothing: "
        f"write `await self.{call.name}(...)`"
        for call in calls.values()
    ]
    for call in list(calls.values()):
        call.close()
    return "; ".join(dict.fromkeys(texts))
