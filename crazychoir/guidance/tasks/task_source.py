"""The sources of tasks in flight: events of the mission, and operators.

A task then spreads by gossip.
"""

import re
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple, Protocol

import msgspec

from crazychoir.errors import Refused
from crazychoir.guidance.tasks.task_book import Fate, Place, Task
from crazychoir.guidance.tasks.team_news import TeamNews
from crazychoir.team.graph import describe_ids

FIRST_ADDED_ID = 10_000
"""Smallest id of a task that an operator added in flight.

The last digits of such an id are the robot that received the command.
"""
EVENT_WAIT_RANGE = 0.05, 1.0
"""s: shortest and longest wait before looking for the next event."""
COMMAND_PATIENCE = 2.0
"""s: how long a command of an operator may wait for the team."""
_DECODER_FIELD_PATTERN = re.compile(r"`\$\[(\d+)\]")
"""How the error of a decoder names a field of a task: `$[3]`."""


class TaskEvent(NamedTuple):
    """A task that appears, or a cancellation."""

    t: float
    """s after GO."""
    task: Task
    """The task, or its cancelled version."""
    robots: tuple[int, ...] = ()
    """Ids of the robots that learn of the event directly. Empty: all robots that are there."""


class TaskSite(Protocol):
    """Where tasks may be, and which robots may serve them."""

    def explain_bad_place(self, task: Task, pickup: Place) -> str:
        """Return why no robot can stand at the task's places. Empty if one can."""
        ...

    def explain_unservable(self, task: Task) -> str:
        """Return why no robot of this swarm can serve the task. Empty if one can."""
        ...

    def explain_wait(self, task: Task, flying: Collection[int]) -> str:
        """Return why no flying robot can serve a task that the swarm could serve.

        Empty if one can.
        """
        ...


class TaskSource:
    """Brings the tasks that one robot learns of into its news.

    news: the news of the robot.
    site: where tasks may be.
    events: in the order of their times.
    may_end: returns whether the team is deciding now, without knowledge of new tasks, that its
        mission is over.
    """

    def __init__(
        self,
        news: TeamNews,
        site: TaskSite,
        events: Sequence[TaskEvent] = (),
        may_end: Callable[[], bool] = lambda: False,
    ) -> None:
        self.news = news
        self.site = site
        self.events = events
        self.may_end = may_end
        self._heard = 0

    @property
    def age(self) -> float:
        """s since GO."""
        return self.news.communicator.port.bus.impairment.age(self.news.clock.now())

    @property
    def heard_all(self) -> bool:
        """All events have happened."""
        return self._heard == len(self.events)

    async def hear(self) -> None:
        """Learn of each event at its time."""
        least, most = EVENT_WAIT_RANGE
        for event in self.events:
            while self.age < event.t:
                await self._pause(min(max(event.t - self.age, least), most))
            if not event.robots or self.news.id in event.robots:
                self.news.book.learn(event.task)
            self._heard += 1

    # Operators ------------------------------------------------------------------------

    async def asked(self, verb: str, arguments: dict[str, Any]) -> dict[str, Any]:
        """Answer a command of an operator.

        task_add {"pickup", "delivery", "load", "robots"}: add a task.
        task_cancel {"id"}: cancel a task.
        task_list: return {"tasks": the list of `listed`}.

        The first two return {"id"}, and with "note" what the operator should know. They return when
        more than half of the team know of the change, so that the loss of a single drone cannot
        undo it.
        Raises Refused, and then nothing has changed.
        """
        if verb == "task_list":
            return {"tasks": self.listed()}
        task = self._read(arguments) if verb == "task_add" else None
        await self._ready()
        j, note = self._cancel(arguments) if task is None else self._add(task)
        notes = [note, await self._told(self.news.say())]
        return {"id": j} | (
            {"note": "; ".join(filter(None, notes))} if any(notes) else {}
        )

    def listed(self) -> list[dict[str, Any]]:
        """Return the tasks that are known here.

        id: number of the task.
        pickup: (2,) m: where it lies now.
        delivery: (2,) m.
        load: load of the goods.
        fate: what has become of it.
        robot: id of the robot that carries it, has delivered it or has lost it.
        """
        standings = self.news.standings()
        tasks = self.news.book.tasks
        return [
            {
                "id": j,
                "pickup": list(standing.pickup),
                "delivery": list(tasks[j].delivery),
                "load": tasks[j].load,
                "fate": standing.fate.value,
                "robot": standing.robot,
            }
            for j, standing in standings.items()
        ]

    async def _ready(self) -> None:
        """Wait until this robot knows what more than half of the team knew when it was started.

        Before that it might reuse the number of a task that it added in an earlier life.
        Raises Refused if the mission is over, if the robot flies no more, or if the wait takes too
        long.
        """
        ends = self.news.clock.now() + COMMAND_PATIENCE
        while True:
            if self.news.ended:
                raise self._refused("the mission is over")
            if self.news.record.out:
                raise self._refused("this drone has landed; ask another drone")
            if self.news.known(1) and not self.may_end():
                return
            if self.news.clock.now() > ends:
                raise self._refused(
                    f"for {COMMAND_PATIENCE:g} s, it has heard from too few other drones; "
                    "ask another drone, or repeat it"
                )
            await self._pause(EVENT_WAIT_RANGE[0])

    async def _told(self, number: int) -> str:
        """Wait until more than half of the team know an edition of the record.

        Returns a note for the operator if they do not know it in time.
        """
        ends = self.news.clock.now() + COMMAND_PATIENCE
        while not self.news.known(number):
            if self.news.clock.now() > ends:
                return f"for {COMMAND_PATIENCE:g} s, less than half of the team has received it: is this drone cut off?"
            await self._pause(EVENT_WAIT_RANGE[0])
        return ""

    def _read(self, arguments: dict[str, Any]) -> Task:
        """Return the task to add, still without its id. Raises Refused."""
        raw = {
            "load": 1.0,
            "robots": [],
            **arguments,
            "id": FIRST_ADDED_ID,
            "version": 0,
            "cancelled": False,
        }
        names = Task.__struct_fields__
        try:
            task = msgspec.convert([raw.pop(name, None) for name in names], Task)
        except msgspec.ValidationError as error:
            wrong = _DECODER_FIELD_PATTERN.sub(
                lambda found: f"`{names[int(found[1])]}`", str(error)
            )
            raise self._refused(
                f"{wrong}; allowed: places [x, y] in m, a load of 0 to 1e6, drone ids"
            ) from error
        if raw:
            raise self._refused(
                f"unknown: {', '.join(sorted(raw))}; there are {', '.join(names[3:])}"
            )
        if why := self.site.explain_bad_place(
            task, task.pickup
        ) or self.site.explain_unservable(task):
            raise self._refused(why)
        return task

    def _add(self, task: Task) -> tuple[int, str]:
        """Add a task, and return its id and a note.

        The id contains the robot that received the command, so two operators may add tasks at the
        same time.
        """
        tasks = self.news.book.tasks
        me = self.news.id
        count = (
            max(
                (
                    j // FIRST_ADDED_ID
                    for j in tasks
                    if j >= FIRST_ADDED_ID and j % FIRST_ADDED_ID == me
                ),
                default=0,
            )
            + 1
        )
        task = msgspec.structs.replace(task, id=FIRST_ADDED_ID * count + me)
        self.news.book.learn(task)
        waits = self.site.explain_wait(task, self.news.book.alive(self.news.members))
        return task.id, waits and f"it waits: {waits}"

    def _cancel(self, arguments: dict[str, Any]) -> tuple[int, str]:
        j = arguments.get("id")
        book = self.news.book
        if not isinstance(j, int) or j not in book.tasks:
            groups = (
                [k for k in book.tasks if k < FIRST_ADDED_ID],
                [k for k in book.tasks if k >= FIRST_ADDED_ID],
            )
            raise self._refused(
                f"there is no {j}; there are {', '.join(map(describe_ids, filter(None, groups))) or 'none'}"
            )
        standing = self.news.standings()[j]
        was_cancelled = book.tasks[j].cancelled
        match standing.fate:
            case Fate.DELIVERED:
                raise self._refused(f"drone {standing.robot} has delivered {j} already")
            case Fate.LOST:
                raise self._refused(
                    f"{j} is lost, with drone {standing.robot} that had it aboard"
                )
        book.cancel(j)
        if standing.fate is Fate.ABOARD:
            return (
                j,
                f"it is on board drone {standing.robot}, which will still deliver it",
            )
        return j, "it was cancelled already" if was_cancelled else ""

    async def _pause(self, seconds: float) -> None:
        await self.news.clock.sleep(seconds, drone=self.news.id)

    def _refused(self, why: str) -> Refused:
        return Refused(f"drone {self.news.id}", f"task: {why}")
