"""PlanNotes: which methods failed and which tasks are left alone, each told once, by one robot."""

from types import SimpleNamespace

import pytest

from crazychoir.guidance.delivery.plan_notes import (
    NO_PLAN_REASON,
    TOO_FAR_REASON,
    PlanNotes,
)
from crazychoir.guidance.delivery.replanning import AUCTION_METHOD, PlanShare
from crazychoir.guidance.tasks.task_book import Task, TaskBook

BOOK = TaskBook([Task(j, 0, False, (0.0, 0.0), (1.0, 1.0)) for j in (1, 2)])


@pytest.fixture
def notes():
    news = SimpleNamespace(
        id=3,
        book=BOOK,
        members=(3,),
        standings=lambda: BOOK.standings((3,), recover=False),
    )
    site = SimpleNamespace(
        explain_bad_place=lambda task, place, robot: "",
        explain_unservable=lambda task: "too heavy" if task.id == 1 else "",
        explain_wait=lambda task, flying: "",
    )
    return PlanNotes(news, site)


def share(*unserved, **trouble):
    return PlanShare((), unserved, BOOK, False, {}, trouble)


def test_each_task_is_left_alone_for_its_reason_and_logged_once(notes, caplog):
    notes.note(1, share(1, 2), speaks=True)
    notes.note(2, share(1, 2), speaks=True)
    assert notes.unserved == {1: "too heavy", 2: TOO_FAR_REASON}
    assert caplog.text.count("drone 3: task 1 is left alone: too heavy") == 1
    notes.note(3, share(2), speaks=True)
    assert notes.unserved == {2: TOO_FAR_REASON}


def test_a_method_that_failed_was_replaced_by_the_auction(notes, caplog):
    notes.note(4, share(columns="it raised"), speaks=True)
    assert notes.fallbacks == [
        {
            "planning": 4,
            "method": "columns",
            "why": "it raised",
            "instead": f"planned by {AUCTION_METHOD}",
        }
    ]
    assert "planning 4: columns: it raised; planned by" in caplog.text


def test_without_any_plan_all_tasks_have_that_reason(notes):
    notes.note(1, share(1, 2, **{AUCTION_METHOD: "it raised"}), speaks=True)
    assert notes.unserved == dict.fromkeys((1, 2), f"{NO_PLAN_REASON}: it raised")


def test_robots_that_do_not_speak_record_the_same_and_log_nothing(notes, caplog):
    notes.note(1, share(1, columns="it raised"), speaks=False)
    assert len(notes.fallbacks) == len(notes.unserved) == 1
    assert caplog.text == ""
