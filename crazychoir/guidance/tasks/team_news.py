"""What one robot knows of its team in flight: its task book, kept equal to the others' by gossip, and who is there."""

import asyncio
import logging
from collections.abc import Callable, Collection
from functools import lru_cache
from itertools import pairwise
from math import inf
from typing import Any

import msgspec

from crazychoir.errors import CodecError, RosterChanged
from crazychoir.guidance.tasks.task_book import Place, Record, Standing, Task, TaskBook
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph
from crazychoir.team.rounds import FAILED

log = logging.getLogger(__name__)
PERIOD = 0.2
"""s between two looks at the neighbours' books, and two tellings of the own."""
FAREWELL = 2.0
"""s that a robot goes on telling that the team has ended, while others may not know."""
LAST = 5
"""Times that a robot tells of the end of its own mission."""
BOOK = "book"
SILENT = 5.0
"""s without news of a robot after which this one does not hear it."""
UNREACHED = "cut off from more than half of the team"
NOBODY = "nobody that it hears flies any more"
Key = tuple[int, tuple[int, ...]]
"""What a row of plannings holds for: the epoch, and who has said that it flies no more."""


class TeamNews:
    """The news of the robot of this communicator.

    tasks: that it knows from the start;  here: says where it is, (2,) m;  recover: see TaskBook.standings;
    period: s between two tellings;  changed: set when the team is another one;  dropped: messages that were no books.
    """

    def __init__(
        self,
        communicator: Communicator,
        tasks: tuple[Task, ...],
        here: Callable[[], Place],
        recover: bool,
        period: float = PERIOD,
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
        self._heard: dict[int, float] = {}  # when each robot's newest record came

    # Saying and hearing ---------------------------------------------------------------------------------------

    def say(self, **changes: Any) -> int:
        """Write a new edition of the own record; returns its number."""
        self.record = msgspec.structs.replace(
            self.record, number=self.record.number + 1, **changes
        )
        self.book.hear(self.record)
        return self.record.number

    async def gossip(self) -> None:
        """Merge what the neighbours know, tell them what is known here; for good."""
        while True:
            try:
                neighbors = self.links().neighbors(self.id)
                self.hear(
                    await self.communicator.asynchronous_receive(
                        neighbors, channel=BOOK
                    )
                )
                self._write_off(
                    await self.communicator.asynchronous_receive(
                        neighbors, channel=FAILED
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
            letter, self.links().neighbors(self.id), channel=BOOK
        )

    def letter(self) -> bytes:
        """The book for the neighbours; the tasks only if one of them has others."""
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
        """Merge the letters of neighbours, by robot. Who hears of another life of its own says that this is later."""
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
        """Say for neighbours whose missions have failed that they are out: they may have had no last words of it.

        Once: who is started again is another one.
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
        """Count what robot i said that is no book."""
        if not self.dropped:
            log.warning("drone %d: from drone %d, dropped: %s", self.id, i, error)
        self.dropped += 1

    async def farewell(self) -> None:
        """Stay until all know that the team has ended, or FAREWELL s are over; beside `gossip`."""
        self.say(ended=True)
        ends = self.clock.now() + FAREWELL
        while self.clock.now() < ends and not all(
            r.ended for r in self.book.alive(self.members).values()
        ):
            await self._pause()
        await self._pause()  # the last to know is told that all do
        await self._pause()

    async def last_words(self) -> None:
        """This robot flies no more, and the others should know."""
        self.say(out=True)
        for _ in range(LAST):
            try:
                await self._tell()
            except RosterChanged:
                continue
            await self._pause()

    async def left_alone(
        self, bound: float, busy: Callable[[], bool] = lambda: False
    ) -> str:
        """Wait until, for `bound` s in which this robot was not busy, nobody has decided for it; returns why.

        That is the end of who is out, or has nothing to do, and would wait for ever for others who are gone.
        """
        since = self.clock.now()
        while not (why := self.alone) or busy() or self.clock.now() <= since + bound:
            if not why or busy():
                since = self.clock.now()
            await self._pause()
        return f"{why} for {bound:g} s"

    async def _pause(self) -> None:
        await self.clock.sleep(self.period, drone=self.id)

    # What is known --------------------------------------------------------------------------------------------

    @property
    def members(self) -> tuple[int, ...]:
        """The team of the present epoch."""
        return self.communicator.graph.at(0).ids

    def alive_ids(self) -> tuple[int, ...]:
        """The members that still fly."""
        return tuple(self.book.alive(self.members))

    def standings(self) -> dict[int, Standing]:
        """Each task as it stands, as far as it is known here."""
        return self.book.standings(self.members, self.recover)

    def known(self, number: int) -> bool:
        """Whether more than half of the team, without those who are out, know that edition of the record.

        Never in a part that is cut off: each of its robots alone is more than half of that.
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
        """Whether the team has agreed to end."""
        return any(record.ended for record in self.book.alive(self.members).values())

    @property
    def alone(self) -> str:
        """Why nobody that this robot hears decides anything; empty if somebody does, or all have ended.

        Who flies decides, in a part that may. A part with less than half never agrees on the team without the others.
        """
        flying = self.book.alive(self.members)
        now = self.clock.now()
        heard = [
            i
            for i in self.members
            if i == self.id or now <= self._heard.get(i, -inf) + SILENT
        ]
        missing = [
            i
            for i in self.members
            if i not in heard and i not in self.book.out(self.members)
        ]
        if self.ended:
            return ""
        if not self.quorate or len(heard) <= len(missing):
            return UNREACHED
        return "" if any(i in flying for i in heard) else NOBODY

    # The team -------------------------------------------------------------------------------------------------

    def key(self) -> Key:
        """The present one."""
        return self.communicator.epoch, self.book.out(self.members)

    def links(self, without: tuple[int, ...] = ()) -> Graph:
        """Who talks to whom, mended where those who are gone have left it in parts."""
        return mended(self.communicator.graph.at(0), without)

    @property
    def quorate(self) -> bool:
        """Whether this part of the team may decide: if it is more than half of the last team that could.

        Of two halves it is the one with the lowest id.
        """
        team = self._team or self.members
        stayed = [i for i in team if i in self.members]
        return 2 * len(stayed) > len(team) or (
            2 * len(stayed) == len(team) and team[0] in stayed
        )

    def count(self) -> bool:
        """Whether the present team may decide; if so, it is the one of which the next must be more than half."""
        if self.quorate:
            self._team = self.members
            return True
        return False


@lru_cache(maxsize=64)
def mended(graph: Graph, without: tuple[int, ...] = ()) -> Graph:
    """The graph without some, its parts joined in a row by their lowest ids: all compute the same."""
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
