"""How a process that owns something obeys signals: it ends when nobody needs it any more."""

import signal
from typing import Protocol

from crazychoir.runtime.clock import SECOND, Clock
from crazychoir.runtime.worker_thread import add_signal_handler

AGAIN = 2.0
"""s within which signals count together."""
NAMES: dict[int, str] = {signal.SIGINT: "Ctrl-C (SIGINT)", signal.SIGTERM: "SIGTERM"}


class Owner(Protocol):
    """What can be ended."""

    def end(self, reason: str) -> None:
        """As soon as nobody needs it."""
        ...

    def abort(self, reason: str) -> None:
        """Now."""
        ...


def end_on_signals(clock: Clock, owner: Owner) -> None:
    """The first signal lets those land who fly; a second of an operator within 2 s ends it where it is."""
    times: list[int] = []

    def on_signal(number: int) -> None:
        again = number != signal.SIGHUP and any(
            t > clock.now_ns() - AGAIN * SECOND for t in times
        )
        if again:
            owner.abort("a second signal")
        else:
            owner.end(NAMES.get(number, "SIGHUP"))
        if number != signal.SIGHUP:
            times.append(clock.now_ns())

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        add_signal_handler(number, on_signal, number)
