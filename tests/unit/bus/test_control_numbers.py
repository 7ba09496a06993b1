"""Which control messages of Zenoh a newer one of a socket has overtaken."""

from crazychoir.bus import control_numbers
from crazychoir.bus.control_numbers import ControlNumbers
from crazychoir.bus.frames import Envelope
from crazychoir.bus.topics import DRONE_TOPICS, Topic


def make_message(topic: Topic, number: int, source: int = 1) -> Envelope:
    return Envelope(topic.number, source, (0,), number, 0, 0.0, "", b"")


def test_an_older_state_of_the_same_drone_is_overtaken() -> None:
    numbers = ControlNumbers()
    numbers.note([make_message(DRONE_TOPICS.state, 8)])
    late = [make_message(DRONE_TOPICS.state, n) for n in (7, 8, 9, 0)]
    assert numbers.drop_overtaken(late) == late[1:]
    other = [make_message(DRONE_TOPICS.state, 7, source=2)]
    assert numbers.drop_overtaken(other) == other


def test_a_frame_with_states_of_other_drones_is_not_overtaken() -> None:
    numbers = ControlNumbers()
    numbers.note([make_message(DRONE_TOPICS.airspace, 8)])
    late = [make_message(DRONE_TOPICS.airspace, 7)]
    assert numbers.drop_overtaken(late) == late


def test_a_peer_with_endless_sources_takes_no_memory() -> None:
    numbers = ControlNumbers()
    for source in range(3 * control_numbers.MOST_STREAMS):
        numbers.note([make_message(DRONE_TOPICS.state, 1, source)])
    assert len(numbers._newest) <= control_numbers.MOST_STREAMS + 1
