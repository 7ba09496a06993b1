"""A law gives the same bits for one drone and for a team, whatever is heard."""

from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.agents.bearing_formation import BearingFormation
from crazychoir.agents.containment import Containment
from crazychoir.agents.crossing import Straight
from crazychoir.agents.distance_formation import DistanceFormation
from crazychoir.guidance.aggregative import AggregativeGuidance
from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import LAW_ROW, LawDecision, ReferenceKind
from crazychoir.guidance.decision.team import (
    Team,
    has_team_law,
    read_references,
)
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.formation.bearing import BearingLaw
from crazychoir.guidance.formation.random_edges import RandomEdges
from crazychoir.planning.smoothing import GoalSmoother
from crazychoir.types import Acceleration, FullState, State, Velocity

NEIGHBORS = {0: (1, 2, 3), 1: (0, 2), 2: (0, 1, 3, 4), 3: (0, 2, 4), 4: (2, 3)}
SHAPE = {0: (0, 0, 1), 1: (1, 0, 1), 2: (1, 1, 1.5), 3: (0, 1, 1), 4: (0.5, 2, 0.7)}


def normalised(i):
    return BearingFormation(i, SHAPE, NEIGHBORS[i])


def paper(i):
    law = BearingLaw("paper", 1.6, 4.6, 0.5)
    return BearingFormation(i, SHAPE, NEIGHBORS[i], law)


def flat_distances(i):
    return DistanceFormation({j: 0.5 + j for j in NEIGHBORS[i]}, 0.6, 1.2, 0.9)


def distances(i):
    return DistanceFormation({j: 0.5 + j for j in NEIGHBORS[i]}, 0.6, 1.2, None)


def random_edges(i):
    return containment(i, 0.5)


def containment(i, share=1.0):
    law = Containment(RandomEdges(i, NEIGHBORS[i], share, 3), 0.8, 1.6)
    law.member = SimpleNamespace(clock=Clock())
    return law


class Clock:
    """A clock that the test sets."""

    epoch_ns = 3_000_000_000
    ns = 0

    def now_ns(self):
        return Clock.ns


def draw_state(random):
    return State(random.normal(size=13), 0.01, random.normal(size=3))


def build_team():
    """Return the rows of five drones that all step."""
    rows = np.zeros(len(NEIGHBORS), LAW_ROW)
    rows["decision"] = LawDecision.STEP
    ends = np.cumsum([len(ids) for ids in NEIGHBORS.values()])
    rows["end_edge"] = ends
    rows["first_edge"][1:] = ends[:-1]
    return Team(rows, np.zeros(ends[-1], HEARING_ROW), epoch_ns=Clock.epoch_ns)


def fill(team, states, heard):
    """Write the states, and what is heard, into the rows."""
    team.rows["kind"] = ReferenceKind.HOVER
    edges = iter(team.edges)
    for i, ids in NEIGHBORS.items():
        team.rows[i]["state"] = states[i].flat
        for j in ids:
            edge = next(edges)
            edge["is_heard"] = j in heard[i]
            if j in heard[i]:
                edge["told"] = heard[i][j].flat
                edge["told_acceleration"] = heard[i][j].a


@pytest.mark.parametrize(
    "law_of",
    [normalised, paper, flat_distances, distances, containment, random_edges],
)
def test_a_step_alone_and_a_step_of_the_team_give_the_same_bits(law_of):
    random = np.random.default_rng(3)
    laws = [law_of(i) for i in NEIGHBORS]
    step = type(laws[0]).for_team(laws, list(NEIGHBORS.values()))
    team = build_team()
    hovered = 0
    for tick in range(300):
        Clock.ns = team.now_ns = 10_000_000 * tick
        states = {i: draw_state(random) for i in NEIGHBORS}
        heard = {
            i: {j: draw_state(random) for j in ids if random.uniform() < 0.95}
            for i, ids in NEIGHBORS.items()
        }
        fill(team, states, heard)
        step(team)
        for i, (law, among) in enumerate(
            zip(laws, read_references(team.rows), strict=True)
        ):
            alone = law.step(states[i], heard[i])
            hovered += alone is None
            assert (alone is None) == (among is None)
            if alone is not None:
                assert alone.a.tobytes() == among.a.tobytes()
                assert alone.yaw == among.yaw == 0.0
    assert (hovered > 0) == (law_of not in (containment, random_edges))


def test_a_neighbour_that_the_law_does_not_use_changes_nothing():
    random = np.random.default_rng(3)
    me = draw_state(random)
    heard = {j: draw_state(random) for j in NEIGHBORS[1]}
    law = normalised(1)
    alone = law.step(me, heard)
    assert law.step(me, {**heard, 4: draw_state(random)}).a.tolist() == alone.a.tolist()


@pytest.mark.parametrize(
    ("kind", "reference"),
    [
        (ReferenceKind.HOVER, None),
        (ReferenceKind.ACCELERATION, Acceleration(np.array([7.0, 8.0, 9.0]), 13.0)),
        (ReferenceKind.VELOCITY, Velocity(np.array([4.0, 5.0, 6.0]), 13.0)),
        (ReferenceKind.FULL_STATE, FullState(np.arange(1.0, 15.0))),
    ],
)
def test_a_row_is_read_as_the_reference_of_its_kind(kind, reference):
    rows = np.zeros(1, LAW_ROW)
    rows["kind"] = kind
    rows["reference"] = np.arange(1.0, 15.0)
    assert repr(read_references(rows)) == repr([reference])


def test_a_team_accelerates_the_drones_that_are_chosen():
    team = build_team()
    team.accelerate(np.arange(15.0).reshape(5, 3), np.arange(5) > 2)
    found = read_references(team.rows)
    assert found[:3] == [None, None, None]
    assert found[3].a.tolist() == [9.0, 10.0, 11.0]
    assert team.receivers.tolist() == [0, 0, 0, 1, 1, 2, 2, 2, 2, 3, 3, 3, 4, 4]


def test_a_team_follows_places_and_velocities():
    team = build_team()
    team.rows["reference"] = 7.0
    team.follow(np.arange(15.0).reshape(5, 3), -np.arange(15.0).reshape(5, 3))
    last = read_references(team.rows)[-1].flat.tolist()
    assert last == [12.0, 13.0, 14.0, -12.0, -13.0, -14.0, *[0.0] * 8]


def straight(i):
    start = np.array([float(i), 0.0, 1.0])
    goal = np.array([i + 0.3, 0.4, 1.0 + 0.1 * i])
    return Straight(start, goal, 0.5 + 0.1 * i, 20.0)


def test_straight_lines_are_the_same_for_one_drone_and_for_a_team_that_is_built_anew():
    random = np.random.default_rng(5)
    alone, together = ([straight(i) for i in NEIGHBORS] for _ in range(2))
    team = build_team()
    arrivals = set()
    for tick in range(200):
        if tick % 70 == 0:
            step = Straight.for_team(together, list(NEIGHBORS.values()))
        heard = {
            i: {j: draw_state(random) for j in ids if random.uniform() < 0.5}
            for i, ids in NEIGHBORS.items()
        }
        away = np.array([0.1 * (1.0 + np.cos(0.1 * tick)), 0.0, 0.0])
        states = {i: State.at(law.goal + away) for i, law in enumerate(alone)}
        fill(team, states, heard)
        step(team)
        team.rows["tally"]["steps"] += 1
        references = read_references(team.rows)
        for i, law in enumerate(alone):
            wanted = law.step(states[i], heard[i])
            assert wanted.flat.tobytes() == references[i].flat.tobytes()
            assert law.arrived == together[i].arrived
            arrivals.add(law.arrived)
    assert len(arrivals) > 3
    assert references[3].p == pytest.approx(alone[3].goal)
    assert references[3].v.tolist() == [0.0, 0.0, 0.0]


class OwnStep(BearingFormation):
    """A law with a step of its own: that of the team is not its step."""

    def step(self, me, heard):
        return None


class OwnTeam(OwnStep):
    """A law that gives a step of a team for it."""

    @classmethod
    def for_team(cls, laws, neighbors):
        return None


class OnlyStep(CFDistributedFeedback):
    """A law without a step of a team."""

    def step(self, me, heard):
        return None


@pytest.mark.parametrize(
    ("kind", "is_team"),
    [(BearingFormation, True), (OwnStep, False), (OwnTeam, True), (OnlyStep, False)],
)
def test_a_step_below_the_step_of_the_team_counts(kind, is_team):
    assert has_team_law(kind) == is_team


class Tracker(AggregativeGuidance):
    """An aggregative law without its rounds: the test says which x_i they have found."""

    def __init__(self, i):
        super().__init__(NEIGHBORS[i])
        self.watched = 2 if 2 in NEIGHBORS[i] else None
        self.own["smoother"] = GoalSmoother(np.full(3, i), 1.0, 2.0, 0.01).rows
        self.member = SimpleNamespace(clock=Clock())

    def algorithm(self, place):
        raise NotImplementedError

    def finds(self, place):
        self.own["goal"] = place


def test_an_aggregative_law_gives_the_same_bits_for_one_drone_and_for_a_team():
    random = np.random.default_rng(4)
    alone, together = ([Tracker(i) for i in NEIGHBORS] for _ in range(2))
    step = Tracker.for_team(together, list(NEIGHBORS.values()))
    team = build_team()
    for tick in range(1, 200):
        Clock.ns = team.now_ns = 10_000_000 * (tick + tick // 50)
        states = {i: draw_state(random) for i in NEIGHBORS}
        heard = {
            i: {j: draw_state(random) for j in ids if j != 2 or random.uniform() < 0.5}
            for i, ids in NEIGHBORS.items()
        }
        if tick % 20 == 1:
            for one, other in zip(alone, together, strict=True):
                place = random.normal(size=3)
                one.finds(place)
                other.finds(place)
        fill(team, states, heard)
        step(team)
        references = read_references(team.rows)
        for i, law in enumerate(alone):
            wanted = law.step(states[i], heard[i])
            assert wanted.flat.tobytes() == references[i].flat.tobytes()
            assert law.own["intruder"].tolist() == together[i].own["intruder"].tolist()
            seen = heard[i].get(2)
            if seen is not None:
                assert law.own["intruder"][0].tolist() == seen.p.tolist()
    assert [len(law.way.rows) for law in together] == [20] * 5, "ten places a second"
