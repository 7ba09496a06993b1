"""The stages of a tick: all drones of a process do the first thing, then all the second, and so on.

Poses come in frames, of all drones at once. Were each drone to go through its whole chain as soon as its pose is
there, the first one's law would hear of this tick from nobody and the last one's from everybody. So all see, then all
say where they are, all decide, all act. It is also faster: a hundred turns of the same few lines stay in the
processor's caches, a hundred turns of the whole chain do not.
"""

from collections.abc import Callable

from crazychoir.runtime.clock import Clock

Work = Callable[[], None]


class Stages:
    """What the drones of a process still have to do in this pass of the loop: append to a stage, then call `due`.

    say: publish the own state;  decide: let a law find a reference;  act: send a command. Poses are seen before, as
    they come. Each piece of work handles its own errors: one that escapes ends the stage for all.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.say: list[Work] = []
        self.decide: list[Work] = []
        self.act: list[Work] = []
        self._due = False

    def due(self) -> None:
        """There is something to do, in the next pass of the loop."""
        if not self._due:
            self._due = True
            self.clock.soon(self.run)

    def run(self) -> None:
        """All that is to do, stage by stage; what a stage adds to a later one is done too."""
        self._due = False
        say, self.say = self.say, []
        for work in say:
            work()
        decide, self.decide = self.decide, []
        for work in decide:
            work()
        act, self.act = self.act, []
        for work in act:
            work()
