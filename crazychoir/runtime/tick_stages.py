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
    """What the drones of a process still have to do in this pass of the loop: append to stages, then call `due`.

    say: publish the own state;  decide: let a law find a reference, appended when it hears of that state;  act: send
    a command. Poses are seen before, as they come. Each piece of work handles its own errors; the first that escapes
    is raised when all is done.
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
        failed: list[Exception] = []
        say = self.say
        self.say = []
        _do(say, failed)
        decide = self.decide
        self.decide = []
        _do(decide, failed)
        act = self.act
        self.act = []
        _do(act, failed)
        if failed:
            raise failed[0]


def _do(stage: list[Work], failed: list[Exception]) -> None:
    """All of a stage, whatever fails: no drone goes without its command for another one's error."""
    for work in stage:
        try:
            work()
        except Exception as error:  # noqa: BLE001 - the first is raised at the end
            failed.append(error)
