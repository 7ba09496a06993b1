"""Collect the frames of some seconds, for commands that evaluate them together."""

import asyncio
import contextlib
from dataclasses import dataclass

from crazychoir.errors import Refused
from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.source import FrameSource
from crazychoir.mocap.view import FrameFilter
from crazychoir.runtime.clock import Clock


@dataclass(frozen=True, slots=True)
class GatherTiming:
    """How long and how often `gather_frames` looks for the first frame."""

    first_frame_deadline: float = 10.0
    """s: time within which the first frame must arrive."""
    check_period: float = 0.02
    """s: time between two checks for the first frame."""


GATHER_TIMING = GatherTiming()


async def gather_frames(
    clock: Clock, source: FrameSource, view: FrameFilter, seconds: float
) -> list[PoseFrame]:
    """Return the frames of a source for some seconds after its first frame.

    Their times are those of the source.

    seconds: s
    Raises Refused if no frame arrives within `GATHER_TIMING.first_frame_deadline`, whatever the
    source does.
    """
    frames: list[PoseFrame] = []

    def take(frame: PoseFrame, age: float) -> None:
        seen = view.see(frame)
        if seen is not None:
            frames.append(seen[0])

    began = clock.now()
    running = asyncio.create_task(source.run(take))
    try:
        while not frames:
            if clock.now() - began > GATHER_TIMING.first_frame_deadline:
                dropped = (
                    f" {view.timeless} were dropped, because their time is not a number of s."
                    if view.timeless
                    else ""
                )
                raise Refused(
                    source.where,
                    f"no frame within {GATHER_TIMING.first_frame_deadline:g} s ({source.state}).{dropped}",
                )
            await clock.sleep(GATHER_TIMING.check_period)
        await clock.sleep(seconds)
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running
    return frames
