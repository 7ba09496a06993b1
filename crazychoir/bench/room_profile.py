"""The share of each room of the package in the processor time of a program."""

import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import crazychoir

CRAZYCHOIR_FOLDER = Path(crazychoir.__file__).parent
PROFILE_INTERVAL = 0.001  # s of processor time between two samples
PROFILED_ROOMS = (
    "bus",
    "runtime",
    "safety",
    "control",
    "filters",
    "guidance",
    "simulation",
    "mocap",
    "team",
    "config",
    "flight",
    "agent",
    "planning",
)
"""Rooms that are counted."""

Watch = Callable[[bool], None]
"""Starts the counting with True, and stops it with False."""


@contextmanager
def sample_rooms(seen: Counter[str]) -> Iterator[Watch]:
    """Count the room of the running code every PROFILE_INTERVAL s of processor time.

    Yields a function that starts the counting with True and stops it with False.
    """

    def sampled(number: int, frame: FrameType | None) -> None:
        seen[room_of(frame)] += 1

    def watch(on: bool) -> None:
        first = PROFILE_INTERVAL if on else 0.0
        signal.setitimer(signal.ITIMER_PROF, first, PROFILE_INTERVAL)

    before = signal.signal(signal.SIGPROF, sampled)
    try:
        yield watch
    finally:
        watch(False)
        signal.signal(signal.SIGPROF, before)


def compute_shares(seen: Counter[str]) -> dict[str, float]:
    """Return the share of each room, of asyncio and of other code, 0 to 1."""
    total = max(seen.total(), 1)
    return {
        room: round(seen[room] / total, 4)
        for room in (*PROFILED_ROOMS, "asyncio", "other")
    }


def room_of(frame: FrameType | None) -> str:
    """Return the room of the innermost frame that lies in a room; missions count for guidance."""
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        if (
            path.is_relative_to(CRAZYCHOIR_FOLDER)
            and len(parts := path.relative_to(CRAZYCHOIR_FOLDER).parts) > 1
        ):
            if parts[0] in PROFILED_ROOMS:
                return parts[0]
            return "guidance" if parts[0] == "agents" else "other"
        if path.parent.name == "asyncio":
            return "asyncio"
        frame = frame.f_back
    return "other"
