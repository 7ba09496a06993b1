"""The stages of a tick: all drones of a process do the first thing, then all the second, and so on.

Poses come in frames, of all drones at once. Were each drone to go through its whole chain as soon as its pose is
there, the first one's law would hear of this tick from nobody and the last one's from everybody. So all see, then all
say where they are, all decide, all act. It is also faster: a hundred turns of the same few lines stay in the
processor's caches, a hundred turns of the whole chain do not.
"""

from collections import deque
from collections.abc import Callable

from crazychoir.runtime.clock import Clock

SAY, DECIDE, ACT = range(3)
"""Publish the own state; let a law find a reference; send a command. Poses are seen before, as they come."""

Work = Callable[[], None]


class Stages:
    """What the drones of a process still have to do in this pass of the loop."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._stages: tuple[deque[Work], ...] = (deque(), deque(), deque())
        self._due = False

    def add(self, stage: int, work: Work) -> None:
        """Let `work` run in its stage, soon; it handles its own errors."""
        self._stages[stage].append(work)
        if not self._due:
            self._due = True
            self.clock.soon(self.run)

    def run(self) -> None:
        """All that is to do, stage by stage; what a stage adds to later ones is done too."""
        self._due = False
        for stage in self._stages:
            while stage:
                stage.popleft()()
