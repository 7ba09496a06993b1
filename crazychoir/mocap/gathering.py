"""Collect the frames of some seconds, for commands that evaluate them together."""

import asyncio
import contextlib

from crazychoir.errors import Refused
from crazychoir.mocap.frames import Frame
from crazychoir.mocap.source import Source
from crazychoir.mocap.view import View
from crazychoir.runtime.clock import Clock

FIRST = 10.0
"""Seconds within which the first frame must arrive."""
LOOK = 0.02
"""Seconds between two checks for the first frame."""


async def gather(
    clock: Clock, source: Source, view: View, seconds: float
) -> list[Frame]:
    """Return the frames of a source for some seconds after its first frame.

    Their times are those of the source.

    seconds: s
    Raises Refused if no frame arrives within FIRST s, whatever the source does.
    """
    frames: list[Frame] = []

    def take(frame: Frame, age: float) -> None:
        seen = view.see(frame)
        if seen is not None:
            frames.append(seen[0])

    began = clock.now()
    running = asyncio.create_task(source.run(take))
    try:
        while not frames:
            if clock.now() - began > FIRST:
                dropped = (
                    f" {view.timeless} were dropped, whose time is no time in s."
                    if view.timeless
                    else ""
                )
                raise Refused(
                    source.where,
                    f"no frame within {FIRST:g} s ({source.state}).{dropped}",
                )
            await clock.sleep(LOOK)
        await clock.sleep(seconds)
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running
    return frames
