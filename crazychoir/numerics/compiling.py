"""The time at which laws are compiled.

It is the import of their modules, or later, after a program has checked the user's files. A first
run compiles for a minute or two. Errors in a swarm file, a graph or an option are reported before
that.
"""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from crazychoir.numerics.compile_helpers import LawName, LawNames, share_laws


class NotKept(Exception):
    """A law that may only be loaded is not kept on disk."""


class KernelQueue:
    """The laws that wait to be compiled, in the order of their import."""

    def __init__(self) -> None:
        self._is_waiting = False
        self._laws: list[_WaitingKernel] = []

    def compile_or_wait(self, dispatcher: Any, types: tuple[Any, ...]) -> None:
        """Compile a law for these types now; inside `checks_first`, later or at its first call."""
        law = _WaitingKernel(dispatcher, types)
        if self._is_waiting:
            law.wait()
            self._laws.append(law)
        else:
            law.compile()

    def count_waiting(self) -> int:
        """Return the number of laws that wait."""
        return len(self._laws)

    def compile(self, report: Callable[[], object] = lambda: None) -> None:
        """Compile all waiting laws. Laws imported from now on are compiled at once.

        Other processes help if many laws are not kept on disk.

        report: called after each law
        """
        self._is_waiting = False
        self.load_kept(report)
        laws = self._laws
        self._laws = []
        with share_laws([law.name for law in laws]) as next_law:
            while (number := next_law()) is not None:
                laws[number].compile()
                report()
        for law in laws:
            if not law.is_compiled:  # a helper has kept it on disk
                law.compile()
                report()

    def compile_shared(
        self, next_law: Callable[[], int | None], names: LawNames
    ) -> None:
        """Compile waiting laws as a helper of another process; the laws are kept on disk.

        next_law: returns the number of a law to compile, None at the end
        names: the laws that have these numbers
        """
        self._is_waiting = False
        laws = {law.name: law for law in self._laws}
        while (number := next_law()) is not None:
            if names[number] in laws:
                laws[names[number]].compile()

    def is_first_run(self) -> bool:
        """Return whether the first waiting law is not kept on disk: then most laws are not."""
        return bool(self._laws) and not self._laws[0].load_kept()

    def load_kept(self, report: Callable[[], object] = lambda: None) -> None:
        """Load the waiting laws that are compiled and kept on disk; the others go on waiting.

        report: called after each law that is loaded
        """
        missing = []
        for law in self._laws:
            if law.load_kept():
                report()
            else:
                missing.append(law)
        self._laws = missing

    @contextlib.contextmanager
    def checks_first(self) -> Iterator[None]:
        """Let the laws that are imported inside this context wait until `compile`.

        If the checks raise an error, these laws stay uncompiled until their first call.
        """
        self._is_waiting = True
        try:
            yield
        finally:
            self._is_waiting = False


class _WaitingKernel:
    """A law that is compiled once, for one choice of types."""

    def __init__(self, dispatcher: Any, types: tuple[Any, ...]) -> None:
        self._dispatcher = dispatcher
        self._types = types
        self._compile = dispatcher.compile
        self.is_compiled = False
        law = dispatcher.py_func
        self.name: LawName = (law.__module__, law.__qualname__)

    def compile(self) -> Any:
        """Compile the law if it is not compiled, and refuse to compile it for other types.

        Return its entry point.
        """
        dispatcher = self._dispatcher
        if not self.is_compiled:
            self.is_compiled = True
            dispatcher.compile = self._compile
            dispatcher.compile(self._types)
            dispatcher.disable_compile()
        return dispatcher.overloads[dispatcher.nopython_signatures[0].args].entry_point

    def load_kept(self) -> bool:
        """Load the law if it is kept on disk; return whether it is ready to be called."""
        try:
            with self._dispatcher._cache.reading_only():
                self.compile()
        except NotKept:
            self.is_compiled = False
            self.wait()
        return self.is_compiled

    def wait(self) -> None:
        """Compile the law at its first call, or when another compiled law needs it.

        It is compiled for its own types only.
        """
        self._dispatcher.compile = lambda types: self.compile()


KERNEL_QUEUE = KernelQueue()
"""The waiting laws of this process."""
