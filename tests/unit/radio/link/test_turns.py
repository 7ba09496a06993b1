"""The turns of the links of a dongle: visits are not interrupted, and what is urgent goes first."""

import threading
import time

import pytest

from crazychoir.radio.link import turns
from crazychoir.radio.link.turns import DongleTurns


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """A visit waits long for its next packet, so that a busy machine changes nothing."""
    monkeypatch.setattr(turns, "HOLDING_TIME", 5.0)


def queue_up(taken, order, names, first=()):
    """Let links wait in this order; return their threads."""
    threads = []
    for name in names:

        def take(name=name):
            with taken.take(name, first=name in first):
                order.append(name)

        thread = threading.Thread(target=take)
        thread.start()
        threads.append(thread)
        until(lambda: len(taken._waiting) == len(threads))
    return threads


def until(holds):
    for _ in range(2000):
        if holds():
            return
        time.sleep(0.001)
    raise AssertionError("not so within 2 s")


def test_links_have_turns_in_the_order_in_which_they_came():
    taken, order = DongleTurns(), []
    with taken.take("a"):
        threads = queue_up(taken, order, "bcd")
    for thread in threads:
        thread.join(2.0)
    assert order == ["b", "c", "d"]


def test_a_visited_link_goes_on_before_the_others_but_not_for_ever():
    taken, order = DongleTurns(longest_visit=3), []
    with taken.take("a"):
        threads = queue_up(taken, order, "bc")
        taken.hold("a")
    for _ in range(2):
        with taken.take("a"):
            order.append("a")
            taken.hold("a")
    threads += queue_up_last(taken, order)
    for thread in threads:
        thread.join(2.0)
    assert order == ["a", "a", "b", "c", "a"]


def queue_up_last(taken, order):
    def take():
        with taken.take("a"):
            order.append("a")

    until(lambda: "c" in order)
    thread = threading.Thread(target=take)
    thread.start()
    return [thread]


def test_a_link_that_does_not_go_on_loses_its_turn(monkeypatch):
    monkeypatch.setattr(turns, "HOLDING_TIME", 0.02)
    taken, order = DongleTurns(), []
    with taken.take("a"):
        threads = queue_up(taken, order, "b")
        taken.hold("a")
    assert order == []
    threads[0].join(2.0)
    assert order == ["b"]


def test_what_is_urgent_goes_first_and_ends_a_visit():
    taken, order = DongleTurns(), []
    with taken.take("a"):
        taken.hold("a")
        threads = queue_up(taken, order, "bc", first="c")
    threads[1].join(2.0)
    assert order[0] == "c"
    threads[0].join(2.0)
    assert order == ["c", "b"]


def test_a_visit_is_not_held_on_while_something_urgent_waits():
    taken, order = DongleTurns(), []
    with taken.take("a"):
        threads = queue_up(taken, order, "bc", first="c")
        taken.hold("a")
    threads[1].join(2.0)
    assert order[:1] == ["c"]
    threads[0].join(2.0)
    assert order == ["c", "b"]
