"""A user's function as the runtime calls it.

Its errors name the file, the line and what is allowed.
"""

import inspect
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import (
    ConfigError,
    CrazyChoirError,
    Hung,
    error_text,
    refuse_exit,
)
from crazychoir.runtime.user_code_guard import USER_CODE_TIMES, limit_duration
from crazychoir.team.round import Round

README_ADVICE = 'See "Write your own mission" in agents/README.md.'
"""Advice for the user: the chapter about missions."""
CHAPTER_ADVICE = {
    "mission": README_ADVICE,
    "algorithm": 'See "A new distributed algorithm" in crazychoir/optimization/README.md.',
}
"""Advice for the user, by kind of file: the chapter that explains it."""


@dataclass(frozen=True)
class Hook:
    """A function of a user's file."""

    file: str
    """The file that defines it."""
    name: str
    """Its name."""
    function: Callable[..., Any]
    """The function."""
    arguments: tuple[str, ...]
    """Names of its arguments, passed by position."""
    returns: str
    """What it may return, in words."""
    kind: str = "mission"
    """"mission" or "algorithm"."""

    @property
    def call(self) -> str:
        """The call in words, such as "swarm(drones)"."""
        return f"{self.name}({', '.join(self.arguments)})"

    def check(self) -> None:
        """Raise ConfigError unless it is a plain function that takes these arguments."""
        require_signature(
            self.function,
            self.arguments,
            f"{self.kind} {self.file}",
            self.name,
            CHAPTER_ADVICE[self.kind],
        )

    def __call__(self, *values: Any) -> Any:
        """Call the function, and return its result.

        Raises ConfigError with file, line and hook if the function does not return in time, calls
        sys.exit, or raises any error that is not a CrazyChoirError.
        """
        try:
            with (
                limit_duration(
                    USER_CODE_TIMES.hook_limit, f"{self.kind} {self.file}: {self.call}"
                ),
                refuse_exit(f"{self.kind} {self.call}"),
            ):
                return self.function(*values)
        except Hung as error:
            raise self.wrong(
                f"no end within {USER_CODE_TIMES.hook_limit:g} s", self._line(error)
            ) from error
        except CrazyChoirError:
            raise
        except Exception as error:
            found = error_text(error)
            raise self.wrong(found, self._line(error)) from error

    def make_agent(self, i: int, *values: Any) -> Round:
        """Call the function with (i, *values), and return agent i of an algorithm.

        Raises ConfigError as a call, and if the result is no agent.
        """
        agent = self(i, *values)
        if not isinstance(agent, Round):
            parts = ("message", "step", "done")
            missing = ", ".join(name for name in parts if not hasattr(agent, name))
            raise self.wrong(f"{type(agent).__name__} for agent {i}, without {missing}")
        return agent

    def wrong(self, found: str, line: str = "") -> ConfigError:
        """Return the error for a hook that fails, or returns a value that is not allowed.

        found: what the hook returned, or how it failed
        line: ":line" of the user's file, or empty
        """
        return ConfigError(
            f"{self.kind} {self.file}{line}: {self.call}",
            found,
            self.returns,
            CHAPTER_ADVICE[self.kind],
        )

    def _line(self, error: Exception) -> str:
        """Return the line of the user's file in which the error was raised, as ":line"."""
        lines = [
            at.lineno
            for at in traceback.extract_tb(error.__traceback__)
            if at.filename == self.file
        ]
        return f":{lines[-1]}" if lines else ""


def require_signature(
    function: object,
    arguments: tuple[str, ...],
    where: str,
    name: str,
    chapter: str = README_ADVICE,
) -> None:
    """Raise ConfigError unless `function` is a plain function that takes `arguments` by position.

    where: the file or class, for the error.
    name: name of the function.
    chapter: advice for the user.
    """
    wanted = f"def {name}({', '.join(arguments)})"
    if not callable(function):
        raise ConfigError(
            f"{where}: {name}",
            f"{name} = {shorten_value_text(function)}",
            wanted,
            "Or give it another name.",
        )
    if is_coroutine_function(function):
        place, _, _ = locate_function(function).rpartition(" ")
        raise ConfigError(
            f"{place or where}: {name}",
            f"async {wanted}",
            wanted,
            f"Write `def {name}`, not `async def {name}`: it may not wait.",
        )
    signature = inspect.signature(function)
    try:
        signature.bind(*arguments)
    except TypeError:
        raise ConfigError(
            f"{where}: {name}", f"def {name}{signature}", wanted, chapter
        ) from None


def is_coroutine_function(function: Callable[..., Any]) -> bool:
    """Whether a user has written a function with `async def`; decorators do not hide it."""
    return inspect.iscoroutinefunction(inspect.unwrap(function))


def locate_function(function: Callable[..., Any]) -> str:
    """Return where a user's function is defined, as "file:line name".

    Its name alone if the file is not known.
    """
    plain = inspect.unwrap(getattr(function, "__func__", function))
    code = getattr(plain, "__code__", None)
    name = getattr(plain, "__qualname__", type(function).__qualname__)
    return name if code is None else f"{code.co_filename}:{code.co_firstlineno} {name}"


def shorten_value_text(value: object) -> str:
    """Return a value in a few words."""
    if value is None:
        return "None"
    return (
        f"ndarray {value.shape}"
        if isinstance(value, np.ndarray)
        else f"{type(value).__name__} {value!r:.60}"
    )
