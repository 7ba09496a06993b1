"""The start of a team, in virtual time."""

import asyncio
from typing import Any

import pytest
from living import (
    LOSSY,
    Team,
    formed,
    settled,
    team,
)

from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.errors import Refused
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team import graph as graphs
from crazychoir.team.barrier import Barrier
from crazychoir.team.messages import (
    Roster,
)


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


def test_the_longest_waiting_drone_starts_at_the_deadline_of_the_coordinator():
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
def test_the_start_fails_at_once_if_too_few_drones_can_fly(start, do):
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


def test_enough_drones_start_without_an_unfit_one_and_it_may_join_later():
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


def test_a_drone_that_cannot_fly_is_named_beside_the_absent():
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


def count_messages(t: Team) -> int:
    return sum(port.counters.sent for port in t.bus.ports.values())


@pytest.mark.parametrize(
    "rules", [None, [ImpairmentRule({"loss": 0.5})]], ids=["good", "half"]
)
def test_the_messages_of_a_start_grow_with_the_drones_and_not_with_their_square(rules):
    """At 200 drones all to all would be 40 000 heartbeats four times a second."""
    graph = graphs.ring(200)

    async def story(t: Team) -> tuple[float, int]:
        roster = await formed([t.start(i) for i in graph.ids])
        assert roster.ids == graph.ids
        return t.clock.now(), count_messages(t)

    at, messages = team(graph, story, rules)

    heartbeats = 4.0 * at + 1.0
    assert messages < 110 * len(graph.ids) * heartbeats
    if rules is None:
        assert at < 1.0


def test_a_large_team_starts_without_the_lowest_ids():
    """Ids 0 to 49 are absent, so no drone begins with an address of the coordinator."""
    graph = graphs.ring(150)
    here = graph.ids[50:]

    async def story(t: Team) -> Roster:
        return await formed(
            [t.start(i, start=len(here), start_deadline=6.0) for i in here]
        )

    assert team(graph, story).ids == here


def test_the_smaller_half_of_a_large_team_is_refused():
    graph = graphs.ring(100)
    foreign = graph.ids[::3]

    async def story(t: Team) -> dict[int, Any]:
        barriers = {
            i: t.start(
                i,
                mission="xyz" if i in foreign else "abc",
                start=2,
                start_deadline=8.0,
            )
            for i in graph.ids
        }
        found = await asyncio.gather(
            *(b.go() for b in barriers.values()), return_exceptions=True
        )
        return dict(zip(barriers, found, strict=True))

    for i, result in team(graph, story).items():
        if i in foreign:
            assert isinstance(result, Refused)
            assert "its swarm file or mission (xyz) is not that of" in str(result)
        else:
            assert result.ids == tuple(j for j in graph.ids if j not in foreign)


def test_a_drone_of_a_large_team_that_cannot_fly_tells_all():
    graph = graphs.ring(100)

    async def story(t: Team) -> list[Any]:
        barriers = [t.start(i) for i in graph.ids]
        barriers[70].monitor.silent = True
        t.clock.call_at(3 * NS_PER_SECOND, refuse, barriers[70])
        waiting = [b.go() for b in barriers if b.id != 70]
        return await asyncio.gather(*waiting, return_exceptions=True)

    for found in team(graph, story):
        assert isinstance(found, Refused)
        assert "drone 70 cannot fly" in str(found)
