"""The messages about a roster on the wire."""

from dataclasses import replace

import pytest

from crazychoir.bus.codec import encode
from crazychoir.errors import CodecError
from crazychoir.team.message_kind import MOST_EPOCHS
from crazychoir.team.messages import (
    GoMessage,
    HoldAnswer,
    HoldRequest,
    Roster,
    TeamHeartbeat,
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


def test_an_epoch_that_does_not_fit_into_a_message_is_refused():
    beat = TeamHeartbeat(1, MOST_EPOCHS - 1, 0, (), (), "abc")
    assert TeamHeartbeat.of(beat.wire()) == beat
    too_large = replace(beat, epoch=MOST_EPOCHS)
    with pytest.raises(ValueError, match=f"epoch {MOST_EPOCHS}; allowed: below"):
        TeamHeartbeat.of(too_large.wire())
