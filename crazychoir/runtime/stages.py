"""The stages of a tick: all drones of a process do the first thing, then all the second, and so on.

Poses come in frames, of all drones at once. Were each drone to go through its whole chain as soon as its pose is
there, the first one's law would hear of this tick from nobody and the last one's from everybody. So all see, then all
say where they are, all decide, all act. It is also faster: a hundred turns of the same few lines stay in the
processor's caches, a hundred turns of the whole chain do not.
"""

from collections.abc import Callable

from crazychoir.runtime.clock import Clock

SAY, DECIDE, ACT = range(3)
"""Publish the own state; let a law find a reference; send a command. Poses are seen before, as they come."""

Work = Callable[[], None]


class Stages:
    """What the drones of a process still have to do in this pass of the loop."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._stages: list[list[Work]] = [[], [], []]
        self._due = False

    def add(self, stage: int, work: Work) -> None:
        """Let `work` run in its stage, soon. It handles its own errors: one that escapes ends the stage for all."""
        self._stages[stage].append(work)
        if not self._due:
            self._due = True
            self.clock.soon(self.run)

    def run(self) -> None:
        """All that is to do, stage by stage; what a stage adds to later ones is done too, the rest in the next pass."""
        self._due = False
        for n in range(len(self._stages)):
            stage, self._stages[n] = self._stages[n], []
            for work in stage:
                work()
