from types import SimpleNamespace

import pytest

from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.receipts import MOST_RECEIPTS, RECEIPT_KINDS, ReceiptBook

CLOCK = SimpleNamespace(now=lambda: 7.0)


@pytest.fixture
def watch():
    return EventLog(CLOCK)


@pytest.fixture
def book(watch):
    return ReceiptBook(CLOCK, watch)


def test_a_new_receipt_waits_for_each_of_its_drones(book):
    receipt = book.add("land", [0, 2], "gently")
    assert (receipt.number, receipt.verb, receipt.words, receipt.t) == (
        1,
        "land",
        "gently",
        7.0,
    )
    assert receipt.answers == dict.fromkeys((0, 2), (RECEIPT_KINDS.sent, ""))
    assert receipt.open
    assert not receipt.done()


def test_only_a_changed_answer_changes_the_version(book):
    receipt = book.add("land", [0], "")
    before = book.version
    book.answer(receipt, 0, ANSWER_TEXTS.accepted)
    book.answer(receipt, 0, ANSWER_TEXTS.accepted)
    assert receipt.version == book.version == before + 1
    assert book.after(before) == [receipt]
    assert book.after(book.version) == []


@pytest.mark.parametrize(
    ("kind", "lines"),
    [
        (ANSWER_TEXTS.refused, ["land: refused: why"]),
        (RECEIPT_KINDS.silent, ["land: silent: why"]),
        (RECEIPT_KINDS.unfinished, ["land: unfinished: why"]),
        (ANSWER_TEXTS.done, []),
    ],
)
def test_a_drone_that_does_not_obey_gets_a_line_of_the_log(book, watch, kind, lines):
    book.answer(book.add("land", [0], ""), 0, kind, "why")
    assert [line.text for line in watch.after(0)] == lines


def test_a_withdrawn_order_is_no_trouble(book, watch):
    receipt = book.add("land", [0], "")
    before = book.version
    book.withdraw(receipt, 0, "stop")
    assert receipt.answers == {0: (RECEIPT_KINDS.withdrawn, "by stop")}
    assert book.after(before) == [receipt]
    assert watch.after(0) == []


def test_a_receipt_is_found_by_its_key_only(book):
    keyed = book.add("emergency stop", [0], "", "a")
    book.add("emergency stop", [0], "")
    assert book.find("a") is keyed
    assert book.find("b") is None
    assert book.find("") is None


def test_the_oldest_receipts_are_forgotten_but_pinned_ones_stay(book):
    stop = book.add("emergency stop", [0], "")
    book.pin(stop)
    second = book.add("land", [0], "")
    for _ in range(MOST_RECEIPTS - 1):
        book.add("hold", [0], "")
    assert len(book.receipts) == MOST_RECEIPTS
    assert book.receipts[0] is stop
    assert second not in book.receipts
    book.unpin(stop)
    book.add("hold", [0], "")
    assert stop not in book.receipts


def test_a_pinned_receipt_is_forgotten_if_all_are_pinned(book):
    receipts = [book.add("emergency stop", [0], "") for _ in range(MOST_RECEIPTS)]
    for receipt in receipts:
        book.pin(receipt)
    book.add("land", [0], "")
    assert receipts[0] not in book.receipts
    assert len(book.receipts) == MOST_RECEIPTS
