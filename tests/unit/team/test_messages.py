"""The messages about a roster on the wire."""

import pytest

from crazychoir.bus.codec import encode
from crazychoir.errors import CodecError
from crazychoir.team.messages import (
    GoMessage,
    HoldAnswer,
    HoldRequest,
    Roster,
    read_roster_message,
)

ROSTER = Roster(2, {0: 10, 3: 13}, [[0, 3]], False, 7, 40, "abc", "1")


@pytest.mark.parametrize(
    "message",
    [
        GoMessage(ROSTER, 1.5),
        HoldRequest(3),
        HoldAnswer(3, 41, {3: 13, 0: 10}),
        HoldAnswer(3, 0, {}),
    ],
    ids=str,
)
def test_a_message_about_a_roster_arrives_as_it_was_sent(message):
    arrived = read_roster_message(message.wire())
    assert arrived == message
    assert type(arrived) is type(message)


def test_the_members_of_an_answer_keep_their_order():
    answer = read_roster_message(HoldAnswer(3, 41, {3: 13, 0: 10}).wire())
    assert isinstance(answer, HoldAnswer)
    assert list(answer.members) == [3, 0]


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        encode(None),
        encode([3]),
        encode({"epoch": 1}),
        HoldAnswer(3, 41, {}).wire()[:-1],
        HoldRequest(3).wire()[:1] + b"\x91\xa13",
    ],
    ids=str,
)
def test_what_is_no_message_about_a_roster_is_refused(payload):
    with pytest.raises(CodecError):
        read_roster_message(payload)
