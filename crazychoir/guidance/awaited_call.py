"""Coroutines of a mission that remember whether they were awaited.

A forgotten `await` is therefore reported.
"""

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


def awaited(
    function: Callable[P, Coroutine[Any, Any, R]],
) -> Callable[P, Coroutine[Any, Any, R]]:
    """Decorate a coroutine function of a guidance: remember its calls until they are awaited."""

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
    """Decorate the coroutine functions that a user's class defines itself.

    kind: the class.
    kept: names of functions that stay unchanged, because the runtime inspects them.
    """
    for name, value in list(vars(kind).items()):
        if inspect.iscoroutinefunction(value) and name not in kept:
            setattr(kind, name, awaited(value))


def forgotten(guidance: object) -> str:
    """Return which calls of a guidance were never awaited, and what to write.

    Empty if there are none.

    It ends these calls.
    """
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
