"""Where tasks come from in flight: events of the mission, and operators. Who hears of one tells the others."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import msgspec
import numpy as np

from crazychoir.errors import Refused
from crazychoir.guidance.task_book import Task
from crazychoir.guidance.team_news import TeamNews
from crazychoir.safety.guard import EDGE
from crazychoir.swarm.config import SwarmConfig

ADDED = 10_000
"""Tasks from this id on were added in flight by an operator, at the robot of the last digits."""
LOOK = 0.05, 1.0
"""s, at least and at most, between two looks at the clock."""


class Event(NamedTuple):
    """A task appears, or is cancelled, t s after GO; robots: who hear of it, empty: all who are there."""

    t: float
    task: Task
    robots: tuple[int, ...] = ()


class TaskSource:
    """What one robot hears of tasks, into its news; clearance: m that a task keeps from all homes."""

    def __init__(self, news: TeamNews, config: SwarmConfig, clearance: float) -> None:
        self.news, self.config, self.clearance = news, config, clearance

    @property
    def age(self) -> float:
        """s since GO."""
        return self.news.communicator.port.bus.impairment.age(self.news.clock.now())

    async def hear(self, events: Iterable[Event]) -> None:
        """Learn of each event when it is time; events: in the order of their times."""
        least, most = LOOK
        for event in events:
            while self.age < event.t:
                await self.news.clock.sleep(min(max(event.t - self.age, least), most), drone=self.news.id)
            if not event.robots or self.news.id in event.robots:
                self.news.book.learn(event.task)

    def asked(self, verb: str, arguments: dict[str, Any]) -> dict[str, int]:
        """An operator's task_add {"pickup", "delivery", "load", "robots"} or task_cancel {"id"}; returns {"id"}.

        Raises Refused.
        """
        if self.news.ended:
            raise self._refused("the mission is over")
        j = self._add(arguments) if verb == "task_add" else self._cancel(arguments)
        return {"id": j}

    def _add(self, arguments: dict[str, Any]) -> int:
        """Ids differ by the robot that was asked: two operators may add tasks at the same time."""
        tasks, me = self.news.book.tasks, self.news.id
        count = max((j // ADDED for j in tasks if j >= ADDED and j % ADDED == me), default=0) + 1
        raw = {"load": 1.0, "robots": [], **arguments, "id": ADDED * count + me, "version": 0, "cancelled": False}
        try:
            task = msgspec.convert([raw.pop(name, None) for name in Task.__struct_fields__], Task)
        except msgspec.ValidationError as error:
            raise self._refused(f"{error}") from error
        if raw:
            raise self._refused(f"unknown: {', '.join(sorted(raw))}")
        self._require_free(task)
        self.news.book.learn(task)
        return task.id

    def _cancel(self, arguments: dict[str, Any]) -> int:
        j, book = arguments.get("id"), self.news.book
        if not isinstance(j, int) or j not in book.tasks:
            raise self._refused(f"there is no {j}; there are {', '.join(map(str, sorted(book.tasks)))}")
        book.cancel(j)
        return j

    def _require_free(self, task: Task) -> None:
        """Nobody can fly to a place outside the fence, or stand above a home where another drone may rise."""
        low, high = np.array(self.config.fence.min[:2]) + EDGE, np.array(self.config.fence.max[:2]) - EDGE
        for place in (task.pickup, task.delivery):
            if (place < low).any() or (place > high).any():
                raise self._refused(f"{list(place)} is outside the fence")
            for drone in self.config.drones:
                if np.linalg.norm(np.subtract(place, drone.home[:2])) < self.clearance:
                    raise self._refused(f"{list(place)} is within {self.clearance:g} m of the home of drone {drone.id}")

    def _refused(self, why: str) -> Refused:
        return Refused(f"drone {self.news.id}", f"task: {why}")
