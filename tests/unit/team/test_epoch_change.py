"""The change to the next epoch at one coordinator."""

from typing import Any

from living import Alone, HeldAt, Team, alone, counting, formed, settled, team
from msgspec.structs import replace

from crazychoir.bus.codec import decode
from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.bus.presence import Presence
from crazychoir.team import graph as graphs
from crazychoir.team.messages import (
    HoldAnswer,
    HoldRequest,
    Roster,
    TeamHeartbeat,
)


def test_a_coordinator_does_not_hold_for_a_higher_id():
    async def story(it: Alone) -> None:
        it.barrier.changing.attach(HeldAt(7))
        it.tell(2, HoldRequest(2))
        assert it.sent == []
        it.tell(0, HoldRequest(2))
        assert it.sent == [(0, HoldAnswer(2, 7, {1: 1, 2: 1}))]
        it.tell(0, HoldRequest(1))
        assert len(it.sent) == 1, "no drone holds for an epoch that is past"

    alone(1, {1: 1, 2: 1}, story)


def test_a_proposal_gives_way_to_that_of_a_lower_id():
    async def story(it: Alone) -> None:
        it.beat(3, 1)
        assert it.sent == [(2, HoldRequest(2)), (3, HoldRequest(2))]
        it.tell(0, HoldRequest(2))
        it.tell(2, HoldAnswer(2, 5, {}))
        it.tell(3, HoldAnswer(2, 5, {}))
        assert it.barrier.roster == it.roster

    alone(1, {1: 1, 2: 1}, story)


def test_a_lower_id_of_another_half_is_left_to_coordinate():
    async def story(it: Alone) -> None:
        it.beat(0, 4)
        assert it.sent == []
        it.beat(0, 0)
        assert it.sent[0] == (2, HoldRequest(2)), "but a newcomer is taken in"

    alone(1, {1: 1, 2: 1}, story)


def test_the_next_roster_starts_at_a_round_that_was_not_sent_yet():
    async def story(it: Alone) -> None:
        it.barrier.changing.attach(HeldAt(3))
        it.beat(3, 0, incarnation=8)
        it.tell(1, HoldAnswer(2, 12, {}))
        assert it.barrier.roster == it.roster
        it.tell(2, HoldAnswer(2, 10, {}))
        assert it.barrier.roster == replace(
            it.roster,
            epoch=2,
            members={0: 1, 1: 1, 2: 1, 3: 8},
            first_round=13,
            edges=EDGES,
        )

    EDGES = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    alone(0, {0: 1, 1: 1, 2: 1}, story)


def test_another_half_joins_whole_or_without_members_that_never_answer():
    async def story(it: Alone) -> None:
        it.beat(2, 1)
        it.tell(2, HoldAnswer(2, 10, {2: 1, 3: 1}))
        assert it.sent == [(2, HoldRequest(2)), (3, HoldRequest(2))]
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


def test_a_member_that_never_answers_is_dropped_even_if_no_other_is_heard():
    """Drone 1 was never heard, as if this drone had started just after drone 1 was killed."""

    async def story(it: Alone) -> None:
        it.barrier.presence._handle_change(0, Presence.LOST)
        assert it.sent == [(1, HoldRequest(2))]
        await it.t.clock.sleep(5.5)
        assert it.barrier.roster is not None
        assert it.barrier.roster.ids == (2,)

    alone(2, {0: 1, 1: 1, 2: 1}, story)


def test_rosters_of_two_coordinators_are_replaced():
    async def story(it: Alone) -> None:
        it.beat(1, 1, it.roster.checksum)
        assert it.sent == []
        it.beat(1, 1, it.roster.checksum + 1)
        assert it.sent == [(1, HoldRequest(2))]
        it.tell(1, HoldAnswer(2, 0, {}))
        assert it.barrier.roster is not None
        assert it.barrier.roster.epoch == 2
        it.beat(1, 6)
        assert it.sent[-1] == (1, HoldRequest(7))

    alone(0, {0: 1, 1: 1}, story)


def test_a_member_that_has_not_held_is_asked_again_with_each_heartbeat():
    async def story(it: Alone) -> None:
        it.beat(2, 0)
        it.barrier.rosters.reliable.forget(1)
        assert it.sent == [(1, HoldRequest(2))]
        it.beat(1, 1, it.roster.checksum)
        assert it.sent == [(1, HoldRequest(2)), (1, HoldRequest(2))]

    alone(0, {0: 1, 1: 1}, story)


def test_a_held_member_is_released_by_the_next_coordinator():
    """The coordinator dies after it has asked for HOLD, before it issues the roster."""

    async def story(t: Team) -> Roster:
        heard: dict[int, Any] = {}
        barriers = [t.start(i, start=3, start_deadline=1.0) for i in range(3)]
        for i in range(3):
            t.run(i, counting(t, i, heard, 30.0))
        await formed(barriers)
        barriers[0].changing._conclude = lambda: None  # type: ignore[method-assign]
        t.start(3)
        await t.clock.sleep(2.0)
        held = [t.members[i].communicator.exchange.hold() for i in (1, 2)]
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


def test_a_drone_tells_for_which_epoch_it_holds():
    async def story(it: Alone) -> None:
        changing = it.barrier.changing
        it.tell(0, HoldRequest(3))
        assert changing.held_for == 3
        beat = decode(it.barrier.presence._encode_heartbeat())
        assert TeamHeartbeat.of(beat).held_for == 3
        it.barrier.rosters.adopt(replace(it.roster, epoch=3))
        assert changing.held_for == 0

    alone(1, {1: 1, 2: 1}, story)


def test_a_member_that_holds_for_a_dropped_proposal_is_released():
    """The proposal of another drone for epoch 2 was dropped: no other roster would come."""

    async def story(it: Alone) -> None:
        it.barrier.changing.attach(HeldAt(3))
        it.beat(1, 1, it.roster.checksum, held_for=1)
        assert it.sent == []
        it.beat(1, 1, it.roster.checksum, held_for=2)
        assert it.sent == [(1, HoldRequest(2))]
        it.tell(1, HoldAnswer(2, 8, {}))
        issued = it.barrier.roster
        assert issued is not None
        assert (issued.epoch, issued.first_round) == (2, 9)

    alone(0, {0: 1, 1: 1}, story)


def test_an_answer_for_another_epoch_does_not_count():
    async def story(it: Alone) -> None:
        it.beat(2, 0)
        it.tell(1, HoldAnswer(3, 5, {}))
        assert it.barrier.roster == it.roster
        it.tell(1, HoldAnswer(2, 5, {}))
        assert it.barrier.roster is not None
        assert (it.barrier.roster.epoch, it.barrier.roster.first_round) == (2, 6)

    alone(0, {0: 1, 1: 1}, story)
