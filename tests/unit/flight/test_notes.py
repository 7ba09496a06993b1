"""The notes of a drone: what its status and its log say."""

import logging

from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.flight.notes import FlightNotes


def make_notes(clock):
    return FlightNotes(Bus(clock).port(3))


def test_a_note_names_its_drone_once_and_is_logged_once(caplog):
    @virtual
    async def check(clock):
        notes = make_notes(clock)
        notes.say("pose", "drone 3: no pose", is_grave=True)
        notes.say("pose", "no pose", is_grave=True)
        assert notes.text == "no pose"
        assert notes.is_grave

    check()
    assert caplog.messages == ["drone 3: no pose"]


def test_notes_of_one_topic_share_the_limit_of_log_lines(caplog):
    @virtual
    async def check(clock):
        notes = make_notes(clock)
        for topic, text in (("a", "one"), ("a", "two"), ("b", "three")):
            notes.say(topic, text)
            assert notes.text == text, "the status says all of them"
        await clock.sleep(1.0)
        notes.say("a", "two")

    check()
    assert caplog.messages == ["drone 3: one", "drone 3: three", "drone 3: two"]


def test_only_the_first_evasion_of_a_flight_is_logged(caplog):
    caplog.set_level(logging.INFO)

    @virtual
    async def check(clock):
        notes = make_notes(clock)
        for is_first in (True, False, False):
            notes.say_evades(7, is_first)
            assert notes.text == "keeps clear of drone 7"
            assert not notes.is_grave

    check()
    assert caplog.messages == ["drone 3: keeps clear of drone 7"]


@virtual
async def test_the_end_of_an_evasion_removes_its_note_and_no_newer_one(clock):
    notes = make_notes(clock)
    for other in (7, None):
        notes.say_evades(other, is_first=False)
        assert notes.text
        notes.end_evasion()
        assert notes.text == ""
    notes.say_evades(7, is_first=False)
    notes.say("pose", "no pose", is_grave=True)
    notes.end_evasion()
    assert notes.text == "no pose"
    assert notes.is_grave


def test_a_drone_that_hears_too_few_says_that_it_brakes(caplog):
    @virtual
    async def check(clock):
        make_notes(clock).say_evades(None, is_first=True)

    check()
    assert caplog.messages == ["drone 3: braking: other drones are not heard"]


@virtual
async def test_a_report_reaches_the_log_of_observers(clock):
    notes = make_notes(clock)
    published = []
    notes._port.publish = lambda topic, value: published.append((topic, value))
    notes.report("braked", "braked twice")
    assert notes.text == "braked twice"
    assert published == [(DRONE_TOPICS.log, "drone 3: braked twice")]


@virtual
async def test_each_note_says_anew_whether_it_is_grave(clock):
    notes = make_notes(clock)
    notes.say("cut", "motors cut", is_grave=True)
    notes.say("goal", "outside the fence")
    assert not notes.is_grave
