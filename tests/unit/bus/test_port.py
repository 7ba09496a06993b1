from unittest.mock import patch

import numpy as np
import pytest
from message_parts import list_parts, taking_parts
from virtual_time import virtual

from crazychoir.bus import port as local
from crazychoir.bus.codec import encode
from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.message import Message
from crazychoir.bus.port import PORT_ADDRESSES, Bus, Interest
from crazychoir.bus.topics import (
    ALL_TOPICS,
    DRONE_TOPICS,
    MESSAGE_TOPICS,
    TOPIC_BY_NAME,
    TOPIC_BY_NUMBER,
)
from crazychoir.runtime.mailbox import Latest
from crazychoir.types import FPQR, FRPY, XYZ, Body, FullState, Pose, State, Status, Vel

LOSS = Impairment(1, [ImpairmentRule({"loss": 1.0})])


def ports(clock, *addresses, impairment=None):
    bus = Bus(clock, impairment)
    bus.impairment.begin(clock.now())
    return bus, *(bus.port(address) for address in addresses)


def reading(bus, topic, source, reader, rate=0.0):
    """A mailbox of `reader` for a topic of `source`."""
    box = topic.mailbox(bus.clock)
    bus.subscribe(topic, source, reader, box, rate)
    return box


def handling(port, topic):
    """What arrives for a handler."""
    seen = []
    port.handlers[topic.number] = taking_parts(lambda *message: seen.append(message))
    return seen


@virtual
async def test_the_bus_finds_the_addresses_that_are_read_as_readers_come_and_go(clock):
    bus, own, other = ports(clock, 5, 3)
    topic = DRONE_TOPICS.pose
    assert bus.find_read_addresses(topic) == ()
    assert not own.is_read(topic)
    reading(bus, topic, 5, 5)
    reading(bus, topic, 3, 5)
    assert bus.find_read_addresses(topic) == (3, 5)
    assert bus.find_read_addresses(topic) is bus.find_read_addresses(topic)
    assert bus.find_read_addresses(DRONE_TOPICS.truth) == ()
    bus.port(5)  # a port that is opened again has lost the mailboxes of its actors
    assert bus.find_read_addresses(topic) == (3,)
    bus.add_remote_interests([Interest(topic.name, 3, 77), Interest(topic.name, 5, 77)])
    bus.drop_readers([5])
    assert bus.find_read_addresses(topic) == (3, 5)
    bus.drop_readers([77])
    assert bus.find_read_addresses(topic) == ()
    assert not other.is_read(topic)


@virtual
async def test_a_reader_with_a_rate_counts_as_a_reader(clock):
    bus, *_ = ports(clock, 5, 3)
    reading(bus, DRONE_TOPICS.truth, 5, 3, rate=2.0)
    assert bus.find_read_addresses(DRONE_TOPICS.truth) == (5,)


@virtual
async def test_a_new_reader_of_an_offered_topic_gets_its_present_value(clock):
    bus, port, _ = ports(clock, 5, 3)
    harms = ["", "broken"]
    port.latched.offer(DRONE_TOPICS.body, lambda: Body(harms[-1]))
    box = reading(bus, DRONE_TOPICS.body, 5, 3)
    assert box.peek() == Body("broken")
    assert box.age() == 0.0


@virtual
async def test_an_offered_value_has_its_age(clock):
    bus, port, _ = ports(clock, 5, 3)
    state = State.at((1, 2, 3))
    port.latched.offer(DRONE_TOPICS.state, lambda: state, lambda: 0.1)
    assert reading(bus, DRONE_TOPICS.state, 5, 3).age() == 0.1


class Network:
    """A forwarder that keeps what it gets."""

    def __init__(self):
        self.messages, self.changes, self.later = [], 0, []

    def forward(self, message, to, age):
        source, *parts = list_parts(message, age)
        self.messages.append((message.topic.name, source, to, *parts))

    def then(self, work):
        self.later.append(work)

    def interested(self):
        self.changes += 1


@virtual
async def test_actors_of_one_drone_get_the_very_object(clock):
    bus, one = ports(clock, 1, impairment=LOSS)
    boxes = [
        reading(bus, DRONE_TOPICS.state, 1, 1),
        reading(bus, DRONE_TOPICS.state, 1, 1),
    ]
    state = State.at((1, 2, 3))
    one.publish(DRONE_TOPICS.state, state, age=0.02)
    assert all(
        box.peek() is state and box.age() == pytest.approx(0.02) for box in boxes
    )
    assert (one.counters.sent, one.counters.bytes) == (0, 0)


@virtual
async def test_other_drones_get_a_copy_through_the_codec(clock):
    bus, one, two = ports(clock, 1, 2)
    box = reading(bus, DRONE_TOPICS.state, 1, 2)
    state = State.at((1, 2, 3))
    one.publish(DRONE_TOPICS.state, state, age=0.02)
    got = box.peek()
    assert got is not state
    assert not np.shares_memory(got.flat, state.flat)
    assert np.array_equal(got.flat, state.flat)
    assert not got.flat.flags.writeable
    assert box.age() == pytest.approx(0.02)
    assert (one.counters.sent, one.counters.bytes, two.counters.received) == (
        1,
        len(encode(state)),
        1,
    )
    assert two.heard_ns == {1: 0}


@virtual
async def test_drones_of_one_process_share_what_was_decoded_and_cannot_change_it(clock):
    bus, one, _, _ = ports(clock, 1, 2, 3)
    boxes = [reading(bus, DRONE_TOPICS.state, 1, reader) for reader in (2, 3)]
    for x in range(3):
        one.publish(DRONE_TOPICS.state, State.at((x, 2, 3)))
        assert boxes[0].peek() is boxes[1].peek()
        assert boxes[0].peek().p[0] == x


@virtual
async def test_what_can_be_changed_is_not_shared(clock):
    bus, one, _, _ = ports(clock, 1, 2, 3)
    boxes = [reading(bus, DRONE_TOPICS.result, 1, reader) for reader in (2, 3)]
    one.publish(DRONE_TOPICS.result, {"success": True})
    boxes[0].peek().clear()
    assert boxes[1].peek() == {"success": True}


@virtual
async def test_a_value_without_a_reader_is_not_even_encoded(clock):
    _, one = ports(clock, 1)
    one.publish(DRONE_TOPICS.state, object())
    assert one.counters.sent == 0


@virtual
async def test_a_value_is_encoded_once_for_all_its_readers(clock):
    bus, one, _, _ = ports(clock, 1, 2, 3)
    boxes = [reading(bus, DRONE_TOPICS.state, 1, reader) for reader in (2, 3)]
    with patch.object(local, "encode", wraps=encode) as encoding:
        one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert (encoding.call_count, [box.received for box in boxes]) == (1, [1, 1])


@virtual
async def test_two_mailboxes_of_a_port_cost_one_message_and_get_it_once(clock):
    bus, one, _ = ports(clock, 1, 2)
    first, second = (
        reading(bus, DRONE_TOPICS.state, 1, 2),
        reading(bus, DRONE_TOPICS.state, 1, 2),
    )
    one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert (one.counters.sent, first.received, second.received) == (1, 1, 1)


@virtual
async def test_send_reaches_handlers_here_and_the_forwarder_elsewhere(clock):
    bus, one, two, three = ports(clock, 1, 2, 3)
    bus.forwarder = Network()
    seen = [handling(port, MESSAGE_TOPICS.rounds) for port in (two, three)]
    one.send(
        Message(MESSAGE_TOPICS.rounds, one.address, b"xy", 5, "main", 4), (2, 3, 7, 8)
    )
    assert bus.forwarder.messages == [("round", 1, [7, 8], b"xy", 5, "main", 4, 0.0)]
    assert seen == [[], []], "what others wait for leaves first"
    for work in bus.forwarder.later:
        work()
    assert seen == [[(1, b"xy", 5, "main", 4, 0.0)]] * 2
    assert (one.counters.sent, one.counters.bytes) == (4, 8)


@virtual
async def test_what_is_no_round_reaches_handlers_here_at_once(clock):
    bus, one, two = ports(clock, 1, 2)
    bus.forwarder = Network()
    seen = handling(two, MESSAGE_TOPICS.roster)
    one.send(Message(MESSAGE_TOPICS.roster, one.address, b"xy"), (2, 7))
    assert (len(seen), len(bus.forwarder.messages), bus.forwarder.later) == (1, 1, [])


@virtual
async def test_what_has_no_way_is_counted(clock):
    bus, one = ports(clock, 1)
    one.send(Message(MESSAGE_TOPICS.rounds, one.address, b""), (7, 8))
    assert bus.unroutable == 2


# The simulated network ----------------------------------------------------------------------------------------


@virtual
async def test_impairment_is_on_drones_and_not_on_observers(clock):
    bus, one, _, _ = ports(clock, 1, 2, PORT_ADDRESSES.first_observer, impairment=LOSS)
    drone, observer, own = (
        reading(bus, DRONE_TOPICS.state, 1, reader)
        for reader in (2, PORT_ADDRESSES.first_observer, 1)
    )
    one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert (drone.received, observer.received, own.received) == (0, 1, 1)
    assert (one.counters.sent, one.counters.lost) == (1, 1)


@virtual
async def test_impairment_is_on_impaired_topics_alone(clock):
    bus, one, two = ports(clock, 1, 2, impairment=LOSS)
    rounds, requests, truth = (
        handling(two, MESSAGE_TOPICS.rounds),
        handling(two, MESSAGE_TOPICS.request),
        reading(bus, DRONE_TOPICS.truth, 1, 2),
    )
    one.send(Message(MESSAGE_TOPICS.rounds, one.address, b""), (2,))
    one.send(Message(MESSAGE_TOPICS.request, one.address, b""), (2,))
    one.publish(DRONE_TOPICS.truth, State.at((0, 0, 0)))
    assert (len(rounds), len(requests), truth.received, one.counters.lost) == (
        0,
        1,
        1,
        1,
    )


@virtual
async def test_a_delayed_message_arrives_later_and_older(clock):
    bus, one, two = ports(
        clock, 1, 2, impairment=Impairment(1, [ImpairmentRule({"delay": 0.05})])
    )
    box, seen = (
        reading(bus, DRONE_TOPICS.state, 1, 2),
        handling(two, MESSAGE_TOPICS.rounds),
    )
    one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)), age=0.01)
    one.send(Message(MESSAGE_TOPICS.rounds, one.address, b"", 1), (2,))
    await clock.sleep(0.049)
    assert (box.received, seen) == (0, [])
    await clock.sleep(0.002)
    assert box.age() == pytest.approx(0.061)
    assert seen == [(1, b"", 1, "", 0, 0.05)]


@virtual
async def test_duplicates_arrive_twice_and_each_receiver_has_a_fate_of_its_own(clock):
    _, one, two, three = ports(
        clock,
        1,
        2,
        3,
        impairment=Impairment(1, [ImpairmentRule({"duplicate": 1.0}, edge=(1, 2))]),
    )
    seen = [handling(port, MESSAGE_TOPICS.rounds) for port in (two, three)]
    one.send(Message(MESSAGE_TOPICS.rounds, one.address, b""), (2, 3))
    await clock.sleep(0.01)
    assert [len(messages) for messages in seen] == [2, 1]


@virtual
async def test_verdicts_are_those_of_number_channel_and_attempt(clock):
    impairment = Impairment(5, [ImpairmentRule({"loss": 0.5})])
    _, one, two = ports(clock, 1, 2, impairment=impairment)
    seen = handling(two, MESSAGE_TOPICS.rounds)
    for number in range(40):
        one.send(
            Message(MESSAGE_TOPICS.rounds, one.address, b"", number, "main", 0),
            (2,),
            number % 3,
        )
    fresh = Impairment(5, [ImpairmentRule({"loss": 0.5})])
    wanted = [
        k for k in range(40) if fresh.verdict(1, 2, "main", k, k % 3, 0, 0.0).deliveries
    ]
    assert [message[2] for message in seen] == wanted
    assert one.counters.lost == 40 - len(wanted)


@virtual
async def test_partitions_count_from_go(clock):
    await clock.sleep(100.0)
    _, one, two = ports(
        clock, 1, 2, impairment=Impairment(1, [], [NetworkPartition(1.0, 2.0, (1,))])
    )
    seen = handling(two, MESSAGE_TOPICS.rounds)
    for number in range(6):
        one.send(Message(MESSAGE_TOPICS.rounds, one.address, b"", number), (2,))
        await clock.sleep(0.5)
    assert [message[2] for message in seen] == [0, 1, 4, 5]


# Readers ------------------------------------------------------------------------------------------------------


@virtual
async def test_a_late_reader_gets_the_latched_value_with_its_age(clock):
    bus, one, _, _ = ports(clock, 1, 2, PORT_ADDRESSES.first_observer)
    status = Status("hover", cost=1.5, relaxed=1.25)
    one.publish(DRONE_TOPICS.status, status, age=0.25)
    await clock.sleep(0.5)
    boxes = [
        reading(bus, DRONE_TOPICS.status, source, reader)
        for source, reader in [
            (1, 2),
            (PORT_ADDRESSES.any_drone, PORT_ADDRESSES.first_observer),
            (1, 1),
        ]
    ]
    assert boxes[0].peek() == status
    assert boxes[1].peek() == (1, status)
    assert boxes[2].peek() is status
    assert [box.age() for box in boxes] == pytest.approx([0.75] * 3)


@virtual
async def test_other_topics_are_not_latched(clock):
    bus, one, _ = ports(clock, 1, 2)
    one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert reading(bus, DRONE_TOPICS.state, 1, 2).received == 0


@virtual
async def test_a_latched_value_goes_to_a_reader_in_another_process(clock):
    bus, one = ports(clock, 1)
    bus.forwarder = Network()
    one.publish(DRONE_TOPICS.result, {"success": True})
    await clock.sleep(2.0)
    bus.add_remote_interests(
        [Interest("result", PORT_ADDRESSES.any_drone, PORT_ADDRESSES.first_observer)]
    )
    [(topic, source, to, payload, number, _, _, age)] = bus.forwarder.messages
    assert (topic, source, to, payload, number) == (
        "result",
        1,
        [PORT_ADDRESSES.first_observer],
        encode({"success": True}),
        0,
    )
    assert age == 2.0


@virtual
async def test_a_rate_limit_holds_on_average_and_never_bursts(clock):
    await clock.sleep(10.0)
    bus, one, _, _ = ports(clock, 1, 2, PORT_ADDRESSES.first_observer)
    slow, fast = (
        reading(bus, DRONE_TOPICS.state, 1, PORT_ADDRESSES.first_observer, rate=20.0),
        reading(bus, DRONE_TOPICS.state, 1, 2),
    )
    times = []
    slow.put = lambda value, age: times.append(clock.now())
    state, ticks = State.at((1, 2, 3)), 0
    async for due in clock.ticks(100):
        jitter = (ticks * 7919 % 1000) * 1000  # up to 1 ms late
        await clock.sleep_until(due + jitter)
        one.publish(DRONE_TOPICS.state, state)
        ticks += 1
        if ticks == 500:
            break
    assert fast.received == 500
    assert 97 <= len(times) <= 101
    for first, last in zip(times, times[20:], strict=False):
        assert last - first > 0.95


@virtual
async def test_a_port_is_served_at_the_fastest_rate_that_it_asked_for(clock):
    bus, one, _ = ports(clock, 1, 2)
    boxes = [
        reading(bus, DRONE_TOPICS.state, 1, 2, rate) for rate in (10.0, 50.0, 20.0)
    ]
    for _ in range(100):
        one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
        await clock.sleep(0.01)
    assert [box.received for box in boxes] == [50, 50, 50]
    everything = reading(bus, DRONE_TOPICS.state, 1, 2)
    for _ in range(10):
        one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert everything.received == 10


@virtual
async def test_any_is_every_other_drone_with_its_name(clock):
    bus, one, two, _ = ports(clock, 1, 2, PORT_ADDRESSES.first_observer)
    own, observer = (
        reading(bus, DRONE_TOPICS.state, PORT_ADDRESSES.any_drone, 1),
        reading(
            bus,
            DRONE_TOPICS.state,
            PORT_ADDRESSES.any_drone,
            PORT_ADDRESSES.first_observer,
        ),
    )
    named = reading(bus, DRONE_TOPICS.state, 2, 1)
    late = bus.port(3)
    seen, watched = [], []
    own.put = lambda value, age: seen.append(value)
    observer.put = lambda value, age: watched.append(value)
    for x, port in enumerate((one, two, late)):
        port.publish(DRONE_TOPICS.state, State.at((x, 0, 0)))
    assert [(source, state.p[0]) for source, state in seen] == [(2, 1.0), (3, 2.0)]
    assert [(source, state.p[0]) for source, state in watched] == [
        (1, 0.0),
        (2, 1.0),
        (3, 2.0),
    ]
    assert named.peek().p[0] == 1.0


@virtual
async def test_a_drone_that_comes_later_is_heard_by_its_earlier_reader(clock):
    bus, _ = ports(clock, 2)
    bus.forwarder = Network()
    box = reading(bus, DRONE_TOPICS.state, 1, 2)
    assert (bus.interests, bus.forwarder.changes) == ([Interest("state", 1, 2)], 1)
    bus.port(1).publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert box.received == 1


@virtual
async def test_interests_in_drones_elsewhere_are_told_once(clock):
    bus, _ = ports(clock, 2)
    bus.forwarder = Network()
    for _ in range(2):
        reading(bus, DRONE_TOPICS.state, 1, 2, rate=20.0)
    reading(bus, DRONE_TOPICS.state, 2, 2)
    assert bus.interests == [Interest("state", 1, 2, 20.0)]
    assert bus.forwarder.changes == 1


@virtual
async def test_remote_readers_come_and_go(clock):
    bus, one, two = ports(clock, 1, 2)
    bus.forwarder = Network()
    wanted = [
        Interest("state", PORT_ADDRESSES.any_drone, 7),
        Interest("state", 1, 8),
        Interest("round", 1, 8),
        Interest("state", 9, 8),
    ]
    bus.add_remote_interests(wanted)
    bus.add_remote_interests(
        [*wanted, Interest("nonsense", PORT_ADDRESSES.any_drone, 8)]
    )
    one.publish(MESSAGE_TOPICS.rounds, b"goes along edges")
    for port in (one, two):
        port.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert [(source, to) for _, source, to, *_ in bus.forwarder.messages] == [
        (1, [7, 8]),
        (2, [7]),
    ]
    bus.drop_readers([7])
    one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert [to for _, _, to, *_ in bus.forwarder.messages[2:]] == [[8]]


@virtual
async def test_a_drone_that_crashes_is_silent_and_keeps_its_readers_when_it_is_back(
    clock,
):
    bus, _, two = ports(clock, 1, 2)
    box, own = (
        reading(bus, DRONE_TOPICS.state, 1, 2),
        reading(bus, DRONE_TOPICS.state, 1, 1),
    )
    back = reading(bus, DRONE_TOPICS.state, 2, 1)
    bus.close(1)
    two.publish(DRONE_TOPICS.state, State.at((0, 0, 0)))
    two.send(Message(MESSAGE_TOPICS.rounds, two.address, b""), (1,))
    assert (back.received, bus.unroutable) == (0, 2)
    again = bus.port(1, incarnation=2)
    again.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert (box.received, own.received) == (1, 0)
    assert (again.incarnation, again.handlers, bus.drones()) == (2, {}, [2, 1])


@virtual
async def test_a_drone_that_comes_back_reads_again(clock):
    bus, one, _ = ports(clock, 1, 2)
    reading(bus, DRONE_TOPICS.state, 1, 2)
    bus.close(2)
    bus.port(2)
    box = reading(bus, DRONE_TOPICS.state, 1, 2)
    one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    assert (box.received, one.counters.sent) == (1, 1)


# What is wrong with a payload ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "payload",
    [b"", b"\xff\xff", encode(3.0), encode(Pose(np.zeros(7))), encode([1, 2])],
)
def test_what_is_not_a_state_is_counted_and_goes_nowhere(payload):
    @virtual
    async def check(clock):
        bus, _, two = ports(clock, 1, 2)
        box = reading(bus, DRONE_TOPICS.state, 1, 2)
        two.bus.deliver(Message(DRONE_TOPICS.state, 1, payload), (two.address,), 0.0)
        assert (box.received, two.counters.malformed, two.counters.received) == (
            0,
            1,
            1,
        )

    check()


@virtual
async def test_a_value_without_a_reader_is_not_decoded(clock):
    bus, _, two, _ = ports(clock, 1, 2, 3)
    reading(bus, DRONE_TOPICS.state, 3, 2)
    two.bus.deliver(Message(DRONE_TOPICS.state, 1, b"\xff"), (two.address,), 0.0)
    two.bus.deliver(Message(DRONE_TOPICS.pose, 1, b"\xff"), (two.address,), 0.0)
    assert (two.counters.malformed, two.counters.received) == (0, 2)


@virtual
async def test_untyped_topics_take_any_value(clock):
    bus, _, two = ports(clock, 1, 2)
    box = Latest(clock)
    bus.subscribe(MESSAGE_TOPICS.heartbeat, 1, 2, box)
    two.bus.deliver(
        Message(MESSAGE_TOPICS.heartbeat, 1, encode([1, "a"])), (two.address,), 0.1
    )
    assert box.peek() == [1, "a"]


@virtual
async def test_queues_keep_what_latest_would_replace(clock):
    bus, one, _ = ports(clock, 1, 2)
    box = reading(bus, DRONE_TOPICS.log, 1, 2)
    for k in range(3):
        one.publish(DRONE_TOPICS.log, f"line {k}")
    assert box.take() == ["line 0", "line 1", "line 2"]


@virtual
async def test_the_tap_sees_every_message_between_drones(clock):
    bus, one, _ = ports(clock, 1, 2)
    reading(bus, DRONE_TOPICS.state, 1, 1)
    seen = []
    bus.tap = lambda to, message, age: seen.append(
        (to, message.topic, *list_parts(message, age))
    )
    one.publish(DRONE_TOPICS.state, State.at((1, 2, 3)))
    one.send(
        Message(MESSAGE_TOPICS.rounds, one.address, b"xy", 5, "sum", 9), (2,), age=0.25
    )
    assert seen == [(2, MESSAGE_TOPICS.rounds, 1, b"xy", 5, "sum", 9, 0.25)]


@virtual
async def test_a_command_reader_gets_each_type_of_command(clock):
    bus, one, _ = ports(clock, 1, 2)
    box = reading(bus, DRONE_TOPICS.command, 1, 2)
    x = np.ones(14)
    for command in (
        FPQR(x[:4]),
        FRPY(x[:4]),
        Vel(x[:4]),
        XYZ("land", x[:5]),
        FullState(x),
    ):
        one.publish(DRONE_TOPICS.command, command)
        heard = box.peek()
        assert type(heard) is type(command)
        assert heard.flat.tolist() == command.flat.tolist()


def test_each_topic_has_a_number_and_a_name_of_its_own():
    assert len(TOPIC_BY_NUMBER) == len(ALL_TOPICS)
    assert len(TOPIC_BY_NAME) == len(ALL_TOPICS)
