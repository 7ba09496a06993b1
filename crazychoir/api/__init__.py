"""The Python interface of scripts and notebooks: fly, read, sweep, solve, simulate.

The names below are imported at their first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from crazychoir.numerics.compiling import KERNEL_QUEUE

if TYPE_CHECKING:
    from crazychoir.api.connecting import connect, connect_async, launch
    from crazychoir.api.flights import Flight, fly, read
    from crazychoir.api.running.async_swarm import AsyncSwarm
    from crazychoir.api.running.receipts import OrderFailed
    from crazychoir.api.running.running_swarm import RunningSwarm
    from crazychoir.api.simulating import Simulation, simulate
    from crazychoir.api.solving import solve
    from crazychoir.api.sweeps import sweep
    from crazychoir.api.table import Table

__all__ = [
    "AsyncSwarm",
    "Flight",
    "OrderFailed",
    "RunningSwarm",
    "Simulation",
    "Table",
    "connect",
    "connect_async",
    "fly",
    "launch",
    "read",
    "simulate",
    "solve",
    "sweep",
]
"""The public names."""
_MODULE_OF = {
    **dict.fromkeys(("connect", "connect_async", "launch"), "connecting"),
    "AsyncSwarm": "running.async_swarm",
    "OrderFailed": "running.receipts",
    "RunningSwarm": "running.running_swarm",
    "Flight": "flights",
    "fly": "flights",
    "read": "flights",
    "Table": "table",
    "sweep": "sweeps",
    "Simulation": "simulating",
    "simulate": "simulating",
    "solve": "solving",
}
"""Public name: the module that defines it, below this package."""

if not TYPE_CHECKING:  # hidden: a type checker would take every name for a public one

    def __getattr__(name: str) -> object:
        """Import a public name at its first use, and return it (PEP 562)."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        # Laws are compiled when they are needed, after errors of the user are reported.
        with KERNEL_QUEUE.checks_first():
            module = import_module(f"{__name__}.{_MODULE_OF[name]}")
        value = globals()[name] = getattr(module, name)
        return value

    def __dir__() -> list[str]:
        return sorted([*globals(), *__all__])
