"""What every source of motion capture is: something that hands over frames until it is told to stop."""

import logging
from collections.abc import Callable
from typing import Protocol

from crazychoir.mocap.frames import Frame
from crazychoir.runtime.throttle import Throttle

log = logging.getLogger(__name__)
SILENT = 2.0
"""s without a frame after which it is said."""

Take = Callable[[Frame, float], None]
"""Called with each frame, and its age in s as far as that is known."""
Say = Callable[[str], None]


class Source(Protocol):
    """Cameras, or what stands in for them.

    where: what the user calls it, as "vicon at 10.0.0.5";  live: whether what it sees is never exactly still, as what
    cameras measure;  state: how it is, in a word or two;  again: how often it was started again.
    """

    where: str
    live: bool
    state: str
    again: int

    async def run(self, take: Take) -> None:
        """Hand over each frame as it comes; a source that fails says so and tries again. It ends when it has no more.

        Nothing in it keeps the event loop.
        """
        ...


class Complaints:
    """Says what is wrong with a source, each thing at most once a second and ever more rarely."""

    def __init__(self, where: str, say: Say | None = None) -> None:
        self.where, self.say = where, say or (lambda text: log.warning("%s", text))
        self._throttle = Throttle()

    def __call__(self, now: float, topic: str, text: str) -> None:
        """Say the text, unless the same topic was said too recently."""
        if self._throttle.due(now, topic):
            self.say(f"{self.where}: {text}")
