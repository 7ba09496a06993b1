import pytest
from virtual_time import virtual

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.message import Message
from crazychoir.bus.port import Bus
from crazychoir.bus.reliable import RELIABLE_LIMITS, Reliable
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.runtime.clock import run_virtual

BAD = ImpairmentRule(
    {
        "loss": 0.5,
        "duplicate": 0.3,
        "reorder": 0.3,
        "reorder_delay": 0.08,
        "delay": 0.01,
        "jitter": 0.02,
    }
)


def pair(clock, impairment=None):
    """The reliable classes of ports 1 and 2, and what has arrived at 2 from 1."""
    bus = Bus(clock, impairment)
    bus.impairment.begin(clock.now())
    one, two = Reliable(bus.port(1, 0xA1)), Reliable(bus.port(2, 0xB1))
    one.listen(MESSAGE_TOPICS.roster, lambda source, payload: None)
    return bus, one, two, listening(two)


def listening(end):
    seen = []
    end.listen(MESSAGE_TOPICS.roster, lambda source, payload: seen.append(payload))
    return seen


def numbers(count, first=0):
    return [str(k).encode() for k in range(first, first + count)]


@pytest.mark.parametrize("seed", range(20))
def test_in_order_and_once_under_loss_duplicates_and_reordering(seed):
    async def main(clock):
        _, one, two, seen = pair(clock, Impairment(seed, [BAD]))
        for payload in numbers(60):
            one.send(MESSAGE_TOPICS.roster, 2, payload)
            await clock.sleep(0.004)
        await clock.sleep(12.0)
        return (
            seen,
            one.given_up,
            one.port.counters.resent,
            [one._outgoing[2].pending, two._incoming[1].early],
        )

    seen, given_up, resent, left = run_virtual(main)
    assert seen == numbers(60)
    assert (given_up, left) == (0, [{}, {}])
    assert resent > 10


@virtual
async def test_without_loss_nothing_is_resent(clock):
    _, one, two, seen = pair(clock)
    for payload in numbers(5):
        one.send(MESSAGE_TOPICS.roster, 2, payload)
    assert seen == numbers(5)
    await clock.sleep(2.0)
    assert (
        one.port.counters.resent,
        one.port.counters.sent,
        two.port.counters.sent,
    ) == (0, 5, 5)


@virtual
async def test_both_directions_at_once(clock):
    _, one, two, at_two = pair(clock, Impairment(3, [BAD]))
    at_one = listening(one)
    for payload in numbers(20):
        one.send(MESSAGE_TOPICS.roster, 2, payload)
        two.send(MESSAGE_TOPICS.roster, 1, payload)
    await clock.sleep(12.0)
    assert at_one == at_two == numbers(20)


@virtual
async def test_a_lost_acknowledgement_is_drawn_anew(clock):
    """The only message; its acknowledgement is lost half of the time, for each seed."""
    for seed in range(30):
        _, one, _, seen = pair(
            clock,
            Impairment(
                seed, [ImpairmentRule({"loss": 0.6}, edge=(2, 1), directed=True)]
            ),
        )
        one.send(MESSAGE_TOPICS.roster, 2, b"x")
        await clock.sleep(8.0)
        assert (seen, one._outgoing[2].pending, one.given_up) == ([b"x"], {}, 0)


@virtual
async def test_resends_back_off(clock):
    _, one, _, seen = pair(clock, Impairment(1, [], [NetworkPartition(0.0, 6.0, (1,))]))
    one.send(MESSAGE_TOPICS.roster, 2, b"x")
    await clock.sleep(5.9)
    assert (
        12 <= one.port.counters.resent <= 17
    )  # after 30, 60, 120, 240, 480 ms, and then each 500 ms
    await clock.sleep(0.7)
    assert seen == [b"x"]


@virtual
async def test_a_receiver_that_restarts_gets_what_was_not_acknowledged(clock):
    bus, one, _, seen = pair(clock)
    for payload in numbers(3):
        one.send(MESSAGE_TOPICS.roster, 2, payload)
    bus.close(2)
    for payload in numbers(3, first=3):
        one.send(MESSAGE_TOPICS.roster, 2, payload)
    await clock.sleep(1.0)
    again = listening(Reliable(bus.port(2, 0xB2)))
    await clock.sleep(1.0)
    assert (seen, again) == (numbers(3), numbers(3, first=3))


@virtual
async def test_a_sender_that_restarts_begins_anew(clock):
    bus, one, _, seen = pair(clock)
    for payload in numbers(3):
        one.send(MESSAGE_TOPICS.roster, 2, payload)
    anew = Reliable(bus.port(1, 0xA2))
    anew.send(MESSAGE_TOPICS.roster, 2, b"anew")
    await clock.sleep(1.0)
    assert seen == [*numbers(3), b"anew"]
    assert anew._outgoing[2].pending == {}


@virtual
async def test_what_arrives_late_of_a_former_life_changes_nothing(clock):
    bus, one, two, seen = pair(clock)
    one.send(MESSAGE_TOPICS.roster, 2, b"old")
    anew = Reliable(bus.port(1, 0xA2))
    anew.send(MESSAGE_TOPICS.roster, 2, b"new")
    two.port.bus.deliver(
        Message(MESSAGE_TOPICS.roster, 1, b"old again", 1, "a1"),
        (two.port.address,),
        0.0,
    )
    two.port.bus.deliver(
        Message(MESSAGE_TOPICS.roster, 1, b"new", 0, "a2"), (two.port.address,), 0.0
    )
    anew.send(MESSAGE_TOPICS.roster, 2, b"newer")
    assert seen == [b"old", b"new", b"newer"]


@virtual
async def test_acknowledgements_of_a_former_life_count_for_nothing(clock):
    _, one, _, _ = pair(clock, Impairment(1, [ImpairmentRule({"loss": 1.0})]))
    one.send(MESSAGE_TOPICS.roster, 2, b"x")
    one._acknowledged(
        Message(MESSAGE_TOPICS.acknowledgement, 2, b"", 9, "other life"), 0.0
    )
    assert list(one._outgoing[2].pending) == [0]
    one._acknowledged(Message(MESSAGE_TOPICS.acknowledgement, 2, b"", 1, "a1"), 0.0)
    assert list(one._outgoing[2].pending) == []


@virtual
async def test_it_is_bounded_in_messages(clock):
    _, one, _, seen = pair(clock, Impairment(1, [], [NetworkPartition(0.0, 5.0, (1,))]))
    for payload in numbers(RELIABLE_LIMITS.max_pending + 10):
        one.send(MESSAGE_TOPICS.roster, 2, payload)
    assert (len(one._outgoing[2].pending), one.given_up) == (
        RELIABLE_LIMITS.max_pending,
        10,
    )
    await clock.sleep(8.0)
    assert seen == numbers(RELIABLE_LIMITS.max_pending)


@virtual
async def test_what_is_too_old_is_given_up_and_what_follows_arrives(clock):
    _, one, two, seen = pair(
        clock,
        Impairment(1, [], [NetworkPartition(0.0, RELIABLE_LIMITS.max_age + 2.0, (1,))]),
    )
    one.send(MESSAGE_TOPICS.roster, 2, b"old")
    await clock.sleep(10.0)
    one.send(MESSAGE_TOPICS.roster, 2, b"younger")
    await clock.sleep(RELIABLE_LIMITS.max_age - 9.0)
    assert (one.given_up, list(one._outgoing[2].pending)) == (1, [1])
    await clock.sleep(3.0)
    assert (seen, one.given_up) == ([b"younger"], 1)
    one.send(MESSAGE_TOPICS.roster, 2, b"next")
    assert seen == [b"younger", b"next"]
    assert two._incoming[1].early == {}


@virtual
async def test_a_burst_of_losses_ends_though_a_message_was_given_up_in_it(clock):
    """The first 50 transmissions of this link are lost. A message is given up after fewer."""
    burst = ImpairmentRule(
        {"p_good_bad": 0.03, "p_bad_good": 0.03, "loss_bad": 1.0},
        edge=(1, 2),
        directed=True,
    )
    _, one, _, seen = pair(clock, Impairment(15, [burst]))
    one.send(MESSAGE_TOPICS.roster, 2, b"old")
    await clock.sleep(RELIABLE_LIMITS.max_age + 1.0)
    assert (one.given_up, one.port.counters.lost < 50) == (1, True)
    one.send(MESSAGE_TOPICS.roster, 2, b"younger")
    await clock.sleep(RELIABLE_LIMITS.max_age - 1.0)
    assert seen == [b"younger"]


@virtual
async def test_what_came_early_of_a_sequence_that_was_given_up_is_forgotten(clock):
    _, _, two, seen = pair(clock)
    two.port.bus.deliver(
        Message(MESSAGE_TOPICS.roster, 1, b"2", 2, "a1", 2), (two.port.address,), 0.0
    )
    assert (seen, list(two._incoming[1].early)) == ([], [2])
    two.port.bus.deliver(
        Message(MESSAGE_TOPICS.roster, 1, b"5", 5, "a1"), (two.port.address,), 0.0
    )
    assert (seen, two._incoming[1].early) == ([b"5"], {})


@virtual
async def test_a_peer_that_was_forgotten_and_comes_back_goes_on(clock):
    _, one, _, seen = pair(clock, Impairment(1, [], [NetworkPartition(1.0, 3.0, (1,))]))
    for payload in numbers(3):
        one.send(MESSAGE_TOPICS.roster, 2, payload)
    await clock.sleep(1.5)
    one.send(MESSAGE_TOPICS.roster, 2, b"lost")
    one.forget(2)
    one.forget(77)
    await clock.sleep(2.0)
    one.send(MESSAGE_TOPICS.roster, 2, b"back")
    await clock.sleep(0.5)
    assert seen == [*numbers(3), b"back"]


@virtual
async def test_answers_from_within_the_receiver(clock):
    """Ports of one process answer while the sender is still sending, on the sweep too."""
    bus, one, two, _ = pair(
        clock, Impairment(1, [], [NetworkPartition(0.0, 1.0, (1, 2, 3))])
    )
    bus.impairment.replace([], [NetworkPartition(0.0, 1.0, (1,))])
    three = Reliable(bus.port(3, 0xC1))
    seen = []

    def answer(source, payload):
        seen.append(payload)
        two.send(MESSAGE_TOPICS.roster, source, b"re " + payload)
        one.send(MESSAGE_TOPICS.roster, 3, b"new " + payload)

    two.listen(MESSAGE_TOPICS.roster, answer)
    at_one, at_three = listening(one), listening(three)
    for payload in numbers(4):
        one.send(MESSAGE_TOPICS.roster, 2, payload)
    await clock.sleep(3.0)
    assert seen == numbers(4)
    assert at_one == [b"re " + payload for payload in numbers(4)]
    assert at_three == [b"new " + payload for payload in numbers(4)]


@virtual
async def test_an_acknowledgement_of_all_during_a_resend_ends_the_resending(clock):
    """Messages 1 to 3 are there already; the resent 0 is answered with an acknowledgement of all four."""
    _, one, _, seen = pair(clock)
    handlers = one.port.bus.ports[2].handlers
    handle, lost = handlers[MESSAGE_TOPICS.roster.number], []

    def lossy(message, age):
        if message.number == 0 and not lost:
            lost.append(message)
        else:
            handle(message, age)

    handlers[MESSAGE_TOPICS.roster.number] = lossy
    for payload in numbers(4):
        one.send(MESSAGE_TOPICS.roster, 2, payload)
    assert seen == []
    await clock.sleep(1.0)
    assert (seen, one.port.counters.resent) == (numbers(4), 1)


@virtual
async def test_a_sender_that_restarts_again_and_again_takes_no_memory(clock):
    bus, _, two, seen = pair(clock)
    for life in range(10_000):
        bus.ports[2].bus.deliver(
            Message(MESSAGE_TOPICS.roster, 1, b"x", 0, f"{life:x}"),
            (bus.ports[2].address,),
            0.0,
        )
    assert len(seen) == 10_000
    assert len(two._incoming[1].former) == RELIABLE_LIMITS.former_incarnations
