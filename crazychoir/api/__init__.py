"""The Python interface of scripts and notebooks: fly, read, sweep, solve, simulate.

The names below are imported at their first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING

__all__: list[str] = []
"""The public names."""
_MODULE_OF: dict[str, str] = {}
"""Public name: the module that defines it, below this package."""

if not TYPE_CHECKING:  # hidden: a type checker would take every name for a public one

    def __getattr__(name: str) -> object:
        """Import a public name at its first use, and return it (PEP 562)."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = globals()[name] = getattr(
            import_module(f"{__name__}.{_MODULE_OF[name]}"), name
        )
        return value

    def __dir__() -> list[str]:
        return sorted([*globals(), *__all__])
