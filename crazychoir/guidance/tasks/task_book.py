"""The tasks that a team knows in flight, as news that may be merged in any order and any number.

There are two kinds of news, and both only grow. Of a task the highest version counts. Of a robot
the latest record counts. Only the robot itself records what it has done with goods. The fate of a
task follows from all records.
"""

from collections.abc import Collection, Iterable, Mapping
from enum import Enum
from typing import Annotated, Any, NamedTuple
from zlib import crc32

import msgspec
from msgspec import Meta, Struct

from crazychoir.errors import CodecError
from crazychoir.routing.instance.plan import Kind

LARGEST_TASK_NUMBER = 1e6
"""m, or units of load: largest number in a task or a place."""
Number = Annotated[float, Meta(ge=-LARGEST_TASK_NUMBER, le=LARGEST_TASK_NUMBER)]
"""A coordinate or a load, within LARGEST_TASK_NUMBER."""
Place = tuple[Number, Number]
"""(2,) m, in the plane: robots fly at one height."""
Count = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]
"""A whole number as large as an incarnation.

Incarnations are random, so they identify a life of a robot, but give no order of lives.
"""


class Task(Struct, frozen=True, order=True, array_like=True):
    """Goods to carry from `pickup` to `delivery`.

    A higher version replaces a lower one. A cancelled task is its own last version.
    """

    id: Count
    """Number of the task."""
    version: Count
    """Number of the version."""
    cancelled: bool
    """The task is cancelled."""
    pickup: Place
    """(2,) m: where the goods lie at first."""
    delivery: Place
    """(2,) m: where to bring the goods."""
    load: Annotated[float, Meta(ge=0.0, le=LARGEST_TASK_NUMBER)] = 1.0
    """Load of the goods, in the unit of the capacities."""
    robots: tuple[Count, ...] = ()
    """Ids of the only robots that may do the task. Empty: all robots."""


class Deed(Struct, frozen=True, order=True, array_like=True):
    """A robot has picked goods up, or has delivered them."""

    task: Count
    """Id of the task."""
    kind: Kind
    """"pickup" or "delivery"."""
    generation: Count
    """How often the goods had been picked up by then."""


class Record(Struct, frozen=True, order=True, array_like=True):
    """The latest report of a robot about itself. Only that robot writes it."""

    robot: Count
    """Id of the robot."""
    incarnation: Count
    """Identifies this life of the robot."""
    number: Count
    """Number of the edition of the record."""
    place: Place
    """(2,) m: where the robot is."""
    deeds: tuple[Deed, ...] = ()
    """What it has done with goods, oldest first."""
    seen: tuple[tuple[Count, Count, Count], ...] = ()
    """(robot, incarnation, number) of the records of others that it has."""
    knows: Count = 0
    """Checksum of the tasks that it knows."""
    run: tuple[Count, Count, Count] = (0, 0, 0)
    """(epoch, number of robots that are out, run): the newest planning that it takes part in."""
    landed: bool = True
    """It is on the ground."""
    idle: bool = False
    """It waits for nothing more."""
    out: bool = False
    """It flies no more. Its goods lie where it is."""
    ended: bool = False
    """The team has agreed to end."""
    life: Count = 1
    """How many incarnations of the robot there have been, as far as it has heard.

    The last one counts.
    """


class Fate(Enum):
    """What has become of a task."""

    OPEN = "open"
    ABOARD = "aboard"
    DELIVERED = "delivered"
    CANCELLED = "cancelled"
    LOST = "lost"


class TaskState(NamedTuple):
    """The present state of a task."""

    fate: Fate
    """What has become of it."""
    pickup: Place
    """(2,) m: where it lies if it is open."""
    robot: int | None = None
    """Id of the robot that carries it, has delivered it or has lost it."""
    generation: int = 0
    """How often it has been picked up."""


class TaskBook:
    """Tasks by id, and the newest record of each robot and incarnation.

    `merge` is commutative, associative and idempotent: robots with the same news have equal books.

    changes: counter of the news that may change the fate of a task.
    """

    def __init__(
        self, tasks: Iterable[Task] = (), records: Iterable[Record] = ()
    ) -> None:
        self.tasks: dict[int, Task] = {}
        self.records: dict[tuple[int, int], Record] = {}
        self.changes = 0
        self._newest: dict[int, Record] = {}
        self._standings: tuple[Any, dict[int, TaskState]] = (None, {})
        self._fallen: dict[
            int | None, None
        ] = {}  # robots: their places determine these standings
        for task in tasks:
            self.learn(task)
        for record in records:
            self.hear(record)

    def learn(self, task: Task) -> bool:
        """Add a task, or a new version of it. Returns whether it was news."""
        known = self.tasks.get(task.id)
        if known is not None and task <= known:
            return False
        self.tasks[task.id] = task
        self.changes += 1
        return True

    def hear(self, record: Record) -> bool:
        """Add a robot's record of itself. Returns whether it was news."""
        key = record.robot, record.incarnation
        known = self.records.get(key)
        if known is not None and (record.number, record) <= (known.number, known):
            return False
        self.records[key] = record
        lives = [
            other for other in self.records.values() if other.robot == record.robot
        ]
        self._newest[record.robot] = max(
            lives, key=lambda other: (other.life, other.incarnation)
        )
        moved = (
            record.robot in self._fallen
            and known is not None
            and known.place != record.place
        )
        if (
            moved
            or known is None
            or _select_fate_parts(known) != _select_fate_parts(record)
        ):
            self.changes += 1
        return True

    def merge(self, other: "TaskBook") -> bool:
        """Add all that another book knows. Returns whether any of it was news."""
        news = [self.learn(task) for task in other.tasks.values()]
        news += [self.hear(record) for record in other.records.values()]
        return any(news)

    def cancel(self, j: int) -> bool:
        """Cancel a task. Returns whether that was news.

        Goods that are aboard are delivered nevertheless.
        """
        task = self.tasks[j]
        return self.learn(msgspec.structs.replace(task, cancelled=True))

    # Robots in the team ---------------------------------------------------------------

    def newest(self, i: int) -> Record | None:
        """Return the record of the newest incarnation of robot i."""
        return self._newest.get(i)

    def alive(self, members: Collection[int]) -> dict[int, Record]:
        """Return the records of the members that still fly, by robot."""
        return {i: record for i, record in self._list_known(members) if not record.out}

    def out(self, members: Collection[int]) -> tuple[int, ...]:
        """Return the members that have said that they fly no more."""
        return tuple(i for i, record in self._list_known(members) if record.out)

    def _list_known(self, members: Collection[int]) -> list[tuple[int, Record]]:
        """Return (robot, newest record) of the members with a record, by robot."""
        newest = self._newest
        return [(i, newest[i]) for i in sorted(members) if i in newest]

    def witnesses(
        self, i: int, incarnation: int, number: int, members: Collection[int]
    ) -> int:
        """Return how many members are known to have edition `number` of robot i, or a newer one."""
        others = [record for j, record in self.alive(members).items() if j != i]
        return sum(
            any(s[0] == i and s[1] == incarnation and s[2] >= number for s in r.seen)
            for r in others
        )

    # What has become of the tasks -----------------------------------------------------

    def standings(
        self, members: Collection[int], recover: bool
    ) -> dict[int, TaskState]:
        """Return the present state of each task, by id.

        Goods belong to the robot that has picked them up last, until it delivers them. If several
        robots claim that, the lowest id counts.

        members: ids of the team.
        recover: goods of a lost robot lie at its last place and can be picked up. Else they are
            lost.
        """
        key = self.changes, tuple(members), recover
        if self._standings[0] != key:
            found = self._all_standings(members, recover)
            lying = [
                s
                for s in found.values()
                if s.fate in (Fate.OPEN, Fate.CANCELLED) and s.robot is not None
            ]
            self._standings, self._fallen = (
                (key, found),
                dict.fromkeys(s.robot for s in lying),
            )
        return self._standings[1]

    def _all_standings(
        self, members: Collection[int], recover: bool
    ) -> dict[int, TaskState]:
        carriers: dict[int, tuple[int, int, int]] = {}
        delivered: dict[int, int] = {}
        for (i, incarnation), record in sorted(self.records.items()):
            for deed in record.deeds:
                if deed.kind == "delivery":
                    delivered[deed.task] = min(i, delivered.get(deed.task, i))
                else:
                    last = carriers.get(deed.task, (0, 0, 0))
                    if deed.generation > last[0]:
                        carriers[deed.task] = deed.generation, i, incarnation
        alive = {
            (i, record.incarnation): None for i, record in self.alive(members).items()
        }
        return {
            j: self._standing(
                self.tasks[j], carriers.get(j), delivered.get(j), alive, recover
            )
            for j in sorted(self.tasks)
        }

    def _standing(
        self,
        task: Task,
        carrier: tuple[int, int, int] | None,
        by: int | None,
        alive: Mapping[tuple[int, int], None],
        recover: bool,
    ) -> TaskState:
        if by is not None:
            return TaskState(Fate.DELIVERED, task.pickup, by)
        if carrier is None:
            return TaskState(
                Fate.CANCELLED if task.cancelled else Fate.OPEN, task.pickup
            )
        generation, i, incarnation = carrier
        if (i, incarnation) in alive:
            return TaskState(Fate.ABOARD, task.pickup, i, generation)
        if not recover:
            return TaskState(Fate.LOST, task.pickup, i, generation)
        fate = Fate.CANCELLED if task.cancelled else Fate.OPEN
        return TaskState(fate, self.records[i, incarnation].place, i, generation)

    # On the wire ----------------------------------------------------------------------

    @property
    def checksum(self) -> int:
        """Checksum of the tasks: equal for equal tasks."""
        return crc32(
            msgspec.msgpack.encode([task for _, task in sorted(self.tasks.items())])
        )

    def wire(self, tasks: bool = True) -> bytes:
        """Return the book as a message, with the tasks or with the records alone."""
        return msgspec.msgpack.encode(
            [list(self.tasks.values()) if tasks else [], list(self.records.values())]
        )

    @classmethod
    def of(cls, wire: object) -> "TaskBook":
        """Return the book of a message. Raises CodecError."""
        try:
            return cls(*_BOOK_DECODER.decode(wire))  # type: ignore[arg-type]  # what is no bytes raises
        except (msgspec.MsgspecError, TypeError, ValueError, RecursionError) as error:
            raise CodecError(f"task book: {error}") from error


def _select_fate_parts(record: Record) -> tuple[Any, ...]:
    """Return the parts of a record that may change the fate of tasks, apart from its place."""
    return record.deeds, record.life, record.out


_BOOK_DECODER = msgspec.msgpack.Decoder(tuple[list[Task], list[Record]])
"""Decodes the tasks and records of a message."""
