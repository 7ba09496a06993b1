"""When laws are compiled: as their modules are imported, or after a program has checked what its user wrote.

A first run compiles for a minute or two. What is wrong with a swarm file, a graph or an option is said before that.
"""

import contextlib
from collections.abc import Iterator
from typing import Any


class Later:
    """The laws that wait to be compiled, in the order in which they were imported."""

    def __init__(self) -> None:
        self._is_waiting = False
        self._laws: list[_Law] = []

    def compile_or_wait(self, dispatcher: Any, types: tuple[Any, ...]) -> None:
        """Compile a law for these types now; inside `checks_first` later, or when it is first called."""
        law = _Law(dispatcher, types)
        if self._is_waiting:
            law.wait()
            self._laws.append(law)
        else:
            law.compile()

    def compile(self) -> None:
        """Compile all laws that wait; from now on those that are imported do not."""
        self._is_waiting = False
        laws = self._laws
        self._laws = []
        for law in laws:
            law.compile()

    @contextlib.contextmanager
    def checks_first(self) -> Iterator[None]:
        """Let laws wait that are imported in here, until `compile`, or for good where the checks raise an error."""
        self._is_waiting = True
        try:
            yield
        finally:
            self._is_waiting = False


class _Law:
    """A law that is compiled once, for one choice of types."""

    def __init__(self, dispatcher: Any, types: tuple[Any, ...]) -> None:
        self._dispatcher = dispatcher
        self._types = types
        self._compile = dispatcher.compile
        self._is_compiled = False

    def compile(self) -> Any:
        """Compile it, if it is not, and let no other types be compiled."""
        dispatcher = self._dispatcher
        if not self._is_compiled:
            self._is_compiled = True
            dispatcher.compile = self._compile
            dispatcher.compile(self._types)
            dispatcher.disable_compile()
        return dispatcher.overloads[dispatcher.nopython_signatures[0].args].entry_point

    def wait(self) -> None:
        """Compile it when it is first called, or when a law that names it is compiled, for its own types alone."""
        self._dispatcher.compile = lambda types: self.compile()


LATER = Later()
"""Those of this process."""
