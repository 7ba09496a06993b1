"""Signals of a process that owns something: it ends as soon as no drone needs it."""

import signal
from typing import Protocol

from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.runtime.worker_thread import add_signal_handler

REPEAT_TIME = 2.0
"""Seconds within which a signal counts as a repetition of the one before."""
SIGNAL_NAMES: dict[int, str] = {
    signal.SIGINT: "Ctrl-C (SIGINT)",
    signal.SIGTERM: "SIGTERM",
}
"""Names of the signals, for the log."""


class EndableProcess(Protocol):
    """A process that can be ended."""

    def end(self, reason: str) -> None:
        """End as soon as no drone needs it."""
        ...

    def abort(self, reason: str) -> None:
        """End now."""
        ...


def end_on_signals(clock: Clock, owner: EndableProcess) -> None:
    """End the owner as soon as no drone needs it; end it at once at a second signal within 2 s.

    SIGHUP never counts as the second signal.
    """
    times: list[int] = []

    def on_signal(number: int) -> None:
        again = number != signal.SIGHUP and any(
            t > clock.now_ns() - REPEAT_TIME * NS_PER_SECOND for t in times
        )
        if again:
            owner.abort("a second signal")
        else:
            owner.end(SIGNAL_NAMES.get(number, "SIGHUP"))
        if number != signal.SIGHUP:
            times.append(clock.now_ns())

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        add_signal_handler(number, on_signal, number)
