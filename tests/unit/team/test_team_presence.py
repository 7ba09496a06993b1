"""The heartbeats of a team, and the drones that are lost."""

from living import Alone, Team, alone, team
from msgspec.structs import replace

from crazychoir.bus.codec import encode
from crazychoir.bus.message import Message
from crazychoir.bus.presence import SILENCE_TIMEOUT, Presence
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.team import graph as graphs
from crazychoir.team.barrier import AgreedMission, Barrier
from crazychoir.team.messages import (
    Roster,
    TeamHeartbeat,
)
from crazychoir.team.team_presence import PRESENCE_HISTORY


def test_only_the_newest_changes_of_presence_are_kept():
    async def story(t: Team) -> list[tuple[float, int, str]]:
        barrier = t.start(0)
        for n in range(PRESENCE_HISTORY + 5):
            barrier.presence._handle_change(n, Presence.SUSPECT)
        return barrier.history

    kept = team(graphs.path(2), story)
    assert [j for _, j, _ in kept] == list(range(5, PRESENCE_HISTORY + 5))


def test_a_newcomer_leaves_coordination_to_drones_that_fly():
    async def story(t: Team) -> None:
        barrier = t.start(0)
        t.bus.ports[0].bus.deliver(
            Message(
                MESSAGE_TOPICS.heartbeat,
                2,
                encode(TeamHeartbeat(1, 3, 0, (), (), "abc").wire()),
                1,
            ),
            (t.bus.ports[0].address,),
            0.0,
        )
        barrier.monitor.tick()
        assert barrier.presence.coordinator() == 2

    team(graphs.complete(3), story)


def test_a_drone_watches_a_peer_that_watches_it():
    async def story(t: Team) -> None:
        graph = graphs.path(4)
        barrier = Barrier(t.bus.port(3), graph, AgreedMission("abc", "1"))
        barrier.rosters.adopt(
            Roster(1, dict.fromkeys(range(4), 1), [], False, 0, 0, "abc", "1")
        )
        barrier.monitor.watched = (0, 2)
        beat = encode(
            TeamHeartbeat(1, 1, barrier.roster.checksum, (), (), "abc").wire()
        )
        t.bus.ports[3].bus.deliver(
            Message(MESSAGE_TOPICS.heartbeat, 1, beat, 1),
            (t.bus.ports[3].address,),
            0.0,
        )
        assert barrier.monitor.watched == (0, 2), (
            "it has just heard of GO itself, and will watch fewer"
        )
        await t.clock.sleep(1.5 * SILENCE_TIMEOUT)
        for number in (2, 3):  # the second one says nothing new
            t.bus.ports[3].bus.deliver(
                Message(MESSAGE_TOPICS.heartbeat, 1, beat, number),
                (t.bus.ports[3].address,),
                0.0,
            )
        assert barrier.monitor.watched == (0, 2, 1)

    team(graphs.path(4), story)


def test_a_lost_drone_that_starts_again_is_not_lost():
    async def story(it: Alone) -> None:
        it.barrier.presence._handle_change(2, Presence.LOST)
        it.barrier.presence._handle_change(3, Presence.LOST)
        assert it.barrier.presence.is_lost(2)
        it.barrier.rosters.adopt(
            replace(it.roster, epoch=2, members={0: 1, 1: 1, 2: 9, 3: 1})
        )
        assert not it.barrier.presence.is_lost(2)
        assert it.barrier.presence.is_lost(3), (
            "a neighbour that this drone alone does not hear"
        )

    alone(1, {0: 1, 1: 1, 2: 1, 3: 1}, story)


def test_a_drone_is_silent_before_its_first_message_and_after_the_timeout():
    async def story(it: Alone) -> None:
        assert it.barrier.presence.is_silent(2)
        it.beat(2, 1, it.roster.checksum)
        assert not it.barrier.presence.is_silent(2)
        await it.t.clock.sleep(SILENCE_TIMEOUT)
        assert it.barrier.presence.is_silent(2)

    alone(1, {1: 1, 2: 1}, story)
