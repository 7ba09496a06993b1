"""What a recording says of a team: phases and stops, rates of messages, rounds that come to agree; in pictures, too."""

import csv

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import imread

from crazychoir.bus.codec import encode
from crazychoir.guidance.feedback import LAW_TASK
from crazychoir.recording.analysis import plots
from crazychoir.recording.analysis.activity import (
    CompletedStop,
    FlightActivity,
    Span,
    read_activity,
)
from crazychoir.recording.analysis.communication import TeamMessages, read_team_messages
from crazychoir.recording.analysis.figures import RecordedFlight, RecordedTrack
from crazychoir.recording.analysis.plots import COLUMN_WIDTH, draw
from crazychoir.recording.analysis.team_plots import (
    PHASE_COLOURS,
    TEAM_PLOT_LIMITS,
    law_times,
    team_pictures,
)
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import (
    FORM_BY_VALUE_TYPE,
    Exchanged,
    make_packer,
)
from crazychoir.team.message_kind import MessageKind, join_contents
from crazychoir.types import Status

BEGAN = 5.0
SAID = [  # s, phase, task, sent
    (0.0, "on ground", "planning: columns", 0),
    (1.0, "taking off", "flying: 0/2 stops", 100),
    (2.0, "mission", "flying: 0/2 stops", 150),
    (3.0, "hovering", "flying: 0/2 stops", 200),
    (4.0, "mission", "flying: 1/2 stops", 250),
    (5.0, "mission", "flying: 2/2 stops", 300),
    (6.0, "landing", "landing: 2 stops", 350),
    (7.0, "on ground", "done: 2 stops", 400),
]
RESULT = {
    "served": [{"task": 3, "kind": "pickup"}, {"task": 3, "kind": "delivery"}],
    "history": [[1, None, None], [4, 9.5, None], [8, 7.25, 8.0]],
}


def statuses(drone, said=SAID):
    return [
        (BEGAN + t, drone, Status(phase, task, sent=sent, lost=sent // 5))
        for t, phase, task, sent in said
    ]


def rounds(values):
    """Return the message of each drone in each round to each other drone."""
    return [
        (BEGAN + 0.1 * k, i, Exchanged(to, k, 0, "mean", encode(value)))
        for i, own in values.items()
        for k, value in enumerate(own)
        for to in values
        if to != i
    ]


def law():
    return statuses(4, [(1.0, "hovering", LAW_TASK, 0), (6.5, "hovering", LAW_TASK, 9)])


@pytest.fixture
def recorded(tmp_path):
    def record(*messages):
        (tmp_path / "a.mcap").unlink(missing_ok=True)
        file, series = (
            RecordingFile(tmp_path / "a.mcap", {"version": "1"}, "{}", False),
            {},
        )
        topics = {Status: "status", Exchanged: "round", dict: "result"}
        for came, drone, value in sorted(
            (m for part in messages for m in part), key=lambda m: m[0]
        ):
            ns = round(came * 1e9)
            one = series.setdefault(
                (drone, type(value)),
                Series(drone, topics[type(value)], FORM_BY_VALUE_TYPE[type(value)]),
            )
            file.write(
                [
                    RecordingEntry(
                        one, ns, ns, make_packer(one.message, drone)(value, ns)
                    )
                ]
            )
        file.close()
        return tmp_path / "a.mcap"

    return record


def track(drone):
    t = np.linspace(0.0, 7.0, 141)
    p = np.column_stack([np.exp(-t), np.full(141, float(drone)), np.ones(141)])
    return RecordedTrack(
        drone, "truth", t, p, np.zeros((141, 4)), 0 * p, 0 * p, 0 * p, 0 * p
    )


def flight():
    return RecordedFlight(
        (track(2), track(4)), np.linspace(0.0, 7.0, 141), np.ones(141)
    )


def test_phases_are_joined_and_stops_are_named_by_the_result(recorded):
    work = read_activity(recorded(statuses(2), [(BEGAN + 8.0, 2, RESULT)]), BEGAN)
    assert work.spans[1:4] == (
        Span(2, 1.0, 2.0, "taking off", "flying: 0/2 stops"),
        Span(2, 2.0, 3.0, "mission", "flying: 0/2 stops"),
        Span(2, 3.0, 4.0, "hovering", "flying: 0/2 stops"),
    )
    assert work.stops == (CompletedStop(2, 4.0, "+3"), CompletedStop(2, 5.0, "−3"))
    assert (work.drones, work.flown) == ([2], True)


@pytest.mark.parametrize(
    ("result", "labels"),
    [
        ({}, ["(1)", "(2)"]),
        ({"done": [[7, 1], [0, 2]]}, ["7", "0"]),
        (RESULT, ["+3", "-3"]),
    ],
)
def test_stops_of_any_mission(recorded, result, labels):
    work = read_activity(recorded(statuses(2), [(BEGAN + 8.0, 2, result)]), BEGAN)
    assert [stop.label.replace("−", "-") for stop in work.stops] == labels


@pytest.mark.parametrize(
    "result",
    [
        {"done": True},
        {"done": 3},
        {"served": [1, 2]},
        {"served": 7},
        {"served": [{"kind": "pickup"}]},
        {"history": [[1.0, 2.0]], "objective": 3.0},
        {"history": "none"},
        {"history": []},
        {"history": [[1.0, 2.0, 3.0]], "objective": 0.5},
    ],
    ids=str,
)
def test_drones_with_results_of_their_own_kind_stand_beside_those_of_ours(
    recorded, tmp_path, result
):
    path = recorded(
        statuses(2), statuses(4), [(BEGAN + 8.0, 2, RESULT), (BEGAN + 8.5, 4, result)]
    )
    work, talk = read_activity(path, BEGAN), read_team_messages(path, BEGAN)
    assert [stop.label for stop in work.stops if stop.drone == 2] == [
        "+3",
        "\N{MINUS SIGN}3",
    ]
    assert [stop.label for stop in work.stops if stop.drone == 4] == ["(1)", "(2)"]
    assert 2 in talk.history
    work.write(tmp_path / "tasks.csv")
    talk.write_history(tmp_path / "convergence.csv")


def test_stops_of_each_drone_are_its_own_and_counts_may_jump(recorded, tmp_path):
    other = [
        (0.0, "mission", 'at "A": 0 done, task 7', 0),
        (2.0, "mission", "2 done, task 9", 0),
        (3.0, "on ground", "done", 0),
    ]
    path = recorded(
        statuses(2), statuses(4, other), [(BEGAN + 8.0, 4, {"done": [[7, 1], [9, 2]]})]
    )
    work = read_activity(path, BEGAN)
    assert work.drones == [2, 4]
    assert work.stops == (
        CompletedStop(2, 4.0, "(1)"),
        CompletedStop(2, 5.0, "(2)"),
        CompletedStop(4, 2.0, "7"),
        CompletedStop(4, 2.0, "9"),
    )
    assert work.spans[-2:] == (
        Span(4, 2.0, 3.0, "mission", "2 done, task 9"),
        Span(4, 3.0, 3.0, "on ground", "done"),
    )
    work.write(tmp_path / "tasks.csv")
    with (tmp_path / "tasks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["task"] for row in rows if row["drone"] == "4"] == [
        'at "A": 0 done, task 7',
        "2 done, task 9",
        "done",
    ]
    assert [row["stops"] for row in rows if row["drone"] == "4"] == ["", "7 9", ""]
    assert [row["stops"] for row in rows if row["drone"] == "2"] == [
        "",
        "",
        "",
        "",
        "(1)",
        "(2)",
        "",
        "",
    ]


def test_the_table_of_tasks(recorded, tmp_path):
    read_activity(recorded(statuses(2), [(BEGAN + 8.0, 2, RESULT)]), BEGAN).write(
        tmp_path / "tasks.csv"
    )
    with (tmp_path / "tasks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert (rows[4]["begin_s"], rows[4]["phase"], rows[4]["stops"]) == (
        "4.000",
        "mission",
        "+3",
    )
    assert rows[5]["stops"] == "-3"


def test_rates_are_those_of_the_whole_team(recorded, tmp_path):
    talk = read_team_messages(recorded(statuses(2), statuses(4)), BEGAN)
    assert talk.t[[0, -1]].tolist() == pytest.approx([1.0, 7.0])
    assert talk.rates[0] == pytest.approx([200.0, 40.0, 0.0])
    assert talk.rates[-1] == pytest.approx([100.0, 20.0, 0.0])
    talk.write(tmp_path / "messages.csv")
    table = np.genfromtxt(tmp_path / "messages.csv", delimiter=",", names=True)
    assert table["sent_1_s"][0] == 200.0


def test_a_drone_counts_no_messages_before_it_is_heard_or_after_it_is_lost(recorded):
    talk = read_team_messages(recorded(statuses(2), statuses(4, SAID[4:6])), BEGAN)
    assert talk.t[[0, -1]].tolist() == pytest.approx([1.0, 7.0])
    sent = dict(zip(talk.t.round(1).tolist(), talk.rates[:, 0].tolist(), strict=True))
    assert (sent[1.0], sent[4.0], sent[5.0], sent[6.0]) == pytest.approx(
        (100, 50, 100, 50)
    )
    talk = read_team_messages(
        recorded(statuses(2, SAID[5:]), statuses(4, SAID[:4])), BEGAN
    )
    assert talk.t[[0, -1]].tolist() == pytest.approx([1.0, 7.0])


def test_an_agent_that_is_started_anew_counts_from_nothing(recorded):
    """30 messages, 20 of another 50, and 10 more: none less than none."""
    said = [
        (0.0, "mission", "", 0),
        (1.0, "mission", "", 30),
        (2.0, "mission", "", 20),
        (3.0, "mission", "", 30),
    ]
    talk = read_team_messages(recorded(statuses(2, said)), BEGAN)
    assert talk.rates[:, 0] == pytest.approx([30, 20, 10])
    assert talk.rates[:, 1] == pytest.approx([6, 4, 2])


def test_what_has_no_content_is_no_message_of_a_round(recorded):
    said = [
        (0, MessageKind.REPEAT, encode(1.0)),
        (1, MessageKind.AHEAD, encode(3.0)),
        (2, MessageKind.ANSWER, encode(2.0)),
        (3, MessageKind.DOUBLE, join_contents(encode(2.0), encode(9.0))),
        (4, MessageKind.WANT, b""),
        (5, MessageKind.FIN, b""),
    ]
    path = recorded(
        [
            (BEGAN, i, Exchanged(9, 4, kind, "mean", payload))
            for i, kind, payload in said
        ]
    )
    (channel,) = read_team_messages(path, BEGAN).channels
    assert (
        channel.rounds.tolist(),
        channel.different.tolist(),
        channel.spread.tolist(),
    ) == ([4], [3], [1.0])


def test_channels_come_in_order_of_their_first_message_and_rounds_by_number(
    recorded, tmp_path
):
    said = [("b", 1, 5.0), ("b", 0, 4.0), ("a", 0, "word"), ("a", 1, 2.0)]
    messages = [
        (BEGAN + k + 0.1 * i, i, Exchanged(9, number, 0, name, encode(value)))
        for k, (name, number, value) in enumerate(said)
        for i in (0, 1)
    ]
    talk = read_team_messages(recorded(messages), BEGAN)
    assert [(channel.name, channel.rounds.tolist()) for channel in talk.channels] == [
        ("b", [0, 1]),
        ("a", [0, 1]),
    ]
    assert talk.channels[0].spread.tolist() == [0.0, 0.0]
    assert talk.channels[1].spread is None, "not all are numbers"
    talk.write_rounds(tmp_path / "rounds.csv")
    assert (tmp_path / "rounds.csv").read_text().splitlines()[1:3] == [
        '"b",0,1,0',
        '"b",1,1,0',
    ]


def test_rounds_of_numbers_and_of_anything(recorded, tmp_path):
    numbers = {0: [[0.0, 1.0], [2.0, 2.0]], 1: [[4.0, 1.0], [2.0, 2.0]]}
    (channel,) = read_team_messages(recorded(rounds(numbers)), BEGAN).channels
    assert (channel.name, channel.different.tolist()) == ("mean", [2, 1])
    assert channel.spread.tolist() == [2.0, 0.0]
    talk = read_team_messages(
        recorded(rounds({0: ["a", {"b": 1}], 1: ["b", {"b": 1}]})), BEGAN
    )
    (channel,) = talk.channels
    assert (channel.different.tolist(), channel.spread) == ([2, 1], None)
    talk.write_rounds(tmp_path / "rounds.csv")
    assert (tmp_path / "rounds.csv").read_text().splitlines()[1:] == [
        '"mean",0,2,nan',
        '"mean",1,1,nan',
    ]


def test_how_routes_were_planned(recorded, tmp_path):
    talk = read_team_messages(recorded(statuses(2), [(BEGAN + 8.0, 2, RESULT)]), BEGAN)
    np.testing.assert_array_equal(
        talk.history[2], [[1, np.nan, np.nan], [4, 9.5, np.nan], [8, 7.25, 8.0]]
    )
    talk.write_history(tmp_path / "convergence.csv")
    assert (tmp_path / "convergence.csv").read_text().splitlines()[
        2
    ] == "2,4,9.500000,nan"


@pytest.mark.parametrize(
    ("more", "names"),
    [
        (lambda: [(BEGAN + 8.0, 2, RESULT)], ["tasks", "messages", "convergence"]),
        (
            lambda: rounds({2: [1.0, 2.0], 4: [3.0, 2.0]}),
            ["tasks", "messages", "convergence"],
        ),
        (law, ["tasks", "messages", "convergence"]),
        (list, ["tasks", "messages"]),
    ],
    ids=["routes", "rounds", "law", "neither"],
)
def test_pictures_of_a_team(recorded, tmp_path, monkeypatch, more, names):
    monkeypatch.setattr(plots, "PICTURE_FORMATS", ("png",))
    path = recorded(statuses(2), more())
    pictures, missing = team_pictures(
        flight(), read_activity(path, BEGAN), read_team_messages(path, BEGAN)
    )
    assert list(pictures) == names
    assert sorted([*pictures, *missing]) == ["convergence", "messages", "tasks"]
    for file in draw(pictures, tmp_path):
        assert imread(file).shape[1] == round(300 * COLUMN_WIDTH)


def test_nothing_is_drawn_of_a_recording_without_team_data(recorded):
    path = recorded([(BEGAN, 2, {"success": True})])
    assert (
        team_pictures(
            flight(), read_activity(path, BEGAN), read_team_messages(path, BEGAN)
        )[0]
        == {}
    )


SILENCE = TeamMessages(np.zeros(0), np.zeros((0, 3)), (), {})


def drawn(picture):
    """The axes of a picture."""
    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    picture[1](figure)
    return figure.axes[0]


def data(axes):
    """What its lines show."""
    return [
        (np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float))
        for line in axes.lines
    ]


def test_a_bar_is_a_phase_and_a_mark_a_stop(recorded):
    path = recorded(statuses(2), statuses(4, SAID[:3]), [(BEGAN + 8.0, 2, RESULT)])
    work = read_activity(path, BEGAN)
    axes = drawn(team_pictures(flight(), work, SILENCE)[0]["tasks"])
    assert len(axes.patches) == len(work.spans)
    for bar, span in zip(axes.patches, work.spans, strict=True):
        assert (bar.get_x(), bar.get_width()) == pytest.approx(
            (span.begin, span.end - span.begin)
        )
        assert bar.get_y() + 0.5 * bar.get_height() == pytest.approx(
            {2: 0.0, 4: -1.0}[span.drone]
        )
        assert to_hex(bar.get_facecolor()) == PHASE_COLOURS[span.phase].lower()
    assert [x.tolist() for x, _ in data(axes)] == [[4.0, 4.0], [5.0, 5.0]]
    assert [(text.get_text(), text.get_position()[0]) for text in axes.texts] == [
        ("+3", 4.0),
        ("−3", 5.0),
    ]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["2", "4"]
    assert axes.get_xlim() == (0.0, 7.0)


def test_names_of_stops_do_not_cover_each_other():
    stops = (
        CompletedStop(2, 50.0, "abc"),
        CompletedStop(2, 50.5, "d"),
        CompletedStop(2, 60.0, "e"),
    )
    axes = drawn(
        team_pictures(
            flight(),
            FlightActivity((Span(2, 0.0, 100.0, "mission", ""),), stops),
            SILENCE,
        )[0]["tasks"]
    )
    assert [text.get_va() for text in axes.texts] == ["bottom", "top", "bottom"]


def test_the_picture_of_messages_shows_their_rates(recorded):
    talk = read_team_messages(recorded(statuses(2)), BEGAN)
    axes = drawn(team_pictures(flight(), FlightActivity((), ()), talk)[0]["messages"])
    for (t, rate), expected in zip(data(axes), talk.rates.T, strict=True):
        np.testing.assert_array_equal(t, talk.t)
        np.testing.assert_array_equal(rate, expected)
    assert [line.get_label() for line in axes.lines] == [
        "sent",
        "lost (simulated)",
        "resent",
    ]


def test_routes_go_before_laws_and_these_before_rounds(recorded):
    result, said = [(BEGAN + 8.0, 2, RESULT)], rounds({2: [1.0, 2.0], 4: [3.0, 2.0]})
    labels = []
    for parts in ((result, law(), said), (law(), said), (said,)):
        path = recorded(statuses(2), *parts)
        axes = drawn(
            team_pictures(
                flight(), read_activity(path, BEGAN), read_team_messages(path, BEGAN)
            )[0]["convergence"]
        )
        labels.append(axes.get_ylabel())
    assert labels == [
        "length of all routes [m]",
        "distance from end [m]",
        "distance from the mean",
    ]


def test_what_was_known_of_routes_in_each_round(recorded):
    path = recorded(statuses(2), [(BEGAN + 8.0, 2, RESULT)])
    (k, relaxed), (_, best) = data(
        drawn(
            team_pictures(
                flight(), FlightActivity((), ()), read_team_messages(path, BEGAN)
            )[0]["convergence"]
        )
    )
    np.testing.assert_array_equal(k, [1, 4, 8, 9])
    np.testing.assert_array_equal(relaxed, [np.nan, 9.5, 7.25, 7.25])
    np.testing.assert_array_equal(best, [np.nan, np.nan, 8.0, 8.0])


def test_a_law_is_shown_by_the_distance_from_where_it_ended(recorded):
    path = recorded(law())
    axes = drawn(
        team_pictures(flight(), read_activity(path, BEGAN), SILENCE)[0]["convergence"]
    )
    ((t, far),) = data(axes)
    own = track(4)
    during = (own.t >= 1.0) & (own.t <= 6.5)
    end = own.p[(own.t >= 5.5) & (own.t <= 6.5)].mean(axis=0)
    np.testing.assert_allclose(t, own.t[during] - 1.0)
    np.testing.assert_allclose(
        far,
        np.maximum(
            np.linalg.norm(own.p[during] - end, axis=1), TEAM_PLOT_LIMITS.least_value
        ),
    )
    assert (axes.get_yscale(), axes.get_xlim()) == ("log", (0.0, 5.5))


def test_a_law_counts_from_its_first_step_to_its_last():
    said = [(1.0, 2.0, LAW_TASK), (2.0, 3.0, "held"), (3.0, 5.0, LAW_TASK)]
    spans = [Span(4, begin, end, "mission", task) for begin, end, task in said]
    assert law_times(
        FlightActivity((*spans, Span(5, 0.0, 9.0, "mission", "x")), ())
    ) == {4: (1.0, 5.0)}


def test_rounds_are_shown_by_their_spread_or_by_how_many_differ(recorded):
    of_numbers = rounds({2: [1.0, 2.0], 4: [3.0, 2.0]})
    talk = read_team_messages(recorded(of_numbers), BEGAN)
    ((k, spread),) = data(
        drawn(team_pictures(flight(), FlightActivity((), ()), talk)[0]["convergence"])
    )
    assert (k.tolist(), spread.tolist()) == (
        [0, 1],
        [1.0, TEAM_PLOT_LIMITS.least_value],
    )
    of_words = rounds({2: ["a", "b"], 4: ["c", "b"]})
    axes = drawn(
        team_pictures(
            flight(),
            FlightActivity((), ()),
            read_team_messages(recorded(of_words), BEGAN),
        )[0]["convergence"]
    )
    ((k, different),) = data(axes)
    assert (k.tolist(), different.tolist(), axes.get_ylim()) == (
        [0, 1],
        [2, 1],
        (0.0, 2.5),
    )


NOWHERE = RecordedFlight((), np.zeros(0), np.zeros(0))


def test_an_unseen_team_is_drawn_from_its_own_messages(recorded):
    """Without truth or state: all but the distances of a law."""
    path = recorded(statuses(2), law(), [(BEGAN + 8.0, 2, RESULT)])
    work, talk = read_activity(path, BEGAN), read_team_messages(path, BEGAN)
    pictures, missing = team_pictures(NOWHERE, work, talk)
    assert (list(pictures), missing) == (["tasks", "messages", "convergence"], {})
    axes = drawn(pictures["convergence"])
    np.testing.assert_array_equal(data(axes)[0][1], [np.nan, 9.5, 7.25, 7.25])
    (legend,) = axes.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["drone 2", "best plan"]
    pictures, missing = team_pictures(NOWHERE, work, SILENCE)
    assert list(pictures) == ["tasks"]
    assert missing == {
        "messages": "no two statuses of a drone",
        "convergence": "no result with planned routes, no law with truth or state, no rounds",
    }


def test_what_was_minimised_has_its_unit(recorded, tmp_path):
    for objective, unit, label in (
        (["total"], "m", "length of all routes [m]"),
        (["makespan", "total"], "s", "time until all are back [s]"),
    ):
        talk = read_team_messages(
            recorded(
                statuses(2), [(BEGAN + 8.0, 2, RESULT | {"objective": objective})]
            ),
            BEGAN,
        )
        assert (
            drawn(
                team_pictures(flight(), FlightActivity((), ()), talk)[0]["convergence"]
            ).get_ylabel()
            == label
        )
        talk.write_history(tmp_path / "convergence.csv")
        header = (tmp_path / "convergence.csv").read_text().splitlines()[0]
        assert header == f"drone,round,relaxed_{unit},cost_{unit}"
