"""The start barrier and the epochs after it, in virtual time."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from living import LOSSY, Team, as_graph_says, counting, formed, settled, team
from msgspec.structs import replace

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.port import Bus
from crazychoir.bus.presence import SILENCE_TIMEOUT, Presence
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import PeerLost, Refused, RosterChanged
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, run_virtual
from crazychoir.team import graph as graphs
from crazychoir.team.barrier import PRESENCE_HISTORY, Barrier
from crazychoir.team.graph import GraphSequence
from crazychoir.team.messages import GoMessage, Roster, TeamHeartbeat

# GO -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rules",
    [None, LOSSY, [ImpairmentRule({"loss": 0.5})]],
    ids=["good", "lossy", "half"],
)
@pytest.mark.parametrize(
    "graph", [graphs.ring(6), graphs.ring(5, directed=True), graphs.empty(1)], ids="abc"
)
def test_all_are_there_and_go(graph, rules):
    async def story(t: Team) -> float:
        barriers = [t.start(i, incarnation=10 + i, seed=9) for i in graph.ids]
        roster = await formed(barriers)
        assert all(barrier.roster == roster for barrier in barriers)
        assert roster == Roster(
            1,
            {i: 10 + i for i in graph.ids},
            roster.edges,
            not graph.is_undirected,
            9,
            0,
            "abc",
            "1",
        )
        assert roster.graph == graph
        assert all(m.communicator.epoch == 1 for m in t.members.values())
        return t.clock.now()

    assert team(graph, story, rules) < (0.8 if rules is None else 8.0)


def test_go_comes_as_soon_as_the_last_is_there():
    async def story(t: Team) -> float:
        barriers = [t.start(0), t.start(1)]
        t.clock.call_at(3 * 10**9, lambda: t.run(2, t.start(2).go()))
        await formed(barriers)
        return t.clock.now()

    assert 3.0 < team(graphs.path(3), story) < 3.6


def test_at_the_deadline_enough_go_and_the_absent_are_named():
    async def story(t: Team) -> tuple[float, Roster, tuple[int, ...]]:
        barriers = [t.start(i, start=3, start_deadline=4.0) for i in (0, 2, 3)]
        roster = await formed(barriers)
        return t.clock.now(), roster, barriers[1].absent

    at, roster, absent = team(graphs.complete(5), story)
    assert 4.0 <= at < 4.6
    assert roster.ids == (0, 2, 3)
    assert roster.graph == graphs.complete((0, 2, 3))
    assert absent == (1, 4)


def test_who_waits_longest_goes_with_who_coordinates_at_his_deadline():
    async def story(t: Team) -> tuple[float, tuple[int, ...]]:
        longest = asyncio.ensure_future(t.start(2, start=2, start_deadline=4.0).go())
        await t.clock.sleep(3.0)
        roster = await t.start(0, start=2, start_deadline=4.0).go()
        assert await longest == roster
        return t.clock.now(), roster.ids

    at, ids = team(graphs.complete(3), story)
    assert 7.0 <= at < 7.6
    assert ids == (0, 2)


def test_a_coordinator_that_comes_again_is_waited_for_anew():
    async def story(t: Team) -> tuple[float, tuple[int, ...]]:
        longest = asyncio.ensure_future(t.start(2, start=2, start_deadline=6.0).go())
        t.run(0, t.start(0, start=2, start_deadline=6.0).go())
        await t.clock.sleep(3.0)
        t.kill(0)
        await t.clock.sleep(2.0)
        roster = await t.start(0, incarnation=2, start=2, start_deadline=6.0).go()
        assert await longest == roster
        return t.clock.now(), roster.ids

    at, ids = team(graphs.complete(3), story)
    assert 11.0 <= at < 11.6
    assert ids == (0, 2)


@pytest.mark.parametrize("start", ["all", 4])
def test_too_few_are_refused_and_the_absent_are_named(start):
    async def story(t: Team) -> float:
        barriers = [t.start(i, start=start, start_deadline=4.0) for i in (0, 2, 3)]
        for found in await asyncio.gather(
            *(b.go() for b in barriers), return_exceptions=True
        ):
            assert isinstance(found, Refused)
            advice = {
                "all": "Start their agents, look at the network, or set start = n in the swarm file.",
                4: "Start their agents, look at the network, or lower start = 4 in the swarm file.",
            }[start]
            assert str(found).endswith(f"drone(s) 1, 4 absent after 4 s. {advice}")
        return t.clock.now()

    assert team(graphs.complete(5), story) < 6.0


REFUSAL = "drone 1: parameter ring.effect = 700; allowed: 0 to 255"
TOLD = "drone 1 cannot fly: parameter ring.effect = 700; allowed: 0 to 255. "


def refuse(barrier: Barrier) -> None:
    """Its drone cannot fly."""
    barrier.monitor.silent, barrier.refused = False, REFUSAL


@pytest.mark.parametrize(
    ("start", "do"), [("all", "set start = n"), (4, "lower start = 4")]
)
def test_nobody_waits_for_one_that_cannot_fly_if_all_others_are_too_few(start, do):
    async def story(t: Team) -> float:
        barriers = [t.start(i, start=start) for i in range(4)]
        barriers[1].monitor.silent = True
        t.clock.call_at(3 * NS_PER_SECOND, refuse, barriers[1])
        waiting = [b.go() for b in barriers if b.id != 1]
        for found in await asyncio.gather(*waiting, return_exceptions=True):
            assert isinstance(found, Refused)
            assert str(found).endswith(
                f"{TOLD}Correct that, or {do} in the swarm file."
            )
        return t.clock.now()

    assert 3.0 <= team(graphs.path(4), story) < 3.5


def test_those_who_suffice_go_without_one_that_cannot_fly_and_it_may_join_when_it_can():
    async def story(t: Team) -> tuple[float, Roster]:
        barriers = [t.start(i, start=3, start_deadline=4.0) for i in range(4)]
        refuse(barriers[1])
        first = await formed([b for b in barriers if b.id != 1])
        assert first.ids == (0, 2, 3)
        at = t.clock.now()
        t.kill(1)
        t.start(1, incarnation=2)
        return at, await settled(t, 2)

    at, roster = team(graphs.complete(4), story)
    assert 4.0 <= at < 4.6
    assert roster.ids == (0, 1, 2, 3)


def test_one_that_cannot_fly_is_named_beside_the_absent():
    async def story(t: Team) -> str:
        barriers = [t.start(i, start=3, start_deadline=4.0) for i in (0, 1, 3)]
        refuse(barriers[1])
        with pytest.raises(Refused) as found:
            await barriers[0].go()
        return str(found.value)

    assert f"drone(s) 2 absent after 4 s. {TOLD}Start their agents" in team(
        graphs.complete(4), story
    )


@pytest.mark.parametrize("edge", [(1, 2), (2, 1), (3, 0), (0, 3)], ids=str)
def test_a_deaf_edge_is_not_go(edge):
    """(1, 2) is an edge of the path; 3 and 0 are none, but 0 coordinates."""

    async def story(t: Team) -> str:
        barriers = [t.start(i, start_deadline=4.0) for i in range(4)]
        found = await asyncio.gather(
            *(b.go() for b in barriers), return_exceptions=True
        )
        assert all(isinstance(error, Refused) for error in found)
        return str(found[0])

    text = team(
        graphs.path(4), story, [ImpairmentRule({"loss": 1.0}, edge=edge, directed=True)]
    )
    if edge == (3, 0):
        assert "drone(s) 3 absent" in text
    else:
        assert f"drone {edge[1]} does not hear drone {edge[0]}." in text


def test_a_directed_edge_need_not_carry_backwards():
    async def story(t: Team) -> Roster:
        return await formed([t.start(i, start_deadline=4.0) for i in range(4)])

    rule = ImpairmentRule({"loss": 1.0}, edge=(3, 2), directed=True)
    assert team(graphs.ring(4, directed=True), story, [rule]).graph == graphs.ring(
        4, directed=True
    )


@pytest.mark.parametrize(
    ("foreign", "start"), [((2,), 3), ((0,), 3), ((1, 3), 2), ((0, 2, 3), "all")]
)
def test_the_minority_with_another_mission_is_refused(foreign, start):
    """Of two and two, those with the lowest id are right."""

    async def story(t: Team) -> dict[int, Any]:
        barriers = {
            i: t.start(
                i,
                mission="xyz" if i in foreign else "abc",
                start=start,
                start_deadline=5.0,
            )
            for i in range(4)
        }
        found = await asyncio.gather(
            *(b.go() for b in barriers.values()), return_exceptions=True
        )
        return dict(zip(barriers, found, strict=True))

    found = team(graphs.complete(4), story, LOSSY)
    right = {(2,): (0, 1, 3), (0,): (1, 2, 3), (1, 3): (0, 2), (0, 2, 3): (0, 2, 3)}[
        foreign
    ]
    mine = {i: "xyz" if i in foreign else "abc" for i in range(4)}
    for i, result in found.items():
        if i in right and start != "all":
            assert result.ids == right
            continue
        other = next(j for j in range(4) if mine[j] != mine[i])
        assert isinstance(result, Refused)
        assert f"its swarm file or mission ({mine[i]}) is not that of" in str(result)
        assert f"drone {other} ({mine[other]})" in str(result)
        assert "Copy one swarm file and one mission to every host." in str(result)


def test_strange_heartbeats_and_rosters_are_counted():
    async def story(t: Team) -> int:
        barrier = t.start(0, start_deadline=1.0)
        port = t.bus.ports[0]
        strange = [
            b"",
            b"\xff",
            encode(None),
            encode([1, 2]),
            encode([1, 2, 3, 4, 5, "abc", ""]),
            encode(["x", 0, 0, [], [], "", ""]),
        ]
        for payload in strange:
            port.deliver(MESSAGE_TOPICS.heartbeat.number, 1, payload, 1, "", 0, 0.0)
        for n, payload in enumerate(
            [*strange[:3], encode({"epoch": 1}), encode(["x"])]
        ):
            port.deliver(MESSAGE_TOPICS.roster.number, 1, payload, n, "1", 0, 0.0)
        port.deliver(
            MESSAGE_TOPICS.heartbeat.number,
            77,
            encode([1, 1, 0, [], [], "abc", ""]),
            1,
            "",
            0,
            0.0,
        )
        assert not barrier.beats
        return port.counters.malformed

    assert team(graphs.path(2), story) == 11


# Epochs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rules", [None, LOSSY], ids=["good", "lossy"])
@pytest.mark.parametrize("gone", [0, 2, 5])
def test_a_lost_member_makes_a_new_epoch_whoever_it_is(gone, rules):
    async def story(t: Team) -> Roster:
        await formed([t.start(i) for i in range(6)])
        await t.clock.sleep(1.0)
        t.kill(gone)
        before = t.clock.now()
        roster = await settled(t, 2)
        assert 5.0 < t.clock.now() - before < 9.0
        assert all(member.barrier.lost(gone) for member in t.members.values())
        assert {member.barrier.coordinator() for member in t.members.values()} == {
            min(t.members)
        }
        assert all(
            member.communicator.graph == roster.graph for member in t.members.values()
        )
        return roster

    roster = team(graphs.ring(6), story, rules)
    assert roster.epoch == 2
    assert roster.ids == tuple(i for i in range(6) if i != gone)
    assert roster.graph.arcs == tuple(
        arc for arc in graphs.ring(6).arcs if gone not in arc
    )


def test_two_coordinators_in_a_row_are_lost():
    async def story(t: Team) -> Roster:
        await formed([t.start(i) for i in range(5)])
        t.kill(0)
        t.kill(1)
        return await settled(t, 2, 40.0)

    assert team(graphs.ring(5), story).ids == (2, 3, 4)


@pytest.mark.parametrize("rules", [None, LOSSY], ids=["good", "lossy"])
@pytest.mark.parametrize("apart", [0.0, 0.6, 2.0, 3.5])
@pytest.mark.parametrize(
    "gone", [(0, 1), (1, 0), (0, 1, 2, 3), (3, 2, 1, 0), (4, 0, 2, 1)], ids=str
)
def test_however_many_are_lost_the_others_go_on(gone, apart, rules):
    n = 3 if len(gone) == 2 else 5

    async def story(t: Team) -> Roster:
        await formed([t.start(i, lost_after=1.0) for i in range(n)])
        await t.clock.sleep(2.0)
        for i in gone:
            t.kill(i)
            last = t.clock.now()
            await t.clock.sleep(apart)
        while any(
            roster.ids != tuple(t.members) for roster in t.rosters().values() if roster
        ):
            await t.clock.sleep(0.05)
            assert t.clock.now() < last + 6.0, t.rosters()
        return await settled(t, 2, 1.0)

    assert team(graphs.complete(n), story, rules).ids == tuple(
        i for i in range(n) if i not in gone
    )


@pytest.mark.parametrize("rules", [None, LOSSY], ids=["good", "lossy"])
@pytest.mark.parametrize(
    ("again", "pause"), [(0, 0.1), (0, 2.0), (3, 0.1), (3, 2.0), (0, 8.0), (3, 8.0)]
)
def test_a_restarted_member_joins_with_a_new_epoch(again, pause, rules):
    async def story(t: Team) -> Roster:
        await formed([t.start(i) for i in range(5)])
        await t.clock.sleep(1.0)
        t.kill(again)
        await t.clock.sleep(pause)
        joining = t.start(again, incarnation=2)
        assert await joining.go() == joining.roster
        return await settled(t, 2)

    roster = team(graphs.ring(5), story, rules)
    assert roster.members == {i: 2 if i == again else 1 for i in range(5)}
    assert roster.epoch == (2 if pause < 5.0 else 3)


def test_one_who_comes_late_joins():
    async def story(t: Team) -> tuple[Roster, Roster]:
        first = await formed([t.start(i, start=2, start_deadline=1.0) for i in (1, 2)])
        await t.clock.sleep(3.0)
        await t.start(0).go()
        return first, await settled(t, 2)

    first, second = team(graphs.path(3), story, LOSSY)
    assert (first.ids, second.ids, second.epoch) == ((1, 2), (0, 1, 2), 2)


def test_a_roster_for_an_earlier_life_is_not_taken():
    """The coordinator's resends may reach a drone that has been started again."""

    async def story(t: Team) -> Roster | None:
        barrier = t.start(1, incarnation=2)
        old = Roster(1, {0: 1, 1: 1}, [[0, 1]], False, 0, 0, "abc", "1")
        t.bus.ports[1].deliver(
            MESSAGE_TOPICS.roster.number, 0, GoMessage(old).wire(), 0, "1", 0, 0.0
        )
        t.bus.ports[1].deliver(
            MESSAGE_TOPICS.roster.number,
            0,
            GoMessage(replace(old, members={0: 1, 1: 2}, mission_hash="x")).wire(),
            1,
            "1",
            0,
            0.0,
        )
        assert barrier.roster is None
        t.bus.ports[1].deliver(
            MESSAGE_TOPICS.roster.number,
            0,
            GoMessage(replace(old, members={0: 1, 1: 2})).wire(),
            2,
            "1",
            0,
            0.0,
        )
        return barrier.roster

    assert team(graphs.path(2), story) == Roster(
        1, {0: 1, 1: 2}, [[0, 1]], False, 0, 0, "abc", "1"
    )


@pytest.mark.parametrize("seed", [1, 200, 213])
@pytest.mark.parametrize("slow", [(0, 1, 2), (3, 4, 5)], ids=str)
def test_two_halves_that_were_apart_for_long_come_together_again(slow, seed):
    """A joinable algorithm goes on in both, at different paces; the slower half catches up first."""

    async def story(
        t: Team,
    ) -> tuple[dict[int, tuple[int, ...]], Roster, dict[int, Any]]:
        heard: dict[int, Any] = {}
        barriers = [t.start(i) for i in range(6)]
        lives = [
            t.run(i, counting(t, i, heard, 60.0, 0.06 if i in slow else 0.02))
            for i in range(6)
        ]
        await formed(barriers)
        await t.clock.sleep(20.0)
        apart = {i: roster.ids for i, roster in t.rosters().items() if roster}
        await t.clock.sleep(10.0)
        roster = await settled(t, 3)
        await t.clock.sleep(15.0)
        assert not [life for life in lives if life.done() and life.exception()]
        return apart, roster, heard

    apart, roster, heard = team(
        graphs.ring(6), story, LOSSY, [NetworkPartition(5.0, 17.0, (0, 1, 2))], seed
    )
    assert apart in (
        {i: tuple(range(6)) for i in range(6)},
        {i: (0, 1, 2) if i < 3 else (3, 4, 5) for i in range(6)},
    )
    assert roster.ids == tuple(range(6))
    assert roster.graph == graphs.ring(6)
    assert roster.epoch >= 3
    last = max(heard) - 3
    assert last > roster.first_round + 5
    for k in range(roster.first_round, last):
        assert as_graph_says(roster.graph, k, heard), (k, roster, heard[k])


def test_one_who_dies_while_two_halves_come_together_is_left_out():
    async def story(t: Team) -> Roster:
        await formed([t.start(i) for i in range(6)])
        await t.clock.sleep(18.0)
        t.kill(4)
        await t.clock.sleep(12.0)
        return await settled(t, 3)

    assert team(
        graphs.ring(6), story, LOSSY, [NetworkPartition(5.0, 20.3, (0, 1, 2))]
    ).ids == (0, 1, 2, 3, 5)


@pytest.mark.parametrize("gap", [0.0, 0.6, 3.5])
@pytest.mark.parametrize("rules", [None, LOSSY], ids=["good", "lossy"])
@pytest.mark.parametrize(
    "dead", [(0, 1), (1, 0), (0, 1, 2, 3), (3, 2, 1, 0), (4, 0, 2, 1)]
)
def test_whoever_dies_one_after_another_the_rest_go_on_without_them(dead, rules, gap):
    """Each of them may have coordinated; those who were lost before are nobody's to report any more."""

    async def story(t: Team) -> Roster:
        await formed([t.start(i) for i in range(5)])
        for i in dead:
            t.kill(i)
            await t.clock.sleep(gap)
        await t.clock.sleep(20.0)
        return await settled(t, 2)

    assert team(graphs.complete(5), story, rules).ids == tuple(
        i for i in range(5) if i not in dead
    )


@pytest.mark.parametrize("alone", [(2,), (0,), (1, 3), (2, 3)])
def test_whoever_was_without_the_others_exchanges_with_them_again(alone):
    """The rounds in which they were apart are not waited for: nobody has them any more."""

    async def story(t: Team) -> tuple[Roster, dict[int, Any], int]:
        await formed([t.start(i) for i in range(5)])
        heard: dict[int, Any] = {}
        for i in range(5):
            t.run(i, counting(t, i, heard, 40.0, 0.02))
        await t.clock.sleep(5.0)
        t.kill(4)
        await t.clock.sleep(25.0)
        roster = await settled(t, 2)
        await t.clock.sleep(2.0)
        return roster, heard, max(k for k, by in heard.items() if len(by) == 4)

    roster, heard, last = team(
        graphs.ring(5), story, LOSSY, [NetworkPartition(3.0, 18.0, alone)]
    )
    assert roster.ids == (0, 1, 2, 3)
    assert last > roster.first_round
    for k in range(roster.first_round, last + 1):
        assert as_graph_says(roster.graph, k, heard), (k, roster, heard[k])


def test_a_short_partition_changes_nothing():
    async def story(t: Team) -> Roster:
        await formed([t.start(i) for i in range(4)])
        await t.clock.sleep(12.0)
        return await settled(t, 1)

    assert (
        team(graphs.ring(4), story, None, [NetworkPartition(2.0, 6.0, (0, 1))]).epoch
        == 1
    )


def test_partitions_count_from_go_however_long_it_took():
    """They cut nobody while the last is waited for; then from second 2 to 4 after GO."""

    async def story(t: Team) -> tuple[float, list[float]]:
        barriers = [t.start(0), t.start(1)]
        t.clock.call_at(7 * 10**9, lambda: t.run(2, t.start(2).go()))
        await formed(barriers)
        went, silent, port = t.clock.now(), [], t.bus.ports[0]
        while t.clock.now() < went + 8.0:
            await t.clock.sleep(0.05)
            if t.clock.now_ns() - port.heard_ns[1] > 0.3 * 10**9:
                silent.append(t.clock.now() - went)
        return went, silent

    went, silent = team(graphs.path(3), story, None, [NetworkPartition(2.0, 4.0, (1,))])
    assert went > 7.0
    assert 2.0 <= silent[0] <= 2.4
    assert 3.9 <= silent[-1] <= 4.3


@pytest.mark.parametrize("again", [0, 2])
def test_who_comes_again_in_a_process_of_its_own_is_told_the_age_of_the_mission(again):
    """Two buses, as of two processes; that of the one who comes again has heard of no GO."""

    async def main(clock: Clock) -> list[float]:
        ids, graph = (0, 1, 2), graphs.path(3)
        buses = {i: Bus(clock) for i in ids}

        class Wire:
            def forward(self, topic, source, to, payload, number, channel, flags, age):
                for j in to:
                    if j in buses[j].ports:
                        buses[j].ports[j].deliver(
                            topic.number, source, payload, number, channel, flags, age
                        )

            def interested(self) -> None: ...

        def start(i: int, incarnation: int) -> Barrier:
            buses[i].forwarder = Wire()
            barrier = Barrier(
                buses[i].port(i, incarnation), graph, mission_hash="abc", version="1"
            )
            lives[i] = asyncio.ensure_future(barrier.monitor.run())
            return barrier

        lives: dict[int, asyncio.Task[None]] = {}
        await formed([start(i, 1) for i in ids])
        await clock.sleep(10.0)
        lives[again].cancel()
        buses[again] = Bus(clock)
        assert buses[again].impairment.age(clock.now()) == 0.0
        await start(again, 2).go()
        ages = [bus.impairment.age(clock.now()) for bus in buses.values()]
        for life in lives.values():
            life.cancel()
        return ages

    ages = run_virtual(main)
    assert ages[again] > 10.0
    assert max(ages) - min(ages) < 0.05


def test_only_the_newest_changes_of_presence_are_kept():
    async def story(t: Team) -> list[tuple[float, int, str]]:
        barrier = t.start(0)
        for n in range(PRESENCE_HISTORY + 5):
            barrier._changed(n, Presence.SUSPECT)
        return barrier.history

    kept = team(graphs.path(2), story)
    assert [j for _, j, _ in kept] == list(range(5, PRESENCE_HISTORY + 5))


# One barrier alone, and what it is told ------------------------------------------------------------------------------


class Alone:
    """Barrier i of `graph`; what it sends to the others is kept in `sent`, and their messages are made by hand."""

    def __init__(self, t: Team, i: int, members: dict[int, int]) -> None:
        self.t, self.barrier, self.port = t, t.start(i), t.bus.ports[i]
        self.sent: list[tuple[int, Any]] = []
        self.numbers = dict.fromkeys(t.graph.ids, 0)
        for j in t.graph.ids:
            if j != i:
                t.bus.port(j).handlers[MESSAGE_TOPICS.roster.number] = self._keep(j)
        self.roster = Roster(1, members, [], False, 0, 0, "abc", "1")
        self.barrier._adopt(self.roster)

    def _keep(self, j: int) -> Callable[..., None]:
        return lambda source, payload, *rest: self.sent.append((j, decode(payload)))

    def beat(
        self,
        j: int,
        epoch: int,
        checksum: int = 0,
        incarnation: int = 1,
        lost: tuple[int, ...] = (),
    ) -> None:
        beat = TeamHeartbeat(
            incarnation, epoch, checksum, (self.barrier.id,), lost, "abc"
        )
        self.port.deliver(
            MESSAGE_TOPICS.heartbeat.number,
            j,
            encode(beat.wire()),
            1,
            "heartbeat",
            0,
            0.0,
        )

    def tell(self, j: int, value: list[int]) -> None:
        self.port.deliver(
            MESSAGE_TOPICS.roster.number, j, encode(value), self.numbers[j], "1", 0, 0.0
        )
        self.numbers[j] += 1


def alone(
    i: int, members: dict[int, int], story: Callable[[Alone], Awaitable[None]]
) -> None:
    async def main(t: Team) -> None:
        await story(Alone(t, i, members))

    team(graphs.complete(4), main)


def test_who_coordinates_does_not_hold_for_a_higher_one():
    async def story(it: Alone) -> None:
        it.barrier.hold = lambda: 7
        it.tell(2, [2])
        assert it.sent == []
        it.tell(0, [2])
        assert it.sent == [(0, [2, 7, 1, 1, 2, 1])]
        it.tell(0, [1])
        assert len(it.sent) == 1, "nobody holds for an epoch that is past"

    alone(1, {1: 1, 2: 1}, story)


def test_a_proposal_gives_way_to_that_of_a_lower_id():
    async def story(it: Alone) -> None:
        it.beat(3, 1)
        assert it.sent == [(2, [2]), (3, [2])]
        it.tell(0, [2])
        it.tell(2, [2, 5])
        it.tell(3, [2, 5])
        assert it.barrier.roster == it.roster

    alone(1, {1: 1, 2: 1}, story)


def test_a_lower_id_of_another_half_is_left_to_coordinate():
    async def story(it: Alone) -> None:
        it.beat(0, 4)
        assert it.sent == []
        it.beat(0, 0)
        assert it.sent[0] == (2, [2]), "but a newcomer is taken in"

    alone(1, {1: 1, 2: 1}, story)


def test_a_newcomer_leaves_coordinating_to_those_who_fly():
    async def story(t: Team) -> None:
        barrier = t.start(0)
        t.bus.ports[0].deliver(
            MESSAGE_TOPICS.heartbeat.number,
            2,
            encode(TeamHeartbeat(1, 3, 0, (), (), "abc").wire()),
            1,
            "",
            0,
            0.0,
        )
        barrier.monitor.tick()
        assert barrier.coordinator() == 2

    team(graphs.complete(3), story)


def test_the_next_roster_counts_from_a_round_that_nobody_has_sent():
    async def story(it: Alone) -> None:
        it.barrier.hold = lambda: 3
        it.beat(3, 0, incarnation=8)
        it.tell(1, [2, 12])
        assert it.barrier.roster == it.roster
        it.tell(2, [2, 10])
        assert it.barrier.roster == replace(
            it.roster,
            epoch=2,
            members={0: 1, 1: 1, 2: 1, 3: 8},
            first_round=13,
            edges=EDGES,
        )

    EDGES = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    alone(0, {0: 1, 1: 1, 2: 1}, story)


def test_another_half_comes_whole_or_without_those_who_never_answer():
    async def story(it: Alone) -> None:
        it.beat(2, 1)
        it.tell(2, [2, 10, 2, 1, 3, 1])
        assert it.sent == [(2, [2]), (3, [2])]
        for _ in range(40):
            assert it.barrier.roster == it.roster, "3 runs, and does not hold yet"
            it.beat(2, 1)
            await it.t.clock.sleep(0.12)
        await it.t.clock.sleep(0.5)
        it.beat(2, 1)
        roster = it.barrier.roster
        assert roster is not None
        assert (roster.ids, roster.first_round) == ((0, 2), 11)

    alone(0, {0: 1}, story)


def test_a_graph_that_comes_apart_is_told_until_it_is_mended():
    async def story(t: Team) -> None:
        for i in range(5):
            t.start(i, lost_after=1.0)
        await formed([member.barrier for member in t.members.values()])
        assert [member.barrier.apart for member in t.members.values()] == [""] * 5
        t.kill(2)
        await settled(t, 2)
        assert {member.barrier.apart for member in t.members.values()} == {
            "graph in 2 parts: 0 1 | 3 4"
        }
        t.start(2, incarnation=2)
        await settled(t, 3)
        assert {member.barrier.apart for member in t.members.values()} == {""}

    team(graphs.path(5), story)


def test_who_never_answers_is_given_up_though_nobody_else_is_heard():
    """1 has never been heard, as by one who came just after 1 was killed."""

    async def story(it: Alone) -> None:
        it.barrier._changed(0, Presence.LOST)
        assert it.sent == [(1, [2])]
        await it.t.clock.sleep(5.5)
        assert it.barrier.roster is not None
        assert it.barrier.roster.ids == (2,)

    alone(2, {0: 1, 1: 1, 2: 1}, story)


def test_rosters_of_two_coordinators_are_replaced():
    async def story(it: Alone) -> None:
        it.beat(1, 1, it.roster.checksum)
        assert it.sent == []
        it.beat(1, 1, it.roster.checksum + 1)
        assert it.sent == [(1, [2])]
        it.tell(1, [2, 0])
        assert it.barrier.roster is not None
        assert it.barrier.roster.epoch == 2
        it.beat(1, 6)
        assert it.sent[-1] == (1, [7])

    alone(0, {0: 1, 1: 1}, story)


def test_who_has_not_held_is_asked_again_with_each_heartbeat():
    async def story(it: Alone) -> None:
        it.beat(2, 0)
        it.barrier.reliable.forget(1)
        assert it.sent == [(1, [2])]
        it.beat(1, 1, it.roster.checksum)
        assert it.sent == [(1, [2]), (1, [2])]

    alone(0, {0: 1, 1: 1}, story)


def test_who_watches_us_hears_us():
    async def story(t: Team) -> None:
        graph = graphs.path(4)
        barrier = Barrier(t.bus.port(3), graph, mission_hash="abc", version="1")
        barrier._adopt(
            Roster(1, dict.fromkeys(range(4), 1), [], False, 0, 0, "abc", "1")
        )
        barrier.monitor.watched = (0, 2)
        beat = encode(
            TeamHeartbeat(1, 1, barrier.roster.checksum, (), (), "abc").wire()
        )
        t.bus.ports[3].deliver(MESSAGE_TOPICS.heartbeat.number, 1, beat, 1, "", 0, 0.0)
        assert barrier.monitor.watched == (0, 2), (
            "it has just heard of GO itself, and will watch fewer"
        )
        await t.clock.sleep(1.5 * SILENCE_TIMEOUT)
        for number in (2, 3):  # the second one says nothing new
            t.bus.ports[3].deliver(
                MESSAGE_TOPICS.heartbeat.number, 1, beat, number, "", 0, 0.0
            )
        assert barrier.monitor.watched == (0, 2, 1)

    team(graphs.path(4), story)


def test_one_who_was_lost_and_begins_again_is_not_lost():
    async def story(it: Alone) -> None:
        it.barrier._changed(2, Presence.LOST)
        it.barrier._changed(3, Presence.LOST)
        assert it.barrier.lost(2)
        it.barrier._adopt(replace(it.roster, epoch=2, members={0: 1, 1: 1, 2: 9, 3: 1}))
        assert not it.barrier.lost(2)
        assert it.barrier.lost(3), "a neighbour whom only we do not hear"

    alone(1, {0: 1, 1: 1, 2: 1, 3: 1}, story)


# Algorithms across epochs -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rules", [[ImpairmentRule({"delay": 0.01})], LOSSY], ids=["good", "lossy"]
)
@pytest.mark.parametrize("gone", [0, 3])
def test_a_joinable_algorithm_goes_on_without_the_lost(gone, rules):
    graph = graphs.k_regular(6, 4)

    async def story(t: Team) -> tuple[Roster, dict[int, Any]]:
        heard: dict[int, Any] = {}
        barriers = [t.start(i) for i in range(6)]
        lives = {i: t.run(i, counting(t, i, heard, 20.0)) for i in range(6)}
        await formed(barriers)
        t.clock.call_at(3 * 10**9, t.kill, gone)
        await t.clock.sleep(19.0)
        roster = await settled(t, 2)
        await asyncio.sleep(2.0)
        errors = [
            life.exception() for i, life in lives.items() if i != gone and life.done()
        ]
        assert not any(errors), errors
        return roster, heard

    roster, heard = team(graph, story, rules)
    first, last = roster.first_round, max(heard) - 2
    assert last > first + 100
    assert first > 20
    for k in range(last):
        inside = graph if k < first else roster.graph
        assert as_graph_says(inside, k, heard, gone), (k, first, heard[k])
    assert all(len(heard[k]) == 5 for k in range(first, last))


@pytest.mark.parametrize(
    "rules",
    [None, [ImpairmentRule({"delay": 0.01})], LOSSY],
    ids=["good", "slow", "lossy"],
)
@pytest.mark.parametrize("late", [0, 4])
def test_one_who_joins_takes_part_from_the_same_round_for_all(late, rules):
    graph = graphs.ring(5)
    rest = tuple(i for i in range(5) if i != late)

    async def story(t: Team) -> tuple[Roster, Roster, dict[int, Any]]:
        heard: dict[int, Any] = {}
        pace = 0.0 if rules else 0.001
        barriers = [t.start(i, start=4, start_deadline=1.0) for i in rest]
        lives = [t.run(i, counting(t, i, heard, 8.0, pace)) for i in rest]
        first = await formed(barriers)
        await t.clock.sleep(2.0)
        t.start(late)
        lives.append(t.run(late, counting(t, late, heard, 8.0, pace)))
        second = await settled(t, 2)
        await t.clock.sleep(5.0)
        assert not [life for life in lives if life.done() and life.exception()]
        return first, second, heard

    first, second, heard = team(graph, story, rules)
    begin, last = second.first_round, max(heard) - 4
    assert 20 < begin < last - 20
    for k in range(last):
        assert as_graph_says(first.graph if k < begin else second.graph, k, heard), (
            k,
            begin,
            heard[k],
        )


def test_a_sequence_of_graphs_goes_on_among_those_who_stay():
    whole = graphs.complete(4)
    sequence = GraphSequence((graphs.ring(4), whole, graphs.path(4)))

    async def story(t: Team) -> tuple[Roster, dict[int, Any]]:
        heard: dict[int, Any] = {}
        barriers = [t.start(i) for i in range(4)]
        for i in range(4):
            t.run(i, counting(t, i, heard, 20.0))
        await formed(barriers)
        t.clock.call_at(3 * 10**9, t.kill, 2)
        await t.clock.sleep(15.0)
        return await settled(t, 2), heard

    roster, heard = team(
        whole, story, [ImpairmentRule({"delay": 0.01})], sequence=sequence
    )
    k = next(k for k in range(roster.first_round + 3, max(heard)) if k % 3 == 0)
    assert [heard[k + n] for n in range(3)] == [
        {0: (1, 3), 1: (0,), 3: (0,)},
        {0: (1, 3), 1: (0, 3), 3: (0, 1)},
        {0: (1,), 1: (0,), 3: ()},
    ]


def test_what_is_not_joinable_ends_and_begins_again():
    async def story(t: Team) -> list[Any]:
        ends: dict[int, Any] = {}

        async def life(i: int) -> None:
            await t.members[i].barrier.go()
            c = t.members[i].communicator
            try:
                while True:
                    await c.neighbors_exchange(i)
                    await t.clock.sleep(0.01)
            except (PeerLost, RosterChanged) as error:
                ends[i] = error
            roster = await settled(t, 2)
            if not isinstance(ends[i], RosterChanged):
                with pytest.raises(RosterChanged):
                    await c.neighbors_exchange(i)
            assert roster.epoch == c.epoch == 2
            ends[i] = [await c.neighbors_exchange(10 * k + i) for k in range(3)]

        barriers = [t.start(i) for i in range(4)]
        lives = [t.run(i, life(i)) for i in range(4)]
        await formed(barriers)
        await t.clock.sleep(1.0)
        t.kill(3)
        await asyncio.gather(*lives[:3])
        return [ends[i] for i in range(3)]

    found = team(graphs.path(4), story, LOSSY)
    assert found == [
        [{1: 1}, {1: 11}, {1: 21}],
        [{0: 0, 2: 2}, {0: 10, 2: 12}, {0: 20, 2: 22}],
        [{1: 1}, {1: 11}, {1: 21}],
    ]


def test_who_holds_is_let_go_by_the_next_coordinator():
    """The coordinator dies after it has asked for HOLD, before it issues the roster."""

    async def story(t: Team) -> Roster:
        heard: dict[int, Any] = {}
        barriers = [t.start(i, start=3, start_deadline=1.0) for i in range(3)]
        for i in range(3):
            t.run(i, counting(t, i, heard, 30.0))
        await formed(barriers)
        barriers[0]._conclude = lambda: None  # type: ignore[method-assign]
        t.start(3)
        await t.clock.sleep(2.0)
        held = [t.members[i].communicator.hold() for i in (1, 2)]
        stalled = max(heard)
        await t.clock.sleep(1.0)
        assert max(heard) == stalled <= max(held)
        t.kill(0)
        t.run(3, counting(t, 3, heard, 30.0))
        roster = await settled(t, 2)
        assert roster.first_round > max(held)
        await t.clock.sleep(1.0)
        assert max(heard) > stalled + 10
        return roster

    assert team(graphs.complete(4), story, [ImpairmentRule({"delay": 0.01})]).ids == (
        1,
        2,
        3,
    )
