import asyncio

import pytest
from message_parts import taking_parts
from virtual_time import virtual

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.message import Message
from crazychoir.bus.port import Bus
from crazychoir.bus.presence import Presence, PresenceMonitor
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.runtime.actor import RESTART_ON_FAILURE

ABSENT, ALIVE, SUSPECT, LOST = (
    Presence.ABSENT,
    Presence.ALIVE,
    Presence.SUSPECT,
    Presence.LOST,
)


class Team:
    """Monitors of drones 1 to n, each with the diary of what it believed when."""

    def __init__(self, clock, n=2, impairment=None, lost_after=5.0):
        self.clock = clock
        self.bus = Bus(clock, impairment)
        self.bus.impairment.begin(clock.now())
        ids = range(1, n + 1)
        self.monitors = {
            i: PresenceMonitor(
                self.bus.port(i),
                tuple(j for j in ids if j != i),
                lambda: b"beat",
                lost_after,
            )
            for i in ids
        }
        self.diaries = {i: [] for i in ids}
        self.tasks = {}
        for i in ids:
            self.monitors[i].listeners.append(
                lambda j, state, i=i: self.note(i, j, state)
            )
            self.start(i)

    def note(self, i, j, state):
        self.diaries[i].append((self.clock.now(), j, state))

    def start(self, i):
        self.tasks[i] = asyncio.create_task(self.monitors[i].run())

    async def stop(self, i):
        self.tasks[i].cancel()
        await asyncio.wait([self.tasks[i]])


@virtual
async def test_silence_makes_suspect_and_then_lost(clock):
    team = Team(clock)
    assert team.monitors[1].state(2) is ABSENT
    await clock.sleep(10.1)
    await team.stop(2)
    await clock.sleep(20.0)
    (alive, *_), (suspect, *_), (lost, *_) = team.diaries[1]
    assert [state for _, _, state in team.diaries[1]] == [ALIVE, SUSPECT, LOST]
    assert alive <= 0.25
    assert 11.0 < suspect <= 11.5
    assert 5.0 < lost - suspect <= 5.5
    assert (team.monitors[1].those(LOST), team.monitors[1].those(ALIVE)) == ([2], [])


@virtual
async def test_a_drone_that_was_never_heard_is_absent_and_not_lost(clock):
    team = Team(
        clock,
        2,
        Impairment(1, [ImpairmentRule({"loss": 1.0}, edge=(2, 1), directed=True)]),
    )
    await clock.sleep(10.0)
    team.monitors[1].token_gone(2)
    await clock.sleep(10.0)
    assert (team.monitors[1].state(2), team.diaries[1]) == (ABSENT, [])
    assert team.monitors[2].state(1) is ALIVE


@virtual
async def test_back_before_lost_is_alive_again(clock):
    team = Team(clock)
    await clock.sleep(3.1)
    await team.stop(2)
    await clock.sleep(4.0)
    team.start(2)
    await clock.sleep(20.0)
    assert [state for _, _, state in team.diaries[1]] == [ALIVE, SUSPECT, ALIVE]


@virtual
async def test_back_after_lost_is_alive_again_too(clock):
    team = Team(clock, lost_after=1.0)
    await clock.sleep(1.0)
    await team.stop(2)
    await clock.sleep(5.0)
    team.start(2)
    await clock.sleep(1.0)
    assert [state for _, _, state in team.diaries[1]] == [ALIVE, SUSPECT, LOST, ALIVE]


@virtual
async def test_a_partition_looks_like_a_silent_peer_on_both_sides(clock):
    team = Team(
        clock, 4, Impairment(1, [], [NetworkPartition(10.0, 13.0, (1, 2), (3, 4))])
    )
    await clock.sleep(30.0)
    for i, others in [(1, (3, 4)), (4, (1, 2))]:
        after = [entry for entry in team.diaries[i] if entry[0] > 1.0]
        assert [(j, state) for _, j, state in after] == [
            (j, state) for state in (SUSPECT, ALIVE) for j in others
        ]
        assert all(11.0 <= when <= 11.3 for when, _, state in after if state is SUSPECT)
        assert all(13.0 <= when <= 13.3 for when, _, state in after if state is ALIVE)


@virtual
async def test_a_long_partition_loses_the_other_side_only(clock):
    team = Team(clock, 4, Impairment(1, [], [NetworkPartition(10.0, 99.0, (1, 2))]))
    await clock.sleep(30.0)
    assert [team.monitors[i].those(LOST) for i in (1, 2, 3, 4)] == [
        [3, 4],
        [3, 4],
        [1, 2],
        [1, 2],
    ]
    assert [team.monitors[i].those(ALIVE) for i in (1, 2, 3, 4)] == [[2], [1], [4], [3]]


@virtual
async def test_heavy_loss_is_not_silence(clock):
    team = Team(clock, 3, Impairment(7, [ImpairmentRule({"loss": 0.2})]))
    await clock.sleep(60.0)
    assert not any(
        state is LOST for diary in team.diaries.values() for _, _, state in diary
    )


@virtual
async def test_any_message_is_a_sign_of_life(clock):
    team = Team(clock)
    await clock.sleep(1.0)
    await team.stop(2)
    for k in range(40):
        team.bus.ports[2].send(
            Message(MESSAGE_TOPICS.rounds, team.bus.ports[2].address, b"", k), (1,)
        )
        await clock.sleep(0.25)
    assert [state for _, _, state in team.diaries[1]] == [ALIVE]


@virtual
async def test_a_token_that_goes_is_suspect_at_once_and_lost_in_time(clock):
    team = Team(clock, lost_after=2.0)
    await clock.sleep(1.1)
    team.monitors[1].token_gone(2)
    assert (clock.now(), 2, SUSPECT) in team.diaries[1]
    await clock.sleep(3.0)
    assert (
        team.monitors[1].state(2) is LOST
    )  # its heartbeats still come; its process is going


@virtual
async def test_a_token_that_comes_back_is_alive_again(clock):
    team = Team(clock)
    await clock.sleep(1.1)
    team.monitors[1].token_gone(2)
    await clock.sleep(1.0)
    team.monitors[1].token_back(2)
    await clock.sleep(0.3)
    assert [state for _, _, state in team.diaries[1]] == [ALIVE, SUSPECT, ALIVE]


@virtual
async def test_a_token_tells_nothing_about_a_drone_that_hangs(clock):
    team = Team(clock)
    await clock.sleep(1.1)
    await team.stop(2)
    await clock.sleep(2.0)
    team.monitors[1].token_back(2)
    await clock.sleep(0.3)
    assert team.monitors[1].state(2) is SUSPECT


@virtual
async def test_the_watched_drones_may_change(clock):
    team = Team(clock, 3)
    await clock.sleep(1.0)
    team.monitors[1].watched = (2,)
    sent = team.bus.ports[1].counters.sent
    await clock.sleep(1.0)
    assert team.bus.ports[1].counters.sent - sent == 4
    assert team.monitors[1].those(ALIVE) == [2]


@virtual
async def test_the_silence_of_a_drone_that_was_not_watched_does_not_count(clock):
    team = Team(clock)
    await clock.sleep(1.0)
    await team.stop(2)
    await clock.sleep(2.0)
    assert team.monitors[1].state(2) is SUSPECT
    team.monitors[1].watched = ()
    await clock.sleep(20.0)
    team.monitors[1].watched = (2,)
    await clock.sleep(4.5)
    assert team.monitors[1].state(2) is SUSPECT
    await clock.sleep(1.0)
    assert team.monitors[1].state(2) is LOST


@virtual
async def test_a_state_that_comes_without_a_message_is_a_sign_of_life(clock):
    team = Team(clock)
    await clock.sleep(0.5)
    team.monitors[2].silent = True
    last_ns = [None]
    team.bus.ports[1].life_signs += [lambda j: last_ns[0], lambda j: None]
    for _ in range(100):
        last_ns[0] = clock.now_ns()
        await clock.sleep(0.1)
    assert [state for _, _, state in team.diaries[1]] == [ALIVE]
    await clock.sleep(8.0)
    assert [state for _, _, state in team.diaries[1]] == [ALIVE, SUSPECT, LOST]


@virtual
async def test_states_of_a_drone_that_is_no_member_are_no_signs_of_life(clock):
    """A drone that may not fly sends no heartbeats, so that it is no member."""
    team = Team(clock)
    monitor = PresenceMonitor(
        team.bus.ports[1], (2,), lambda: b"beat", is_member=lambda j: False
    )
    team.bus.ports[1].life_signs.append(lambda j: clock.now_ns())
    await clock.sleep(0.5)
    team.monitors[2].silent = True
    for _ in range(100):
        monitor.tick()
        await clock.sleep(0.1)
    assert monitor.state(2) is LOST
    assert monitor.find_heard_ns(2) <= 0.5e9


@virtual
async def test_a_drone_may_be_heard_before_its_first_message(clock):
    team = Team(clock)
    team.monitors[2].silent = True
    team.bus.ports[1].life_signs.append(lambda j: clock.now_ns())
    await clock.sleep(3.0)
    assert [state for _, _, state in team.diaries[1]] == [ALIVE]


@virtual
async def test_heartbeats_carry_what_beat_says_and_are_numbered(clock):
    bus = Bus(clock)
    seen, beats = [], iter([b"1", b"2", b"3", b"4", b"5"])
    bus.port(2).handlers[MESSAGE_TOPICS.heartbeat.number] = taking_parts(
        lambda *message: seen.append(message[2:4])
    )
    monitor = PresenceMonitor(bus.port(1), (2,), lambda: next(beats))
    running = asyncio.create_task(monitor.run())
    await clock.sleep(1.1)
    running.cancel()
    assert seen == [(number, "heartbeat") for number in range(1, 6)]
    with pytest.raises(StopIteration):
        next(beats)


def test_a_monitor_that_fails_is_started_again():
    assert PresenceMonitor.restart is RESTART_ON_FAILURE


def ignore_heartbeats(team):
    """Let each drone ignore the repeated heartbeats of the others."""
    for i in team.monitors:
        others = [j for j in team.monitors if j != i]
        team.bus.ports[i].ignored_beats = dict.fromkeys(others, b"beat")


def count_sent(team):
    return sum(port.counters.sent for port in team.bus.ports.values())


@virtual
async def test_heartbeats_that_are_ignored_are_no_messages_but_signs_of_life(clock):
    team = Team(clock, 3)
    await clock.sleep(1.0)
    ignore_heartbeats(team)
    await clock.sleep(0.5)
    sent = count_sent(team)
    await clock.sleep(10.0)
    assert count_sent(team) == sent
    assert team.monitors[1].those(ALIVE) == [2, 3]
    assert clock.now_ns() - team.bus.ports[1].heard_ns[2] <= 250_000_000


@virtual
async def test_a_drone_that_stops_is_noticed_although_its_heartbeats_were_ignored(
    clock,
):
    team = Team(clock, 3)
    await clock.sleep(1.0)
    ignore_heartbeats(team)
    await clock.sleep(10.0)
    await team.stop(2)
    await clock.sleep(1.0)
    assert team.monitors[1].those(SUSPECT) == []
    await clock.sleep(0.5)
    assert team.monitors[1].those(SUSPECT) == [2]
    await clock.sleep(5.5)
    assert team.monitors[1].those(LOST) == [2]
    assert team.monitors[1].those(ALIVE) == [3]


@virtual
async def test_a_partition_is_noticed_although_heartbeats_were_ignored(clock):
    team = Team(clock, 3)
    await clock.sleep(1.0)
    ignore_heartbeats(team)
    await clock.sleep(10.0)
    team.bus.impairment.update({"cut": {"a": [2]}})
    await clock.sleep(2.0)
    assert team.monitors[1].those(SUSPECT) == [2]
    assert team.monitors[2].those(SUSPECT) == [1, 3]


@virtual
async def test_a_drone_that_falls_silent_is_noticed_although_it_was_ignored(clock):
    team = Team(clock, 2)
    await clock.sleep(1.0)
    ignore_heartbeats(team)
    await clock.sleep(10.0)
    team.monitors[2].silent = True
    await clock.sleep(1.5)
    assert team.monitors[1].those(SUSPECT) == [2]


@virtual
async def test_a_heartbeat_that_changes_is_a_message_again(clock):
    team = Team(clock, 2)
    await clock.sleep(1.0)
    ignore_heartbeats(team)
    await clock.sleep(1.0)
    sent = team.bus.ports[2].counters.sent
    team.monitors[2].beat = lambda: b"another beat"
    await clock.sleep(1.0)
    assert team.bus.ports[2].counters.sent - sent == 4


@virtual
async def test_a_drone_that_restarts_gets_messages_again(clock):
    team = Team(clock, 2)
    await clock.sleep(1.0)
    ignore_heartbeats(team)
    await clock.sleep(1.0)
    port = team.bus.port(1, incarnation=2)
    await clock.sleep(0.3)
    assert 2 in port.heard_ns


@virtual
async def test_ignored_heartbeats_are_lost_by_the_same_draws_as_messages(clock):
    rules = [
        ImpairmentRule({"loss": 0.7}),
        ImpairmentRule(
            {"loss": 0.1, "p_good_bad": 0.2, "p_bad_good": 0.3, "loss_bad": 1.0},
            edge=(1, 2),
        ),
    ]
    messages = Team(clock, 3, Impairment(7, rules))
    ignored = Team(clock, 3, Impairment(7, rules))
    ignore_heartbeats(ignored)
    heard = []
    for _ in range(200):
        await clock.sleep(0.25)
        heard.append([team.bus.ports[1].heard_ns for team in (messages, ignored)])
        assert heard[-1][0] == heard[-1][1]
    assert messages.diaries == ignored.diaries
    assert messages.bus.impairment.counters == ignored.bus.impairment.counters
    for i in (1, 2, 3):
        by_message = messages.bus.ports[i].counters
        without = ignored.bus.ports[i].counters
        assert (by_message.sent, by_message.lost) == (without.sent, without.lost)
        assert by_message.received > 2 * without.received


@virtual
async def test_ignored_heartbeats_that_are_all_lost_are_silence(clock):
    team = Team(clock, 2, Impairment(7, [ImpairmentRule({"loss": 0.1})]))
    await clock.sleep(2.0)
    ignore_heartbeats(team)
    await clock.sleep(5.0)
    assert team.monitors[2].those(ALIVE) == [1]
    team.bus.impairment.replace([ImpairmentRule({"loss": 1.0})])
    await clock.sleep(1.6)
    assert team.monitors[2].those(SUSPECT) == [1]
