"""A message is the same for all its readers as if each had decoded its bytes."""

from unittest.mock import patch

import numpy as np
import pytest

from crazychoir.bus import message as module
from crazychoir.bus.codec import decode, encode
from crazychoir.bus.message import Message
from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS
from crazychoir.errors import CodecError
from crazychoir.types import Failure, State

ROUNDS = MESSAGE_TOPICS.rounds
VALUES = [
    None,
    True,
    3,
    2.5,
    "text",
    b"bytes",
    np.float64(1.5),
    np.arange(6.0),
    np.arange(6).reshape(2, 3),
    (1, 2.0, "three"),
    [np.zeros(2), (1, 2)],
    {"a": 1, (0, 1): np.ones(3)},
    State.at((1.0, 2.0, 3.0)),
    Failure(3, "reason"),
]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_every_reader_gets_what_its_own_decoding_would_give(value):
    payload = encode(value)
    message = Message(ROUNDS, 1, payload)
    for _ in range(3):
        opened = message.open()
        assert type(opened) is type(decode(payload))
        assert encode(opened) == encode(decode(payload))


@pytest.mark.parametrize("value", [[1, 2], {"a": [1]}, (3, [4])])
def test_a_reader_that_changes_its_list_changes_that_of_no_other(value):
    message = Message(ROUNDS, 1, encode(value))
    first = message.open()
    first.clear()
    assert encode(message.open()) == encode(value)


def test_no_reader_can_change_an_array():
    array = Message(ROUNDS, 1, encode(np.arange(3.0))).open()
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1.0
    with pytest.raises(ValueError, match="cannot set WRITEABLE"):
        array.flags.writeable = True


def test_a_sender_that_goes_on_computing_changes_no_message():
    value = np.arange(3.0)
    message = Message(ROUNDS, 1, encode(value))
    value += 1.0
    assert message.open().tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("value", "times"), [(np.zeros(6), 1), (1.5, 1), ([1, 2], 3), ({"a": 1}, 3)]
)
def test_a_value_that_cannot_be_changed_is_decoded_once(value, times):
    message = Message(ROUNDS, 1, encode(value))
    with patch.object(module, "decode", wraps=decode) as decoding:
        for _ in range(3):
            message.open()
    assert decoding.call_count == times


def test_a_value_of_another_type_than_the_topic_carries_is_refused_each_time():
    message = Message(DRONE_TOPICS.state, 1, encode(3.0))
    for _ in range(2):
        with pytest.raises(CodecError, match="state: found a float; allowed: State"):
            message.open()
