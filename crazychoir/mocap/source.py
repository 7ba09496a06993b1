"""The interface of every motion capture source: it delivers frames until it is cancelled."""

import logging
from collections.abc import Callable
from typing import Protocol

from crazychoir.mocap.frames import PoseFrame
from crazychoir.runtime.throttle import Throttle

log = logging.getLogger(__name__)
FRAME_TIMEOUT = 2.0
"""Seconds without a frame after which this is reported."""

TakeFrame = Callable[[PoseFrame, float], None]
"""Callback: called with each frame, and its age in s as far as it is known."""
ReportText = Callable[[str], None]
"""Callback that reports a text."""


class FrameSource(Protocol):
    """Cameras, or a replacement for them."""

    where: str
    """Name for the user, such as "vicon at 10.0.0.5"."""
    live: bool
    """True if its poses are measurements: the noise changes them even when a body stands still."""
    state: str
    """State, in a word or two."""
    again: int
    """Number of restarts."""

    async def run(self, take: TakeFrame) -> None:
        """Deliver each frame as it arrives, and return when there are no more.

        It must not block the event loop. A source that fails reports it and tries again.
        """
        ...


class SourceComplaints:
    """Reports problems of a source: each topic at most once a second, and more and more rarely.

    where: name of the source
    say: reports a text; None: to the log
    """

    def __init__(self, where: str, say: ReportText | None = None) -> None:
        self.where, self.say = where, say or (lambda text: log.warning("%s", text))
        self._throttle = Throttle()

    def __call__(self, now: float, topic: str, text: str) -> None:
        """Report the text, unless its topic was reported too recently."""
        if self._throttle.due(now, topic):
            self.say(f"{self.where}: {text}")
