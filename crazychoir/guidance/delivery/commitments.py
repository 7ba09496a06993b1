"""The commitments of one robot to its team: its route, its bound tasks, and the goods on board.

This module only keeps records; it commands no flight.
"""

from collections.abc import Sequence

from crazychoir.guidance.delivery.replanning import PlanShare, TaskBonds
from crazychoir.guidance.tasks.task_book import Deed, Fate
from crazychoir.guidance.tasks.team_news import TeamNews
from crazychoir.routing.instance.plan import Stop


class Commitments:
    """The commitments of one robot, and the stops that they allow it to begin.

    news: what this robot knows about its team.
    route: stops, in order.
    planning: the robot takes part in a planning and has not adopted a plan of it yet.
    bound: tasks that it reserved in its first message of that planning. No other robot gets them.
    """

    def __init__(self, news: TeamNews) -> None:
        self.news = news
        self.route: list[Stop] = []
        self.planning = False
        self.bound: dict[int, None] = {}
        self._head: list[Stop] = []

    def aboard(self) -> dict[int, None]:
        """Return the tasks of the goods that it carries, in the order of their pickups."""
        found: dict[int, None] = {}
        for deed in self.news.record.deeds:
            if deed.kind == "pickup":
                found[deed.task] = None
            else:
                found.pop(deed.task, None)
        return found

    def next(self) -> Stop | None:
        """Return the next stop, without pickups of goods that are not there any more.

        None if the robot has announced that it flies no more: others may be on their way to its goods.
        """
        while self.route and not self.news.record.out:
            stop = self.route[0]
            if (
                stop.kind == "delivery"
                or self.news.standings()[stop.task].fate is Fate.OPEN
            ):
                return stop
            self._forget(stop.task)
        return None

    def allow(self, stop: Stop) -> bool:
        """Return whether the robot may begin a stop now.

        A delivery is always allowed. A pickup needs a part of the team that may decide; during a
        planning it also needs a bound task, because the plan may give others to another robot.
        """
        free = self.news.quorate and (not self.planning or stop.task in self.bound)
        return stop.kind == "delivery" or free

    # A planning -----------------------------------------------------------------------

    def begin(self, head: Sequence[Stop]) -> TaskBonds:
        """Take part in a planning, and return the bonds to announce.

        head: the stops that the robot will serve in any case.
        Returns the tasks that `head` completes, and the tasks on board after it.
        """
        aboard = self.aboard()
        for stop in head:
            if stop.kind == "pickup":
                aboard[stop.task] = None
            else:
                aboard.pop(stop.task, None)
        self.planning = True
        self.bound = dict.fromkeys(stop.task for stop in head)
        self._head = list(head)
        return TaskBonds(
            bound=tuple(j for j in self.bound if j not in aboard),
            carried=tuple(aboard),
        )

    def adopt(self, share: PlanShare) -> None:
        """Take a new route: the bound stops that are not done yet, then the stops of the plan."""
        self.news.book.merge(share.book)
        for i, error in share.dropped.items():
            self.news.drop(i, error)
        done = {(deed.task, deed.kind): None for deed in self.news.record.deeds}
        self.route = [
            stop
            for stop in [*self._head, *share.stops]
            if (stop.task, stop.kind) not in done
        ]
        self.planning = False
        if share.ended:
            self.news.say(ended=True)
        elif self.route and self.news.record.idle:
            self.news.say(idle=False)

    def keep_aboard(self) -> None:
        """Replace the route by the deliveries of the goods on board."""
        self.route = [Stop(j, "delivery") for j in self.aboard()]

    # A stop ---------------------------------------------------------------------------

    def announce(self, stop: Stop) -> int:
        """Record that the robot stands at a stop and serves it.

        Returns the edition of the record that says so.
        """
        self.route.remove(stop)
        standing = self.news.standings()[stop.task]
        deed = Deed(stop.task, stop.kind, standing.generation + (stop.kind == "pickup"))
        return self.news.say(
            deeds=(*self.news.record.deeds, deed), place=self.news.here()
        )

    def take_back(self, task: int) -> None:
        """Undo a pickup that does not count: the goods stay, and there is nothing to deliver."""
        self.news.say(
            deeds=tuple(deed for deed in self.news.record.deeds if deed.task != task)
        )
        self._forget(task)

    def _forget(self, task: int) -> None:
        self.route = [stop for stop in self.route if stop.task != task]
