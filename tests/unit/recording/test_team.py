"""What a recording says of a team: phases and stops, rates of messages, rounds that come to agree; in pictures, too."""

import csv

import numpy as np
import pytest
from matplotlib.image import imread

from crazychoir.bus.codec import encode
from crazychoir.guidance.feedback import LAW
from crazychoir.recording import plots
from crazychoir.recording.figures import Flight, Track
from crazychoir.recording.file import Entry, RecordingFile, Series
from crazychoir.recording.messages import MESSAGES, Exchanged, packer
from crazychoir.recording.plots import WIDTH, draw
from crazychoir.recording.talk import talk_of
from crazychoir.recording.team_plots import of_team
from crazychoir.recording.work import Span, Stop, work_of
from crazychoir.types import Status

BEGAN = 5.0
SAID = [  # s, phase, task, sent
    (0.0, "on ground", "planning: columns", 0), (1.0, "taking off", "flying: 0/2 stops", 100),
    (2.0, "mission", "flying: 0/2 stops", 150), (3.0, "hovering", "flying: 0/2 stops", 200),
    (4.0, "mission", "flying: 1/2 stops", 250), (5.0, "mission", "flying: 2/2 stops", 300),
    (6.0, "landing", "landing: 2 stops", 350), (7.0, "on ground", "done: 2 stops", 400),
]  # fmt: skip
RESULT = {
    "served": [{"task": 3, "kind": "pickup"}, {"task": 3, "kind": "delivery"}],
    "history": [[1, None, None], [4, 9.5, None], [8, 7.25, 8.0]],
}


def statuses(drone, said=SAID):
    return [(BEGAN + t, drone, Status(phase, task, sent=sent, lost=sent // 5)) for t, phase, task, sent in said]


def rounds(values):
    """Of each drone, its message of each round, to everybody else."""
    return [
        (BEGAN + 0.1 * k, i, Exchanged(to, k, 0, "mean", encode(value)))
        for i, own in values.items()
        for k, value in enumerate(own)
        for to in values
        if to != i
    ]


def law():
    return statuses(4, [(1.0, "hovering", LAW, 0), (6.5, "hovering", LAW, 9)])


@pytest.fixture
def recorded(tmp_path):
    def record(*messages):
        file, series = RecordingFile(tmp_path / "a.mcap", {"version": "1"}, "{}", False), {}
        topics = {Status: "status", Exchanged: "round", dict: "result"}
        for came, drone, value in sorted((m for part in messages for m in part), key=lambda m: m[0]):
            ns = round(came * 1e9)
            one = series.setdefault((drone, type(value)), Series(drone, topics[type(value)], MESSAGES[type(value)]))
            file.write([Entry(one, ns, ns, packer(one.message, drone)(value, ns))])
        file.close()
        return tmp_path / "a.mcap"

    return record


def track(drone):
    t = np.linspace(0.0, 7.0, 141)
    p = np.column_stack([np.exp(-t), np.full(141, float(drone)), np.ones(141)])
    return Track(drone, t, p, np.zeros((141, 4)), 0 * p, 0 * p, 0 * p, 0 * p)


def flight():
    return Flight((track(2), track(4)), np.linspace(0.0, 7.0, 141), np.ones(141))


def test_phases_are_joined_and_stops_are_named_by_the_result(recorded):
    work = work_of(recorded(statuses(2), [(BEGAN + 8.0, 2, RESULT)]), BEGAN)
    assert work.spans[1:4] == (
        Span(2, 1.0, 2.0, "taking off", "flying: 0/2 stops"), Span(2, 2.0, 3.0, "mission", "flying: 0/2 stops"),
        Span(2, 3.0, 4.0, "hovering", "flying: 0/2 stops"),
    )  # fmt: skip
    assert work.stops == (Stop(2, 4.0, "+3"), Stop(2, 5.0, "−3"))
    assert (work.drones, work.flown) == ([2], True)


@pytest.mark.parametrize(
    ("result", "labels"), [({}, ["(1)", "(2)"]), ({"done": [[7, 1], [0, 2]]}, ["7", "0"]), (RESULT, ["+3", "-3"])]
)
def test_stops_of_any_mission(recorded, result, labels):
    work = work_of(recorded(statuses(2), [(BEGAN + 8.0, 2, result)]), BEGAN)
    assert [stop.label.replace("−", "-") for stop in work.stops] == labels


def test_the_table_of_tasks(recorded, tmp_path):
    work_of(recorded(statuses(2), [(BEGAN + 8.0, 2, RESULT)]), BEGAN).write(tmp_path / "tasks.csv")
    with (tmp_path / "tasks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert (rows[4]["begin_s"], rows[4]["phase"], rows[4]["stops"]) == ("4.000", "mission", "+3")
    assert rows[5]["stops"] == "-3"


def test_rates_are_those_of_the_whole_team(recorded, tmp_path):
    talk = talk_of(recorded(statuses(2), statuses(4)), BEGAN)
    assert talk.t[[0, -1]].tolist() == pytest.approx([0.5, 7.0])
    assert talk.rates[0] == pytest.approx([200.0, 40.0, 0.0])
    assert talk.rates[-1] == pytest.approx([100.0, 20.0, 0.0])
    talk.write(tmp_path / "messages.csv")
    table = np.genfromtxt(tmp_path / "messages.csv", delimiter=",", names=True)
    assert table["sent_1_s"][0] == 200.0


def test_rounds_of_numbers_and_of_anything(recorded, tmp_path):
    numbers = {0: [[0.0, 1.0], [2.0, 2.0]], 1: [[4.0, 1.0], [2.0, 2.0]]}
    (channel,) = talk_of(recorded(rounds(numbers)), BEGAN).channels
    assert (channel.name, channel.different.tolist()) == ("mean", [2, 1])
    assert channel.spread.tolist() == [2.0, 0.0]
    (tmp_path / "a.mcap").unlink()
    talk = talk_of(recorded(rounds({0: ["a", {"b": 1}], 1: ["b", {"b": 1}]})), BEGAN)
    (channel,) = talk.channels
    assert (channel.different.tolist(), channel.spread) == ([2, 1], None)
    talk.write_rounds(tmp_path / "rounds.csv")
    assert (tmp_path / "rounds.csv").read_text().splitlines()[1:] == ['"mean",0,2,nan', '"mean",1,1,nan']


def test_how_routes_were_planned(recorded, tmp_path):
    talk = talk_of(recorded(statuses(2), [(BEGAN + 8.0, 2, RESULT)]), BEGAN)
    np.testing.assert_array_equal(talk.history[2], [[1, np.nan, np.nan], [4, 9.5, np.nan], [8, 7.25, 8.0]])
    talk.write_history(tmp_path / "convergence.csv")
    assert (tmp_path / "convergence.csv").read_text().splitlines()[2] == "2,4,9.500000,nan"


@pytest.mark.parametrize(
    ("more", "names"),
    [
        (lambda: [(BEGAN + 8.0, 2, RESULT)], ["tasks", "messages", "convergence"]),
        (lambda: rounds({2: [1.0, 2.0], 4: [3.0, 2.0]}), ["tasks", "messages", "convergence"]),
        (law, ["tasks", "messages", "convergence"]),
        (list, ["tasks", "messages"]),
    ],
    ids=["routes", "rounds", "law", "neither"],
)
def test_pictures_of_a_team(recorded, tmp_path, monkeypatch, more, names):
    monkeypatch.setattr(plots, "FORMATS", ("png",))
    path = recorded(statuses(2), more())
    pictures = of_team(flight(), work_of(path, BEGAN), talk_of(path, BEGAN))
    assert list(pictures) == names
    for file in draw(pictures, tmp_path):
        assert imread(file).shape[1] == round(300 * WIDTH)


def test_of_a_recording_without_any_of_it_nothing_is_drawn(recorded):
    path = recorded([(BEGAN, 2, {"success": True})])
    assert of_team(flight(), work_of(path, BEGAN), talk_of(path, BEGAN)) == {}
