"""The knowledge of one robot about its team in flight: the members, and the task book.

Gossip keeps the task books of all robots equal.
"""

import asyncio
import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import inf
from typing import Any

import msgspec

from crazychoir.errors import CodecError, RosterChanged
from crazychoir.guidance.tasks.task_book import Place, Record, Task, TaskBook, TaskState
from crazychoir.team.channel_table import FAILURE_CHANNEL
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class NewsTiming:
    """How often a robot sends its news, and when another robot counts as not heard."""

    period: float = 0.2
    """s: interval at which a robot merges its neighbours' books and sends its own."""
    farewell: float = 2.0
    """s: how long a robot repeats that the team has ended, while others may not know it."""
    last_repeats: int = 5
    """How often a robot repeats that its own mission has ended."""
    silence: float = 5.0
    """s: without news for this time a robot counts as not heard."""


NEWS_TIMING = NewsTiming()


BOOK_CHANNEL = "book"
"""Channel of the books."""
UNREACHED_REASON = "cut off from more than half of the team"
"""Reason of a robot that hears too few others."""
NO_DRONE_FLIES_REASON = "no drone that it hears flies any more"
"""Reason of a robot that hears no flying robot."""
Key = tuple[int, tuple[int, ...]]
"""Identifies the team of a series of plannings: the epoch, and the members that fly no more."""


class TeamNews:
    """What one robot knows about its team, and tells its neighbours.

    communicator: the link to the neighbours.
    tasks: the tasks that it knows from the start.
    here: returns the position of the robot, (2,) m.
    recover: see TaskBook.standings.
    period: s between two messages.
    changed: set when the team has changed.
    dropped: number of messages that were not valid books.
    """

    def __init__(
        self,
        communicator: Communicator,
        tasks: tuple[Task, ...],
        here: Callable[[], Place],
        recover: bool,
        period: float = NEWS_TIMING.period,
    ) -> None:
        self.communicator = communicator
        self.here = here
        self.recover = recover
        self.period = period
        self.clock = communicator.port.bus.clock
        self.id = communicator.id
        self.record = Record(self.id, communicator.port.incarnation, 1, here())
        self.book = TaskBook(tasks, [self.record])
        self.changed = asyncio.Event()
        self.dropped = 0
        self._team: tuple[int, ...] = ()
        self._failed: dict[int, None] = {}
        self._heard: dict[int, float] = {}  # s: arrival of each robot's newest record

    # Saying and hearing ---------------------------------------------------------------

    def say(self, **changes: Any) -> int:
        """Write a new edition of the robot's own record, and return its number."""
        self.record = msgspec.structs.replace(
            self.record, number=self.record.number + 1, **changes
        )
        self.book.hear(self.record)
        return self.record.number

    async def gossip(self) -> None:
        """Merge the neighbours' books, and send this robot's book to them, for ever."""
        while True:
            try:
                neighbors = self.links().neighbors(self.id)
                self.hear(
                    await self.communicator.asynchronous_receive(
                        neighbors, channel=BOOK_CHANNEL
                    )
                )
                self._write_off(
                    await self.communicator.asynchronous_receive(
                        neighbors, channel=FAILURE_CHANNEL
                    )
                )
                await self._tell()
            except RosterChanged:
                self.changed.set()
            except CodecError as error:
                log.warning("drone %d: %s", self.id, error)
            await self._pause()

    async def _tell(self) -> None:
        letter = self.letter()
        await self.communicator.send(
            letter, self.links().neighbors(self.id), channel=BOOK_CHANNEL
        )

    def letter(self) -> bytes:
        """Return the book for the neighbours.

        It holds the tasks only if a neighbour has different tasks.
        """
        others = [
            record
            for _, record in sorted(self.book.records.items())
            if record.robot != self.id
        ]
        seen = tuple((r.robot, r.incarnation, r.number) for r in others)
        knows = self.book.checksum
        self.say(place=self.here(), seen=seen, knows=knows)
        records = [self.book.newest(j) for j in self.links().neighbors(self.id)]
        return self.book.wire(
            tasks=any(record is None or record.knows != knows for record in records)
        )

    def hear(self, heard: dict[int, Any]) -> None:
        """Merge the books of neighbours, by robot.

        If a record of this robot arrives with another incarnation, it is from before a restart:
        publish a record with a higher `life`, which replaces it.
        """
        before = self.key()
        old = dict(self.book.records)
        for i, wire in heard.items():
            try:
                self.book.merge(TaskBook.of(wire))
            except CodecError as error:
                self.drop(i, error)
        now = self.clock.now()
        self._heard |= {
            key[0]: now
            for key, record in self.book.records.items()
            if record is not old.get(key)
        }
        newest = self.book.newest(self.id)
        if newest is not None and newest.incarnation != self.record.incarnation:
            self.say(life=newest.life + 1)
        if self.key() != before:
            self.changed.set()

    def _write_off(self, failed: Collection[int]) -> None:
        """Publish that failed neighbours are out, because they may not have sent it themselves.

        A neighbour is written off once for each failure. It may fly again after a restart.
        """
        before = self.key()
        for i in failed:
            record = self.book.newest(i)
            if i not in self._failed and record is not None and not record.out:
                self.book.hear(
                    msgspec.structs.replace(record, number=record.number + 1, out=True)
                )
        self._failed = dict.fromkeys(failed)
        if self.key() != before:
            self.changed.set()

    def drop(self, i: int, error: CodecError) -> None:
        """Count a message of robot i that is not a valid book."""
        if not self.dropped:
            log.warning("drone %d: from drone %d, dropped: %s", self.id, i, error)
        self.dropped += 1

    async def farewell(self) -> None:
        """Announce the end, and wait until all flying robots have announced it too.

        Waits at most NEWS_TIMING.farewell s. `gossip` must run meanwhile, as it sends the messages.
        """
        self.say(ended=True)
        ends = self.clock.now() + NEWS_TIMING.farewell
        while self.clock.now() < ends and not all(
            r.ended for r in self.book.alive(self.members).values()
        ):
            await self._pause()
        await self._pause()  # the last robots learn that all know
        await self._pause()

    async def last_words(self) -> None:
        """Tell the others that this robot flies no more."""
        self.say(out=True)
        for _ in range(NEWS_TIMING.last_repeats):
            try:
                await self._tell()
            except RosterChanged:
                continue
            await self._pause()

    async def left_alone(
        self, bound: float, busy: Callable[[], bool] = lambda: False
    ) -> str:
        """Wait until the robot has been left alone for `bound` s, and return why.

        A robot is left alone while no robot that it hears can decide, and while it is not busy.
        Without this end a robot that is out, or has nothing to do, would wait for ever for others
        that are lost.

        bound: s.
        busy: returns whether the robot is busy.
        """
        since = self.clock.now()
        while not (why := self.alone) or busy() or self.clock.now() <= since + bound:
            if not why or busy():
                since = self.clock.now()
            await self._pause()
        return f"{why} for {bound:g} s"

    async def _pause(self) -> None:
        await self.clock.sleep(self.period, drone=self.id)

    # What is known --------------------------------------------------------------------

    @property
    def members(self) -> tuple[int, ...]:
        """The team of the present epoch."""
        return self.communicator.graph.at(0).ids

    def alive_ids(self) -> tuple[int, ...]:
        """Return the members that still fly."""
        return tuple(self.book.alive(self.members))

    def standings(self) -> dict[int, TaskState]:
        """Return the present state of each task, as far as it is known here."""
        return self.book.standings(self.members, self.recover)

    def known(self, number: int) -> bool:
        """Return whether more than half of the team know an edition of this robot's record.

        Members that are out do not count. Always False in a part of the team that may not decide:
        after it has lost the others, a single robot could be more than half of it.

        number: the edition, as `say` returns it.
        """
        witnesses = self.book.witnesses(
            self.id, self.record.incarnation, number, self.members
        )
        return (
            self.quorate
            and witnesses >= (len(self.members) - len(self.book.out(self.members))) // 2
        )

    @property
    def ended(self) -> bool:
        """The team has agreed to end."""
        return any(record.ended for record in self.book.alive(self.members).values())

    @property
    def alone(self) -> str:
        """Reason why no robot in reach can change the plan; empty if one can, or after the end.

        Only flying robots can, in a part of the team that may decide (see `quorate`), while this
        robot hears more members than it misses.
        """
        flying = self.book.alive(self.members)
        now = self.clock.now()
        heard = [
            i
            for i in self.members
            if i == self.id or now <= self._heard.get(i, -inf) + NEWS_TIMING.silence
        ]
        missing = [
            i
            for i in self.members
            if i not in heard and i not in self.book.out(self.members)
        ]
        if self.ended:
            return ""
        if not self.quorate or len(heard) <= len(missing):
            return UNREACHED_REASON
        return "" if any(i in flying for i in heard) else NO_DRONE_FLIES_REASON

    # The team -------------------------------------------------------------------------

    def key(self) -> Key:
        """Return the key of the present team."""
        return self.communicator.epoch, self.book.out(self.members)

    def links(self, without: tuple[int, ...] = ()) -> Graph:
        """Return the communication graph, repaired where lost members have cut it into parts."""
        return mend_graph(self.communicator.graph.at(0), without)

    @property
    def quorate(self) -> bool:
        """Whether this part of the team may decide.

        It may if it holds more than half of the last team that could decide. If the team was cut
        into two equal halves, the half with the lowest id may decide.
        """
        team = self._team or self.members
        stayed = [i for i in team if i in self.members]
        return 2 * len(stayed) > len(team) or (
            2 * len(stayed) == len(team) and team[0] in stayed
        )

    def count(self) -> bool:
        """Return whether the present team may decide, and remember the team if it may.

        `quorate` then measures the next team against it.
        """
        if self.quorate:
            self._team = self.members
            return True
        return False


@lru_cache(maxsize=64)
def mend_graph(graph: Graph, without: tuple[int, ...] = ()) -> Graph:
    """Return the graph without some members, connected again.

    If it falls into parts, edges join the lowest ids of the parts, in a row. All robots compute the
    same graph.

    without: ids to leave out.
    """
    ids = tuple(i for i in graph.ids if i not in without)
    arcs = [arc for arc in graph.arcs if arc[0] in ids and arc[1] in ids]
    graph = Graph.from_edges(ids, arcs)
    lowest = list[int]()
    seen = dict[int, None]()
    for i in ids:
        if i not in seen:
            lowest.append(i)
            queue = [i]
            while queue:
                j = queue.pop()
                if j not in seen:
                    seen[j] = None
                    queue.extend(graph.neighbors(j))
    return Graph.from_edges(ids, [*arcs, *pairwise(lowest)])
