"""Answers about virtual drones, in parts that fit into datagrams."""

import pytest
from virtual_time import virtual

from crazychoir.errors import CodecError
from crazychoir.radio.virtual import questions as questions_module
from crazychoir.radio.virtual.questions import ServerQuestions
from crazychoir.radio.virtual.server import VirtualServer
from crazychoir.radio.virtual.setup import place_on_grid


def make_questions(clock, n: int) -> ServerQuestions:
    hall = place_on_grid(n, 19850, None)
    server = VirtualServer(clock, hall.world(0), hall.seats, hall.poses)
    return server.questions


@virtual
async def test_faults_are_set_and_listed(clock) -> None:
    questions = make_questions(clock, 2)
    assert questions.answer({"faults": {"1": {"loss": 0.25}}}) == {"done": True}
    listed = questions.answer({"ask": "faults"})
    assert [row["loss"] for row in listed["drones"].values()] == [0.0, 0.25]
    assert "more" not in listed


def test_answers_in_parts_hold_each_drone_once_and_name_the_part(monkeypatch) -> None:
    @virtual
    async def check(clock) -> None:
        questions = make_questions(clock, 5)
        monkeypatch.setattr(questions_module, "ANSWER_SIZE", 1)
        found = []
        answer = questions.answer({"ask": "state"})
        assert "after" not in answer
        while answer.get("more"):
            found += answer["drones"]
            answer = questions.answer({"ask": "state", "after": found[-1]})
            assert answer["after"] == found[-1]
        assert [*found, *answer["drones"]] == [0, 1, 2, 3, 4]

    check()


@virtual
async def test_a_standing_drone_is_described(clock) -> None:
    row = make_questions(clock, 1).describe_drone(0)
    assert (row["tumbled"], row["crashed"], row["resting"]) == (False, "", True)
    assert (row["client"], row["at"]) == (None, ["127.0.0.1", 19850])
    assert len(row["p"]) == len(row["v"]) == 3


@virtual
async def test_an_unknown_question_is_refused_with_the_list_of_allowed_ones(
    clock,
) -> None:
    with pytest.raises(CodecError, match=r'\{"ask": "state"\}'):
        make_questions(clock, 1).answer({"ask": "what"})
