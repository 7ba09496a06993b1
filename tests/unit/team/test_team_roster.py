"""The roster in force at one drone."""

from living import Team, formed, settled, team
from message_parts import taking_parts
from msgspec.structs import replace

from crazychoir.bus.message import Message
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.team import graph as graphs
from crazychoir.team.messages import (
    GoMessage,
    Roster,
    read_roster_message,
)
from crazychoir.team.team_roster import TeamRoster


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


def test_a_roster_for_an_earlier_life_is_not_taken():
    """The coordinator's resends may reach a drone that has been started again."""

    async def story(t: Team) -> Roster | None:
        barrier = t.start(1, incarnation=2)
        old = Roster(1, {0: 1, 1: 1}, [[0, 1]], False, 0, 0, "abc", "1")
        t.bus.ports[1].bus.deliver(
            Message(MESSAGE_TOPICS.roster, 0, GoMessage(old).wire(), 0, "1"),
            (t.bus.ports[1].address,),
            0.0,
        )
        t.bus.ports[1].bus.deliver(
            Message(
                MESSAGE_TOPICS.roster,
                0,
                GoMessage(replace(old, members={0: 1, 1: 2}, mission_hash="x")).wire(),
                1,
                "1",
            ),
            (t.bus.ports[1].address,),
            0.0,
        )
        assert barrier.roster is None
        t.bus.ports[1].bus.deliver(
            Message(
                MESSAGE_TOPICS.roster,
                0,
                GoMessage(replace(old, members={0: 1, 1: 2})).wire(),
                2,
                "1",
            ),
            (t.bus.ports[1].address,),
            0.0,
        )
        return barrier.roster

    assert team(graphs.path(2), story) == Roster(
        1, {0: 1, 1: 2}, [[0, 1]], False, 0, 0, "abc", "1"
    )


def rosters_of_drone_0(clock: Clock) -> tuple[TeamRoster, list[GoMessage]]:
    """Return the rosters of drone 0 on a ring of four, and the list of what drone 1 receives."""
    bus = Bus(clock)
    rosters = TeamRoster(
        bus.port(0, 5), graphs.ring(4), mission_hash="abc", version="1", seed=9
    )
    told: list[GoMessage] = []
    bus.port(1).handlers[MESSAGE_TOPICS.roster.number] = taking_parts(
        lambda source, payload, *rest: told.append(read_roster_message(payload))
    )
    return rosters, told


def test_a_roster_goes_to_its_members_with_the_graph_among_them():
    async def main(clock: Clock) -> None:
        rosters, told = rosters_of_drone_0(clock)
        adopted: list[Roster] = []
        rosters.listeners.append(adopted.append)
        rosters.issue({0: 5, 1: 6}, 3, 17)
        expected = Roster(3, {0: 5, 1: 6}, [[0, 1]], False, 9, 17, "abc", "1")
        assert rosters.roster == expected
        assert adopted == [expected]
        assert [message.roster for message in told] == [expected]
        assert rosters.absent == (2, 3)
        assert rosters.checksum == expected.checksum

    run_virtual(main)


def test_a_reminder_is_not_sent_while_an_earlier_roster_is_on_its_way():
    async def main(clock: Clock) -> None:
        rosters, told = rosters_of_drone_0(clock)
        rosters.issue({0: 5, 1: 6}, 3, 17)
        roster = rosters.roster
        assert roster is not None
        rosters.remind(1, roster)
        assert len(told) == 1, "drone 1 has not acknowledged it yet"
        rosters.reliable.forget(1)
        rosters.remind(1, roster)
        assert len(told) == 2

    run_virtual(main)
