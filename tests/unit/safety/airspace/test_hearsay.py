"""A drone that does not hear another is told of it by others."""

import contextlib
import math
from types import SimpleNamespace

import numpy as np
import pytest
from avoiding import AvoidingDrone

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.message import Message
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.config.tables import CollisionTable
from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.errors import CodecError
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.airspace.state_rates import (
    FIRST_NEWS_TIME,
    NEIGHBOUR_AGES,
    RELAY_REQUESTS,
    STATE_RATES,
)
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import FullState, State

FENCE = Fence.box((-9.0, -9.0, 0.0), (9.0, 9.0, 3.0))
HERE = (-1.0, 0.0, 1.0)


class Team:
    """Drones with their collision filters on one bus; 0 does not hear 1, which is elsewhere than it knows."""

    def __init__(self, count=4, flown=None):
        """flown: number of drones that are here; None: all"""
        flown = count if flown is None else flown
        self.seconds = 0.0
        self.bus = Bus(
            SimpleNamespace(
                now_ns=lambda: round(self.seconds * NS_PER_SECOND),
                now=lambda: self.seconds,
            )
        )
        for i in range(flown):
            self.bus.port(i)
        rules = AirspaceRules(CollisionTable(), 1.0, 0.0)
        self.airspace = Airspace(self.bus, range(count), rules)
        self.drones = [self.make_drone(i) for i in range(flown)]
        self.asked = []
        self.questions = []
        for i in range(flown):
            self.spy(i)

    def make_drone(self, i):
        traffic = Neighbours(self.airspace, i, keeps_all=True)
        return AvoidingDrone(CollisionTable(), traffic, FENCE, STANDARD_GAINS.position)

    def spy(self, i):
        taken = self.bus.ports[i].handlers[MESSAGE_TOPICS.wanted_states.number]
        self.bus.ports[i].handlers[MESSAGE_TOPICS.wanted_states.number] = (
            lambda message, age: (
                self.asked.append(i),
                self.note(i, message.payload),
                taken(message, age),
            )
        )

    def note(self, i, payload):
        """Keep a question to drone i."""
        with contextlib.suppress(CodecError):
            self.questions.append((self.seconds, i, decode(payload)))

    def row(self, i, j):
        return self.drones[i].traffic.row(j)

    def check(self):
        """Let drone 0 check the distances, and ask."""
        self.airspace.publish(0, State.at(HERE), 0.0)
        if 0 in self.airspace.step():
            self.drones[0].hearsay.seek()

    def say(self, j, p, to, v=(0.0, 0.0, 0.0)):
        """Drone j says its state to some."""
        for i in to:
            self.drones[i].traffic.hear((j, State.at(p, v)), 0.0)

    def fly(self, seconds, one=(3.0, 0.0, 1.0), hear_one=(2, 3)):
        """Fly drone 0 towards drone 1, which only some drones hear; all others hear each other ten times a second."""
        acted = []
        for _ in range(round(seconds / STATE_RATES.check_interval)):
            self.seconds += STATE_RATES.check_interval
            self.say(1, one, hear_one)
            for j in range(2, len(self.drones)):
                self.say(
                    j,
                    (0.0, float(j), 1.0),
                    [i for i in range(len(self.drones)) if i != j],
                )
            me, to = (
                State.at(HERE, (0.5, 0.0, 0.0)),
                FullState.at((1.0, 0.0, 1.0), (0.5, 0.0, 0.0)).flat,
            )
            self.check()
            acted.append(self.drones[0].fly_full_state(me, to, self.seconds))
        return acted


def test_an_unheard_drone_is_reported_by_others_and_does_not_count_as_heard():
    team = Team()
    team.say(1, (1.5, 0.0, 1.0), [0])
    acted = team.fly(20.0)
    assert not any(
        a is not None
        for a in acted[round(NEIGHBOUR_AGES.usable / STATE_RATES.check_interval) :]
    ), "it knows where 1 is: away"
    row = team.row(0, 1)
    assert row["state"][0] == 3.0
    assert team.seconds - row["state_time"] < 3.1, (
        "newer than it could have come near since"
    )
    assert team.seconds - row["heard_time"] == pytest.approx(20.0)
    assert not team.drones[0].is_cut_off
    assert set(team.asked) == {2, 3}


def test_a_drone_without_reports_brakes_near_the_unheard_one_and_asks_until_gone():
    team = Team()
    team.say(1, (0.5, 0.0, 1.0), [0])
    acted = team.fly(20.0, hear_one=())
    brakes = [
        k * STATE_RATES.check_interval
        for k, a in enumerate(acted, start=1)
        if a is not None and a[0] < -0.5
    ]
    assert brakes[0] == pytest.approx(
        NEIGHBOUR_AGES.usable, abs=2 * STATE_RATES.check_interval
    )
    assert brakes[-1] == pytest.approx(
        NEIGHBOUR_AGES.gone, abs=2 * STATE_RATES.check_interval
    )
    asked = len(team.asked)
    assert 2 * 20 < asked < 2 * (10 + 2 * 10 + 10), (
        "two others: in the first second, until it is gone, and then"
    )
    team.fly(5.0, hear_one=())
    assert 0 < len(team.asked) - asked <= 2 * 5, "two others, once a second"


def test_a_drone_never_heard_or_gone_is_known_once_another_drone_hears_it():
    team = Team()
    team.fly(2.0)
    assert team.row(0, 1)["state"][0] == 3.0, "never heard"
    team.fly(2.0 * NEIGHBOUR_AGES.gone, hear_one=())
    team.fly(2.0, one=(0.0, 0.5, 1.0))
    assert team.row(0, 1)["state"][1] == 0.5, "it was gone"


def test_a_reported_drone_that_approaches_is_avoided():
    team = Team()
    team.say(1, (3.0, 0.0, 1.0), [0])
    acted = team.fly(4.0, one=(-0.4, 0.0, 1.0))
    assert acted[-1][0] < -0.5


def test_no_drone_asks_while_all_are_heard_or_far_away():
    team = Team()
    team.fly(30.0, hear_one=(0, 2, 3))
    assert team.asked == []
    team.say(1, (30.0, 0.0, 1.0), [0])
    team.fly(6.0, one=(30.0, 0.0, 1.0))
    assert team.asked == [], "it cannot be near yet"
    team.fly(20.0, one=(30.0, 0.0, 1.0))
    assert team.seconds - team.row(0, 1)["state_time"] < NEIGHBOUR_AGES.gone, (
        "nor when it counts as gone is it forgotten"
    )


def test_a_drone_asks_about_few_drones_in_each_check_and_about_all_in_turn():
    silent = range(1, 3 * RELAY_REQUESTS.most_now + 2)
    last = silent.stop
    team = Team(last + 1)
    sought = []
    handlers = team.bus.ports[last].handlers
    take = handlers[MESSAGE_TOPICS.wanted_states.number]
    handlers[MESSAGE_TOPICS.wanted_states.number] = lambda message, age: (
        sought.append(message.open()),
        take(message, age),
    )
    for j in silent:
        team.say(j, (0.1 * j - 1.0, 1.0, 1.0), [0])
    team.seconds = NEIGHBOUR_AGES.silent + 0.1
    for _ in range(6):
        team.seconds += STATE_RATES.check_interval
        team.say(last, (0.0, 2.0, 1.0), [0])
        team.check()
    assert sought, "the last drone alone is heard"
    assert max(len(those) for those in sought) == RELAY_REQUESTS.most_now
    assert {j for those in sought for j in those} == set(silent)


def test_however_many_drones_fall_silent_none_is_gone_that_others_hear():
    """Drone 0 does not hear sixty drones nearby; five others hear them, and are heard."""
    silent = range(1, 61)
    heard = range(61, 66)
    team = Team(66)
    for j in silent:
        team.say(j, (0.2 * (j % 8), 0.2 * (j // 8), 1.0), [0])
    oldest = 0.0
    for _ in range(150):
        team.seconds += STATE_RATES.check_interval
        for j in silent:
            team.say(j, (0.2 * (j % 8), 0.2 * (j // 8), 1.0), heard)
        for j in heard:
            team.say(j, (0.0, 0.1 * j - 8.0, 1.0), [0])
        team.check()
        ages = [team.seconds - team.row(0, j)["state_time"] for j in silent]
        oldest = max(oldest, *ages)
    assert NEIGHBOUR_AGES.usable < oldest < 0.25 * NEIGHBOUR_AGES.gone


@pytest.mark.parametrize("lost", [0.0, 2.0])
def test_absent_drones_take_no_turns_of_a_drone_that_others_hear(lost):
    """Drone 1 is near and relayed; of 500 absent drones some have landed. Answers are lost for a while."""
    team = Team(500, flown=5)
    handlers = team.bus.ports[0].handlers
    take = handlers[MESSAGE_TOPICS.relayed_states.number]
    handlers[MESSAGE_TOPICS.relayed_states.number] = lambda message, age: (
        take(message, age) if team.seconds > NEIGHBOUR_AGES.silent + lost else None
    )
    for j in range(5, 250):
        team.say(j, (0.2 * (j % 30), 0.2 * (j // 30), 0.0), [0])
    team.seconds = NEIGHBOUR_AGES.silent
    team.say(1, (-0.5, 0.5, 1.0), [0])
    ages = []
    for _ in range(150):
        team.seconds += STATE_RATES.check_interval
        team.say(1, (-0.5, 0.5, 1.0), (2, 3, 4))
        for j in (2, 3, 4):
            team.say(j, (0.0, float(j), 1.0), [0])
        team.check()
        ages.append(team.seconds - team.row(0, 1)["state_time"])
    assert max(ages) < max(
        NEIGHBOUR_AGES.usable, lost + RELAY_REQUESTS.interval_if_unanswered + 0.3
    )


class AbsentTeam(Team):
    """Drone 0 hears the drones 1 to `heard`; the last drone, `hidden`, may fly; the others are absent."""

    def __init__(self, heard, absent):
        super().__init__(heard + absent + 1, flown=heard + 1)
        self.heard = range(1, heard + 1)
        self.hidden = heard + absent

    def fly(self, seconds, witnesses=()):
        """Fly; `witnesses` hear the hidden drone nearby."""
        for _ in range(round(seconds / STATE_RATES.check_interval)):
            self.seconds += STATE_RATES.check_interval
            for j in self.heard:
                self.say(j, (0.2 * j - 2.05, 2.0, 1.0), [0])
            self.say(self.hidden, (-0.5, 0.0, 1.0), witnesses)
            self.check()


@pytest.mark.parametrize("absent", [5, 60, 300])
def test_questions_about_absent_drones_are_few_however_many_are_absent(absent):
    team = AbsentTeam(20, absent)
    team.fly(FIRST_NEWS_TIME)
    first = {sought for _, _, those in team.questions for sought in those}
    assert first == set(range(21, 21 + absent)), "about all at once"
    team.fly(10.0 * RELAY_REQUESTS.interval_if_gone)
    began = team.seconds
    team.fly(20.0 * RELAY_REQUESTS.interval_if_gone)
    rounds = {}
    for seconds, asked, those in team.questions:
        if seconds > began:
            rounds.setdefault(seconds, {})[asked] = those
    assert len(rounds) == 20, "once a second"
    for questions in rounds.values():
        assert {5, 6} <= set(questions), "the nearest to drone 0"
        assert len(questions) == RELAY_REQUESTS.nearest_asked + 1
        for those in questions.values():
            assert len(those) == min(absent, RELAY_REQUESTS.most_gone)


@pytest.mark.parametrize("was_heard", [False, True])
@pytest.mark.parametrize("witness", [5, 7, 8])
def test_a_drone_among_many_absent_ones_is_known_if_any_other_hears_it(
    was_heard, witness
):
    """Each heard drone is asked in turn, also where the number of absent drones is even, as that of turns."""
    team = AbsentTeam(20, 60)
    team.fly(FIRST_NEWS_TIME, witnesses=[0] if was_heard else [])
    team.fly(NEIGHBOUR_AGES.gone + 1.0)
    rounds = math.ceil(60 / RELAY_REQUESTS.most_gone)
    if witness != 5:  # which is near drone 0
        rounds *= 20
    began = team.seconds
    team.fly(rounds * RELAY_REQUESTS.interval_if_gone, witnesses=[witness])
    row = team.row(0, team.hidden)
    assert row is not None
    assert row["state_time"] > began, "it was told"


def test_others_are_asked_about_a_standing_drone_later():
    team = Team()
    team.say(1, (0.5, 0.0, 0.0), [0])
    team.fly(NEIGHBOUR_AGES.usable - 0.05, hear_one=())
    assert team.asked == []
    team.fly(0.3, hear_one=())
    assert team.asked


def test_a_drone_that_hears_no_more_than_half_is_cut_off_whatever_it_is_told():
    team = Team(6)
    for j in range(1, 6):
        team.say(j, (2.0, float(j), 1.0), [0])
    team.seconds = NEIGHBOUR_AGES.silent + 0.1
    for j in (1, 2, 3):
        team.drones[0].traffic.told((j, State.at((2.0, float(j), 1.0))), 0.0)
    team.say(4, (2.0, 4.0, 1.0), [0])
    to = FullState.at(HERE).flat
    team.drones[0].fly_full_state(State.at(HERE), to, team.seconds)
    assert team.drones[0].is_cut_off


def test_only_what_is_new_is_told_with_its_age_and_that_of_the_way():
    team, told = Team(), []
    take = team.bus.ports[0].handlers[MESSAGE_TOPICS.relayed_states.number]
    team.bus.ports[0].handlers[MESSAGE_TOPICS.relayed_states.number] = (
        lambda message, age: told.append(message)
    )
    ask = team.bus.ports[2].handlers[MESSAGE_TOPICS.wanted_states.number]
    ask(Message(MESSAGE_TOPICS.wanted_states, 0, encode([1, 0, 2, 99]), 1), 0.0)
    assert told == [], "it has never heard of 1"
    team.say(1, (1.0, 0.0, 1.0), [2])
    team.seconds = NEIGHBOUR_AGES.usable - 0.1
    ask(Message(MESSAGE_TOPICS.wanted_states, 0, encode([1, 99]), 2), 0.0)
    [message] = told
    take(message, 0.2)
    assert team.row(0, 1)["state_time"] == pytest.approx(-0.2)
    team.seconds = NEIGHBOUR_AGES.usable + 0.1
    ask(Message(MESSAGE_TOPICS.wanted_states, 0, encode([1]), 3), 0.0)
    assert len(told) == 1


def test_those_are_asked_that_are_heard_themselves():
    team = Team(5)
    team.say(1, (0.5, 0.0, 1.0), [0])
    for _ in range(10):
        team.seconds += STATE_RATES.check_interval
        team.say(2, (5.0, 5.0, 1.0), [0])
        for j in (3, 4):
            team.drones[0].traffic.told((j, State.at((0.0, float(j), 1.0))), 0.0)
        team.drones[0].fly_full_state(
            State.at(HERE),
            FullState.at(HERE).flat,
            team.seconds,
        )
        team.check()
    assert set(team.asked) == {2}


def test_a_drone_that_stood_on_the_floor_is_asked_for_seldom_in_the_end():
    team = Team()
    team.say(1, (0.5, 0.0, 0.02), [0])
    team.fly(NEIGHBOUR_AGES.gone, hear_one=())
    asked = len(team.asked)
    assert asked > 2 * 10
    team.fly(5.0, hear_one=())
    assert 0 < len(team.asked) - asked <= 2 * 5


def test_all_that_are_heard_are_asked_in_turn_however_many_are_sought():
    """0 hears 1 to 4, and of these 4 alone hears 8."""
    team = Team(9)
    for j in range(5, 9):
        team.say(j, (0.5, 0.2 * j - 1.0, 1.0), [0])
    for _ in range(60):
        team.seconds += STATE_RATES.check_interval
        for j in range(1, 5):
            team.say(j, (0.0, float(j), 1.0), [0])
        team.say(8, (5.0, 0.0, 1.0), [4])
        team.drones[0].fly_full_state(
            State.at(HERE),
            FullState.at(HERE).flat,
            team.seconds,
        )
        team.check()
    assert team.row(0, 8)["state"][0] == 5.0
    assert team.seconds - team.row(0, 8)["state_time"] < 3.5


def test_a_late_direct_state_still_counts_as_heard_beside_earlier_reports():
    team = Team()
    for _ in range(50):
        team.seconds += STATE_RATES.check_interval
        team.drones[0].traffic.told((1, State.at((3.0, 0.0, 1.0))), 0.3)
        team.drones[0].traffic.hear((1, State.at((2.0, 0.0, 1.0))), 0.4)
    assert team.row(0, 1)["state"][0] == 3.0
    assert team.seconds - team.row(0, 1)["heard_time"] == pytest.approx(0.4)


GARBAGE = [
    b"",
    b"\xff",
    encode(None),
    encode(3.0),
    encode({1: 2}),
    encode([1] * 99),
    encode([np.zeros(3)]),
]


@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        *(
            (topic, payload)
            for topic in (MESSAGE_TOPICS.wanted_states, MESSAGE_TOPICS.relayed_states)
            for payload in GARBAGE
        ),
        *(
            (MESSAGE_TOPICS.relayed_states, encode([said]))
            for said in (["a", 1, 2], [1, 2], [1, State.at(HERE), -1.0], [1, HERE, 0.1])
        ),
        *(
            (
                MESSAGE_TOPICS.relayed_states,
                encode([[np.zeros(3), State.at(HERE), old]]),
            )
            for old in (0.1, np.inf)
        ),
        *(
            (MESSAGE_TOPICS.wanted_states, encode([said]))
            for said in ("1", True, 1.0, [1])
        ),
    ],
)
def test_what_is_no_message_is_counted_and_changes_nothing(topic, payload):
    team = Team()
    before = team.drones[0].traffic.rows.copy()
    team.bus.ports[0].handlers[topic.number](Message(topic, 2, payload, 1), 0.0)
    assert team.bus.ports[0].counters.malformed == 1
    np.testing.assert_array_equal(team.drones[0].traffic.rows, before)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e308, -1e9])
@pytest.mark.parametrize("part", ["flat", "a"])
def test_a_state_that_is_none_is_not_heard(part, bad):
    """Numbers that overflow on the way would make a drone invisible."""
    team = Team()
    team.say(1, (0.0, 0.0, 1.0), [0])
    before = team.drones[0].traffic.rows.copy()
    flat, a = State.at((0.0, 0.0, 1.0)).flat, np.zeros(3)
    (flat if part == "flat" else a)[0] = bad
    team.drones[0].traffic.hear((1, State(flat, 0.0, a)), 0.0)
    np.testing.assert_array_equal(team.drones[0].traffic.rows, before)
    assert MESSAGE_TOPICS.wanted_states.impaired
    assert MESSAGE_TOPICS.relayed_states.impaired, (
        "the simulated network acts on them too"
    )
