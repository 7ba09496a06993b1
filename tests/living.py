"""Drones of one process, each with its barrier and its communicator, that are killed and started again at will."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from campaign.hosts import hosts
from message_parts import taking_parts

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.message import Message
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.team import graph as graphs
from crazychoir.team.barrier import AgreedMission, Barrier
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph, GraphSequence
from crazychoir.team.messages import Roster, RosterMessage, TeamHeartbeat


@dataclass
class Member:
    """One drone: its barrier, its communicator, and its life that can be cut."""

    barrier: Barrier
    communicator: Communicator
    tasks: list["asyncio.Task[Any]"] = field(default_factory=list)


class Team:
    """Drones that can be killed and started again; on several hosts, drone i is on `buses[i % len(buses)]`."""

    def __init__(
        self,
        clock: Clock,
        graph: Graph,
        buses: list[Bus],
        sequence: GraphSequence | None = None,
    ) -> None:
        self.clock, self.graph, self.sequence = clock, graph, sequence
        self.buses, self.bus = buses, buses[0]
        self.members: dict[int, Member] = {}

    def bus_of(self, i: int) -> Bus:
        return self.buses[i % len(self.buses)]

    def start(
        self,
        i: int,
        incarnation: int = 1,
        mission: str = "abc",
        agreed_keys: Sequence[str] = (),
        seed: int = 0,
        **options: Any,
    ) -> Barrier:
        port = self.bus_of(i).port(i, incarnation)
        barrier = Barrier(
            port,
            self.graph,
            AgreedMission(mission, "1", agreed_keys, seed),
            **options,
        )
        communicator = Communicator(port, self.sequence or self.graph)
        communicator.exchange.follow(barrier)
        member = self.members[i] = Member(barrier, communicator)
        self.run(i, barrier.monitor.run())
        assert member.barrier is barrier
        return barrier

    def run(self, i: int, life: Awaitable[Any]) -> "asyncio.Task[Any]":
        task = asyncio.ensure_future(life)
        self.members[i].tasks.append(task)
        return task

    def kill(self, i: int) -> None:
        for task in self.members.pop(i).tasks:
            task.cancel()
        self.bus_of(i).ports.pop(i).send = lambda *message: (
            None
        )  # what it has yet to repeat dies with it

    def rosters(self) -> dict[int, Roster | None]:
        return {i: member.barrier.roster for i, member in self.members.items()}


async def formed(barriers: list[Barrier]) -> Roster:
    """All have GO."""
    rosters = await asyncio.gather(*(barrier.go() for barrier in barriers))
    return rosters[0]


def team(
    graph: Graph,
    story: Callable[[Team], Awaitable[Any]],
    rules: list[ImpairmentRule] | None = None,
    partitions: list[NetworkPartition] | None = None,
    seed: int = 1,
    sequence: GraphSequence | None = None,
    ahead: tuple[float, ...] = (),
) -> Any:
    """Run a story of them.

    ahead: s that the clock of each host is ahead; none: all are in one process.
    """

    def impairment() -> Impairment:
        return Impairment(seed, rules or [], partitions or [])

    async def main(clock: Clock) -> Any:
        buses = hosts(clock, ahead, impairment) if ahead else [Bus(clock, impairment())]
        it = Team(clock, graph, buses, sequence)
        try:
            return await story(it)
        finally:
            for i in list(it.members):
                it.kill(i)

    return run_virtual(main)


LOSSY = [
    ImpairmentRule({"loss": 0.3, "delay": 0.003, "jitter": 0.01, "duplicate": 0.1})
]


async def settled(t: Team, epoch: int, seconds: float = 20.0) -> Roster:
    """The roster of this epoch (or a later one), when all have the same."""
    ends = t.clock.now() + seconds
    while t.clock.now() < ends:
        rosters = list(t.rosters().values())
        first = rosters[0]
        if (
            first is not None
            and first.epoch >= epoch
            and all(roster == first for roster in rosters)
        ):
            return first
        await t.clock.sleep(0.05)
    raise AssertionError(f"no agreement: {t.rosters()}")


def counting(
    t: Team,
    i: int,
    heard: dict[int, list[tuple[int, ...]]],
    until: float,
    pace: float = 0.0,
) -> Any:
    """Exchange the round's number until some time; `heard` keeps the members that were heard in each round."""

    async def life() -> None:
        await t.members[i].barrier.go()
        c = t.members[i].communicator
        ch = c.open("sum", joinable=True)
        while t.clock.now() < until:
            k = ch.sending
            got = await c.neighbors_exchange(k, channel="sum")
            assert set(got.values()) <= {k}
            heard.setdefault(k, {})[i] = tuple(got)  # type: ignore[call-overload, index]
            if pace:
                await t.clock.sleep(pace)

    return life()


def as_graph_says(graph: Graph, k: int, heard: dict[int, Any], gone: int = -1) -> bool:
    """Return whether each member heard just its neighbours of the graph in round k; member `gone` may be missing."""
    needed = {
        i: tuple(j for j in graph.in_neighbors(i) if j != gone)
        for i in graph.ids
        if i != gone
    }
    return {
        i: tuple(j for j in js if j != gone) for i, js in heard[k].items() if i != gone
    } == needed


class HeldAt:
    """Rounds that are held from one round on."""

    def __init__(self, first_held_round: int) -> None:
        self.first_held_round = first_held_round

    def hold(self) -> int:
        return self.first_held_round


class Alone:
    """Barrier i of `graph`; what it sends to the others is kept in `sent`, and their messages are made by hand."""

    def __init__(self, t: Team, i: int, members: dict[int, int]) -> None:
        self.t, self.barrier, self.port = t, t.start(i), t.bus.ports[i]
        self.sent: list[tuple[int, Any]] = []
        self.numbers = dict.fromkeys(t.graph.ids, 0)
        for j in t.graph.ids:
            if j != i:
                t.bus.port(j).handlers[MESSAGE_TOPICS.roster.number] = taking_parts(
                    self._keep(j)
                )
        self.roster = Roster(1, members, [], False, 0, 0, "abc", "1")
        self.barrier.rosters.adopt(self.roster)

    def _keep(self, j: int) -> Callable[..., None]:
        return lambda source, payload, *rest: self.sent.append((j, decode(payload)))

    def beat(
        self,
        j: int,
        epoch: int,
        checksum: int = 0,
        incarnation: int = 1,
        lost: tuple[int, ...] = (),
        held_for: int = 0,
    ) -> None:
        beat = TeamHeartbeat(
            incarnation,
            epoch,
            checksum,
            (self.barrier.id,),
            lost,
            "abc",
            held_for=held_for,
        )
        self.port.bus.deliver(
            Message(MESSAGE_TOPICS.heartbeat, j, encode(beat.wire()), 1, "heartbeat"),
            (self.port.address,),
            0.0,
        )

    def tell(self, j: int, message: RosterMessage) -> None:
        self.port.bus.deliver(
            Message(MESSAGE_TOPICS.roster, j, message.wire(), self.numbers[j], "1"),
            (self.port.address,),
            0.0,
        )
        self.numbers[j] += 1


def alone(
    i: int, members: dict[int, int], story: Callable[[Alone], Awaitable[None]]
) -> None:
    async def main(t: Team) -> None:
        await story(Alone(t, i, members))

    team(graphs.complete(4), main)
