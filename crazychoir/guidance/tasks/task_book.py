"""What a team knows of its tasks while it flies: news that may be merged in any order, and any number of times.

Two kinds of news, and each only grows: of a task the highest version counts, of a robot what it has said last. A robot
alone writes what it has done with goods, in its own record; what has become of a task follows from all records.
"""

from collections.abc import Collection, Iterable, Mapping
from enum import Enum
from typing import Annotated, Any, NamedTuple
from zlib import crc32

import msgspec
from msgspec import Meta, Struct

from crazychoir.errors import CodecError
from crazychoir.routing.instance.plan import Kind

LARGEST = 1e6
"""m and units of load: no task and no place says more."""
Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Place = tuple[Number, Number]
"""m, in the plane: robots fly at one height."""
Count = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]
"""Incarnations are as large as that: random, so they say who lives, not who lived first."""


class Task(Struct, frozen=True, order=True, array_like=True):
    """Goods to be brought from `pickup` to `delivery`, (2,) m each; robots: who alone may, empty: all.

    A higher version replaces a lower one; a cancelled one is its own last version.
    """

    id: Count
    version: Count
    cancelled: bool
    pickup: Place
    delivery: Place
    load: Annotated[float, Meta(ge=0.0, le=LARGEST)] = 1.0
    robots: tuple[Count, ...] = ()


class Deed(Struct, frozen=True, order=True, array_like=True):
    """A robot has picked goods up, or delivered them; generation: how often they had been picked up by then."""

    task: Count
    kind: Kind
    generation: Count


class Record(Struct, frozen=True, order=True, array_like=True):
    """What a robot has last said of itself; it alone writes it, `number` counts its editions.

    place: (2,) m, where it is;  deeds: what it has done with goods, oldest first;  seen: (robot, incarnation, number)
    of the others' records that it has;  knows: checksum of the tasks that it knows;  run: (epoch, how many are out,
    run), the newest planning that it takes part in;  landed, idle: on the ground, and waiting for nothing more;
    out: it flies no more, its goods lie where it is;  ended: the team has agreed to end;
    life: how many incarnations of the robot there have been, as far as it has heard: the last one counts.
    """

    robot: Count
    incarnation: Count
    number: Count
    place: Place
    deeds: tuple[Deed, ...] = ()
    seen: tuple[tuple[Count, Count, Count], ...] = ()
    knows: Count = 0
    run: tuple[Count, Count, Count] = (0, 0, 0)
    landed: bool = True
    idle: bool = False
    out: bool = False
    ended: bool = False
    life: Count = 1


class Fate(Enum):
    """What has become of a task."""

    OPEN = "open"
    ABOARD = "aboard"
    DELIVERED = "delivered"
    CANCELLED = "cancelled"
    LOST = "lost"


class Standing(NamedTuple):
    """A task as it stands.

    robot: who carries, has delivered or has lost it;  pickup: where it lies if it is open;  generation: how often it
    has been picked up.
    """

    fate: Fate
    pickup: Place
    robot: int | None = None
    generation: int = 0


class TaskBook:
    """Tasks by id, and the newest record of each robot and incarnation.

    `merge` is commutative, associative and idempotent: all who have heard the same news have equal books.
    changes: counts news that may change what has become of a task.
    """

    def __init__(
        self, tasks: Iterable[Task] = (), records: Iterable[Record] = ()
    ) -> None:
        self.tasks: dict[int, Task] = {}
        self.records: dict[tuple[int, int], Record] = {}
        self.changes = 0
        self._newest: dict[int, Record] = {}
        self._standings: tuple[Any, dict[int, Standing]] = (None, {})
        self._fallen: dict[
            int | None, None
        ] = {}  # robots by whose places these standings are: others fly about
        for task in tasks:
            self.learn(task)
        for record in records:
            self.hear(record)

    def learn(self, task: Task) -> bool:
        """Take in a task, or a new version of it; whether it was news."""
        known = self.tasks.get(task.id)
        if known is not None and task <= known:
            return False
        self.tasks[task.id] = task
        self.changes += 1
        return True

    def hear(self, record: Record) -> bool:
        """Take in what a robot says of itself; whether it was news."""
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
        if moved or known is None or _done(known) != _done(record):
            self.changes += 1
        return True

    def merge(self, other: "TaskBook") -> bool:
        """Take in all that another book knows; whether anything was news."""
        news = [self.learn(task) for task in other.tasks.values()]
        news += [self.hear(record) for record in other.records.values()]
        return any(news)

    def cancel(self, j: int) -> bool:
        """Cancel a task; whether that was news. Goods that are aboard are delivered all the same."""
        task = self.tasks[j]
        return self.learn(msgspec.structs.replace(task, cancelled=True))

    # Who is there ---------------------------------------------------------------------------------------------

    def newest(self, i: int) -> Record | None:
        """The record of the newest incarnation of robot i."""
        return self._newest.get(i)

    def alive(self, members: Collection[int]) -> dict[int, Record]:
        """Records of the members that still fly, by robot."""
        found = {i: self.newest(i) for i in sorted(members)}
        return {
            i: record
            for i, record in found.items()
            if record is not None and not record.out
        }

    def out(self, members: Collection[int]) -> tuple[int, ...]:
        """Members that have said that they fly no more."""
        found = {i: self.newest(i) for i in sorted(members)}
        return tuple(
            i for i, record in found.items() if record is not None and record.out
        )

    def witnesses(
        self, i: int, incarnation: int, number: int, members: Collection[int]
    ) -> int:
        """How many of the members are known to have heard edition `number` of robot i, or a newer one."""
        others = [record for j, record in self.alive(members).items() if j != i]
        return sum(
            any(s[0] == i and s[1] == incarnation and s[2] >= number for s in r.seen)
            for r in others
        )

    # What has become of the tasks -----------------------------------------------------------------------------

    def standings(self, members: Collection[int], recover: bool) -> dict[int, Standing]:
        """Each task as it stands, by id; recover: goods of a robot that is gone lie where it was last.

        Goods belong to the robot that has picked them up last (of several, the lowest id) until it delivers them.
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
    ) -> dict[int, Standing]:
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
    ) -> Standing:
        if by is not None:
            return Standing(Fate.DELIVERED, task.pickup, by)
        if carrier is None:
            return Standing(
                Fate.CANCELLED if task.cancelled else Fate.OPEN, task.pickup
            )
        generation, i, incarnation = carrier
        if (i, incarnation) in alive:
            return Standing(Fate.ABOARD, task.pickup, i, generation)
        if not recover:
            return Standing(Fate.LOST, task.pickup, i, generation)
        fate = Fate.CANCELLED if task.cancelled else Fate.OPEN
        return Standing(fate, self.records[i, incarnation].place, i, generation)

    # On the wire ----------------------------------------------------------------------------------------------

    @property
    def checksum(self) -> int:
        """Of the tasks: equal for equal ones."""
        return crc32(
            msgspec.msgpack.encode([task for _, task in sorted(self.tasks.items())])
        )

    def wire(self, tasks: bool = True) -> bytes:
        """As a message, with the tasks or the records alone."""
        return msgspec.msgpack.encode(
            [list(self.tasks.values()) if tasks else [], list(self.records.values())]
        )

    @classmethod
    def of(cls, wire: object) -> "TaskBook":
        """From a message; raises CodecError."""
        try:
            return cls(*_READER.decode(wire))  # type: ignore[arg-type]  # what is no bytes raises
        except (msgspec.MsgspecError, TypeError, ValueError, RecursionError) as error:
            raise CodecError(f"task book: {error}") from error


def _done(record: Record) -> tuple[Any, ...]:
    """What of a record may change what has become of tasks, wherever it is."""
    return record.deeds, record.life, record.out


_READER = msgspec.msgpack.Decoder(tuple[list[Task], list[Record]])
