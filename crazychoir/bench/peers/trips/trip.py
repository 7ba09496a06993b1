"""The parts that the programs of the round trips share: the bytes, and the drone that asks or answers."""

import asyncio
import statistics
import threading
import time
from collections.abc import Awaitable, Callable
from typing import Any

from crazychoir.bench.peers.peers import say, wait_for_go

TRIP_BYTES = bytes(64)
"""What goes there and back."""


class TripTimes:
    """The times of the round trips of a window, after a warm-up.

    spec: argument of the program, with `warm` and `seconds`
    """

    def __init__(self, spec: dict[str, Any]) -> None:
        now_ns = time.perf_counter_ns()
        self._begins_ns: int = now_ns + round(1e9 * spec["warm"])
        self._ends_ns: int = self._begins_ns + round(1e9 * spec["seconds"])
        self._times_ns: list[int] = []

    def add(self, began_ns: int) -> bool:
        """Add a round trip that is done now; return True until the window ends."""
        now_ns = time.perf_counter_ns()
        if began_ns >= self._begins_ns:
            self._times_ns.append(now_ns - began_ns)
        return now_ns < self._ends_ns

    def say(self) -> None:
        """Print the median and the 99th percentile, in us."""
        times = sorted(self._times_ns)
        p99 = times[len(times) * 99 // 100]
        say({"median_us": statistics.median(times) / 1e3, "p99_us": p99 / 1e3})


async def ask_for_window(
    spec: dict[str, Any], go_and_return: Callable[[], Awaitable[object]]
) -> None:
    """Make one round trip after the other for a window, print their times, and stay until killed.

    go_and_return: makes one round trip
    """
    times = TripTimes(spec)
    while True:
        began_ns = time.perf_counter_ns()
        await go_and_return()
        if not times.add(began_ns):
            break
    times.say()
    await asyncio.Event().wait()


async def run_drone(
    spec: dict[str, Any],
    go_and_return: Callable[[], Awaitable[object]],
    answer: Callable[[], Awaitable[object]],
) -> None:
    """Wait for go; then make round trips for a window, or answer, until killed.

    spec: argument of the program
    go_and_return: makes one round trip
    answer: receives a message, and sends it back
    """
    say({"ready": True})
    await asyncio.to_thread(wait_for_go)
    if is_asking(spec):
        await ask_for_window(spec, go_and_return)
    answer_later(spec)
    while True:
        await answer()


def answer_later(spec: dict[str, Any]) -> None:
    """Print an empty answer at the end of the window: the other drone measures."""
    timer = threading.Timer(spec["warm"] + spec["seconds"], say, ({},))
    timer.daemon = True
    timer.start()


def is_asking(spec: dict[str, Any]) -> bool:
    """Return whether the drone of this process asks, and does not answer."""
    return bool(spec["number"] == 0)
