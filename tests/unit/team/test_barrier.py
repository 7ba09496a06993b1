"""A team from its start through its epochs, in virtual time."""

import asyncio
from typing import Any

import pytest
from living import LOSSY, Team, as_graph_says, counting, formed, settled, team

from crazychoir.bus.codec import encode
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.message import Message
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import PeerLost, RosterChanged
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.team import graph as graphs
from crazychoir.team.barrier import AgreedMission, Barrier
from crazychoir.team.close_drones import CLOSE_DRONES
from crazychoir.team.graph import GraphSequence
from crazychoir.team.messages import (
    Roster,
)


def test_strange_heartbeats_and_rosters_are_counted():
    async def story(t: Team) -> int:
        barrier = t.start(0, start_deadline=1.0)
        port = t.bus.ports[0]
        strange = [
            b"",
            b"\xff",
            encode(None),
            encode([1, 2]),
            encode([1, 2, 3, 4, 5, "abc", "", 0]),
            encode(["x", 0, 0, [], [], "", "", 0]),
        ]
        for payload in strange:
            port.bus.deliver(
                Message(MESSAGE_TOPICS.heartbeat, 1, payload, 1), (port.address,), 0.0
            )
        for n, payload in enumerate(
            [*strange[:3], encode({"epoch": 1}), encode(["x"])]
        ):
            port.bus.deliver(
                Message(MESSAGE_TOPICS.roster, 1, payload, n, "1"), (port.address,), 0.0
            )
        port.bus.deliver(
            Message(
                MESSAGE_TOPICS.heartbeat, 77, encode([1, 1, 0, [], [], "abc", "", 0]), 1
            ),
            (port.address,),
            0.0,
        )
        assert not barrier.presence.beats
        return port.counters.malformed

    assert team(graphs.path(2), story) == 11


# Epochs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rules", [None, LOSSY], ids=["good", "lossy"])
@pytest.mark.parametrize("gone", [0, 2, 5])
def test_the_loss_of_any_member_makes_a_new_epoch(gone, rules):
    async def story(t: Team) -> Roster:
        await formed([t.start(i) for i in range(6)])
        await t.clock.sleep(1.0)
        t.kill(gone)
        before = t.clock.now()
        roster = await settled(t, 2)
        assert 5.0 < t.clock.now() - before < 9.0
        assert all(
            member.barrier.presence.is_lost(gone) for member in t.members.values()
        )
        assert {
            member.barrier.presence.coordinator() for member in t.members.values()
        } == {min(t.members)}
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


def test_a_late_member_joins():
    async def story(t: Team) -> tuple[Roster, Roster]:
        first = await formed([t.start(i, start=2, start_deadline=1.0) for i in (1, 2)])
        await t.clock.sleep(3.0)
        await t.start(0).go()
        return first, await settled(t, 2)

    first, second = team(graphs.path(3), story, LOSSY)
    assert (first.ids, second.ids, second.epoch) == ((1, 2), (0, 1, 2), 2)


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


def test_a_member_that_dies_while_two_halves_merge_is_left_out():
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
def test_the_rest_go_on_when_members_die_one_after_another(dead, rules, gap):
    """Each dead member may have coordinated. No member may be left to report the members lost before it."""

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
def test_members_that_were_cut_off_exchange_with_the_others_again(alone):
    """Members do not wait for the rounds in which they were apart: no member has these rounds any more."""

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
    """A partition cuts no member off while the last one is awaited. It then cuts from second 2 to 4 after GO."""

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
def test_a_member_restarted_in_its_own_process_is_told_the_mission_age(again):
    """Each member has its own bus, as in its own process. The new bus of the restarted member has heard of no GO."""

    async def main(clock: Clock) -> list[float]:
        ids, graph = (0, 1, 2), graphs.path(3)
        buses = {i: Bus(clock) for i in ids}

        class Wire:
            def forward(self, message, to, age):
                for j in to:
                    if j in buses[j].ports:
                        buses[j].deliver(message, (j,), age)

            def interested(self) -> None: ...

        def start(i: int, incarnation: int) -> Barrier:
            buses[i].forwarder = Wire()
            barrier = Barrier(
                buses[i].port(i, incarnation), graph, AgreedMission("abc", "1")
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
def test_a_joining_member_takes_part_from_the_same_round_for_all(late, rules):
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


def test_a_sequence_of_graphs_goes_on_among_the_remaining_members():
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


@pytest.mark.parametrize("gone", [(0,), (40,), tuple(range(45))], ids=["0", "40", "45"])
def test_a_large_team_goes_on_without_lost_members(gone):
    """Also without all drones with the lowest ids, which the others watch."""
    graph = graphs.ring(100)

    async def story(t: Team) -> Roster:
        await formed([t.start(i) for i in graph.ids])
        for i in gone:
            t.kill(i)
        return await settled(t, 2)

    assert team(graph, story).ids == tuple(i for i in graph.ids if i not in gone)


def test_a_drone_joins_a_large_team_without_the_lowest_ids():
    graph = graphs.ring(100)
    here = graph.ids[50:99]

    async def story(t: Team) -> Roster:
        await formed([t.start(i, start=len(here), start_deadline=6.0) for i in here])
        t.start(99)
        return await settled(t, 2)

    assert team(graph, story).ids == (*here, 99)


def test_drones_of_a_large_team_keep_what_concerns_them_and_share_the_rest():
    graph = graphs.ring(100)

    async def story(t: Team) -> None:
        barriers = [t.start(i) for i in graph.ids]
        await formed(barriers)
        await t.clock.sleep(3.0)
        assert barriers[51].monitor.watched == (0, 50, 52)
        assert max(len(b.presence.beats) for b in barriers[1:]) <= 2 * CLOSE_DRONES
        far = barriers[CLOSE_DRONES + 1 :]
        assert max(len(b.port.heard_ns) for b in far) <= 3 * CLOSE_DRONES
        assert all(b.roster is far[0].roster for b in far)
        assert all(b.roster.graph is far[0].roster.graph for b in far)

    team(graph, story)
