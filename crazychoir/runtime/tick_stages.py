"""The stages of a tick: all drones of a process do one stage, then all do the next.

The poses of all drones arrive together, in one frame. If each drone did all its stages as soon as
its pose arrived, the law of the first drone would have no state of this tick from its neighbours,
and the law of the last drone would have all of them. With stages, all drones first take their
poses, then all publish their states, then all decide, then all act. This is also faster: the
processor's caches hold the few lines of one stage for a hundred drones, but not the lines of a
whole chain.
"""

from collections.abc import Callable

from crazychoir.runtime.clock import Clock

Work = Callable[[], None]
"""One piece of work of one drone."""


class TickStages:
    """The work that the drones of a process still have to do in this pass of the loop.

    Append work to a stage, then call `due`. The poses are taken before, as they arrive. Each piece
    of work handles its own errors; the first error that escapes is raised when all work is done.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.say: list[Work] = []
        """Work: publish the own state."""
        self.hear: list[Work] = []
        """Work of every pass, when all states are published: let the drones hear them."""
        self.decide: list[Work] = []
        """Work: let a law compute a reference; appended when the law receives the state."""
        self.act: list[Work] = []
        """Work: send a command."""
        self._due = False

    def due(self) -> None:
        """Run the stages in the next pass of the loop."""
        if not self._due:
            self._due = True
            self.clock.soon(self.run)

    def run(self) -> None:
        """Do all work, stage by stage, including work that one stage adds to a later stage."""
        self._due = False
        failed: list[Exception] = []
        say = self.say
        self.say = []
        _run_stage(say, failed)
        _run_stage(self.hear, failed)
        decide = self.decide
        self.decide = []
        _run_stage(decide, failed)
        act = self.act
        self.act = []
        _run_stage(act, failed)
        if failed:
            raise failed[0]


def _run_stage(stage: list[Work], failed: list[Exception]) -> None:
    """Do all work of a stage.

    An error of one drone must not keep another drone from its command.
    """
    for work in stage:
        try:
            work()
        except Exception as error:  # noqa: BLE001 - the first is raised at the end
            failed.append(error)
