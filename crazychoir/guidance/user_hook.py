"""A function that a user has written, as the runtime calls it: an error of it names file, line, what is allowed."""

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
    without_exit,
)
from crazychoir.runtime.user_code_guard import HOOK, limited

README = 'See "Write your own mission" in README.md.'
CHAPTERS = {
    "mission": README,
    "algorithm": 'See "A new distributed algorithm" in README.md.',
}
"""Of README.md, by the kind of the file."""


@dataclass(frozen=True)
class Hook:
    """A function of a mission file.

    file: where it is written;  arguments: as it is called, by position;  returns: what is allowed, in words;
    kind: "mission", or "algorithm".
    """

    file: str
    name: str
    function: Callable[..., Any]
    arguments: tuple[str, ...]
    returns: str
    kind: str = "mission"

    @property
    def call(self) -> str:
        """How it is called."""
        return f"{self.name}({', '.join(self.arguments)})"

    def check(self) -> None:
        """Raise ConfigError unless it is a plain function that takes its arguments."""
        require_signature(
            self.function,
            self.arguments,
            f"{self.kind} {self.file}",
            self.name,
            CHAPTERS[self.kind],
        )

    def __call__(self, *values: Any) -> Any:
        """Call it; an error that is no word of this package becomes one that names file, line and hook."""
        try:
            with (
                limited(HOOK, f"{self.kind} {self.file}: {self.call}"),
                without_exit(f"{self.kind} {self.call}"),
            ):
                return self.function(*values)
        except Hung as error:
            raise self.wrong(f"no end within {HOOK:g} s", self._line(error)) from error
        except CrazyChoirError:
            raise
        except Exception as error:
            found = error_text(error)
            raise self.wrong(found, self._line(error)) from error

    def wrong(self, found: str, line: str = "") -> ConfigError:
        """The error of a hook that did not return what is allowed."""
        return ConfigError(
            f"{self.kind} {self.file}{line}: {self.call}",
            found,
            self.returns,
            CHAPTERS[self.kind],
        )

    def _line(self, error: Exception) -> str:
        """Where in the user's file it happened."""
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
    chapter: str = README,
) -> None:
    """Raise ConfigError unless `function` is a plain function that can be called with `arguments`, by position."""
    wanted = f"def {name}({', '.join(arguments)})"
    if not callable(function):
        raise ConfigError(
            f"{where}: {name}",
            f"{name} = {shown(function)}",
            wanted,
            "Or give it another name.",
        )
    if is_coroutine_function(function):
        place, _, _ = place_of(function).rpartition(" ")
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


def place_of(function: Callable[..., Any]) -> str:
    """Return where a user's function is written, as "file:line name"; its name alone where that is not known."""
    plain = inspect.unwrap(getattr(function, "__func__", function))
    code = getattr(plain, "__code__", None)
    name = getattr(plain, "__qualname__", type(function).__qualname__)
    return name if code is None else f"{code.co_filename}:{code.co_firstlineno} {name}"


def shown(value: object) -> str:
    """What a value is, in a few words."""
    if value is None:
        return "None"
    return (
        f"ndarray {value.shape}"
        if isinstance(value, np.ndarray)
        else f"{type(value).__name__} {value!r:.60}"
    )
