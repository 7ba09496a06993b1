import json

import numpy as np
import pytest

from crazychoir.agent import sketch
from crazychoir.agent.sketch import (
    SKETCH_LIMITS,
    flight_messages,
    load_with_remarks,
    on_board_messages,
    plan_file,
    plan_sketch,
    strokes_as_text,
)
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.dashboard.access import PAGE_REQUEST_RULES
from crazychoir.dashboard.requests import Draw, decode_page_message
from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.drawing import Pen
from crazychoir.planning.feasibility import Limits, is_within_limits
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.trajectory_file import write_pieces

WAVE = tuple((0.02 * k, 0.02 * k, 0.3 * float(np.sin(0.1 * k))) for k in range(100))
DOWN = tuple((2.0 + 0.02 * k, 1.0, 1.0 - 0.02 * k) for k in range(50))


def config_of(**tables):
    drones = [{"id": i, "home": [1.0 * i, 0.0, 0.0], "leader": i < 2} for i in range(4)]
    return SwarmConfig.of({"name": "a", "drones": drones, **tables})


def test_strokes_become_a_flight_within_the_limits_that_were_set():
    plan = plan_sketch(
        (WAVE, DOWN), Pen(height=1.2, lift=0.3), config_of(), v_max=0.4, a_max=0.8
    )
    assert is_within_limits(plan.path, Limits(v_max=0.4, a_max=0.8))
    assert 0.3 < plan.speed <= 0.4
    assert plan.deviation < 0.05
    assert plan.path.sample(0.0).p == pytest.approx([0.0, 0.0, 1.2])
    shown = plan.shown()
    assert len(shown["points"]) == len(shown["speeds"]) == 400
    assert max(shown["speeds"]) == pytest.approx(shown["speed"], abs=0.01)
    assert max(point[2] for point in shown["points"]) == pytest.approx(1.5, abs=0.01)


def test_more_time_makes_it_slower_and_the_swarm_s_own_limits_count():
    limits = {"v_max": 5.0, "a_max": 9.0}
    plan = plan_sketch((WAVE,), Pen(), config_of(), **limits)
    assert plan.speed <= 1.0
    slow = plan_sketch((WAVE,), Pen(), config_of(), **limits, slower=2.0)
    assert slow.path.duration == pytest.approx(2.0 * plan.path.duration)
    assert slow.speed == pytest.approx(0.5 * plan.speed, rel=0.02)


def test_a_drawing_that_leaves_the_fence_or_is_no_line_is_refused():
    with pytest.raises(ConfigError, match="fence"):
        plan_sketch((WAVE,), Pen(height=9.0), config_of())
    with pytest.raises(ConfigError, match="at least one line"):
        plan_sketch((((0.0, 1.0, 1.0),),), Pen(), config_of())


@pytest.mark.parametrize("slower", [0.0, -1.0, 0.99, 20.1, float("nan"), float("inf")])
def test_no_time_that_is_none_or_less_than_the_limits_ask_for(slower):
    with pytest.raises(
        ConfigError, match=r"drawing: slower: found .*; allowed: 1 to 20 times"
    ):
        plan_sketch((WAVE,), Pen(), config_of(), slower=slower)


@pytest.fixture
def unplanned(monkeypatch):
    """Nothing may be planned."""

    def drawing(*arguments):
        pytest.fail("planned")

    monkeypatch.setattr(sketch, "plan_drawing", drawing)


LONG = [[(0.0, 4.0 * (-1.0) ** k, 0.0) for k in range(25)]]  # 192 m


@pytest.mark.parametrize(
    ("strokes", "pen", "limits", "words"),
    [
        (
            [[(0.0, 0.0, 0.0), (1.0, 900.0, 0.0)]],
            {},
            {},
            r"strokes\[0\]\[1\]: found \[900.0, 0.0, 1.0\]; .*fence",
        ),
        ([[(0.0, 0.0, 0.0), (1.0, 4.03, 0.0)]], {"smoothing": 0.02}, {}, "fence"),
        ([[(0.0, 0.0, 0.0), (1.0, float("nan"), 0.0)]], {}, {}, "fence"),
        (LONG, {}, {"v_max": 0.1}, "192 m, which take 1920 s; allowed: at most 1800 s"),
        (LONG, {}, {"v_max": 0.5, "slower": 5.0}, "1920 s"),
        (
            [[(0.0, 0.0, 0.0)]] * 200,
            {"lift": 2.0},
            {"v_max": 0.4},
            "0 m, which take 1990 s",
        ),
        (LONG + LONG, {}, {"v_max": 1.0}, "384 m; allowed: at most 113 m"),
        (
            [[(0.0, 0.0, 0.0)] * (SKETCH_LIMITS.most_rows + 1)],
            {},
            {},
            f"{SKETCH_LIMITS.most_rows + 1} rows",
        ),
    ],
)
def test_what_is_far_too_large_is_refused_before_it_is_planned(
    unplanned, strokes, pen, limits, words
):
    with pytest.raises(ConfigError, match=words):
        plan_sketch(strokes, Pen(**pen), config_of(), **limits)


def test_a_hand_may_stray_beyond_the_fence_by_what_is_smoothed():
    line = [(0.1 * k, 0.1 * k - 2.0, 3.99) for k in range(30)]
    line[15] = (1.5, -0.5, 4.01)
    plan_sketch([line], Pen(smoothing=0.02), config_of())


def test_a_drawing_full_of_corners_is_refused_when_its_time_is_known():
    corners = [[(0.0, 0.1 * (k // 2), 0.1 * ((k + 1) // 2)) for k in range(60)]]
    with pytest.raises(ConfigError, match=r"s or more; allowed: at most 90 s"):
        plan_sketch(corners, Pen(), config_of(), a_max=0.02, slower=20.0)


def test_each_drone_flies_it_beside_the_one_before():
    config = config_of()
    path = plan_sketch((WAVE,), Pen(), config).path
    told = flight_messages(path, (3, 1), (0.0, 0.5, 0.2), config)
    assert list(told) == [3, 1]
    paths = [Piecewise(one["coefficients"], one["durations"]) for one in told.values()]
    away = paths[1].sample(3.0).flat - paths[0].sample(3.0).flat
    assert away == pytest.approx([0.0, 0.5, 0.2, *[0.0] * 11])
    with pytest.raises(ConfigError, match="fence"):
        flight_messages(path, (3, 1), (0.0, 3.9, 0.0), config)


@pytest.mark.parametrize(
    ("offset", "good"),
    [
        ((0.0, 0.0, 0.0), False),
        ((0.3, 0.0, 0.0), False),
        ((0.0, 0.33, 0.0), True),
        ((0, 0, 0.61), True),
        ((0.2, 0.2, 0.3), True),
        ((0.1, 0.1, 0.3), False),
    ],
)
def test_drones_that_would_fly_into_each_other_are_not_sent(offset, good):
    config = config_of()
    path = plan_sketch((WAVE,), Pen(), config).path
    if good:
        assert len(flight_messages(path, (2, 3), offset, config)) == 2
    else:
        with pytest.raises(
            ConfigError, match=r"offset: .*0\.32 m aside, or 0\.6 m above"
        ):
            flight_messages(path, (2, 3), offset, config)
    assert len(flight_messages(path, (0, 1), offset, config)) == 2, (
        "leaders fly it from where they are"
    )
    assert (
        len(
            flight_messages(
                path, (2, 3), offset, config_of(collision={"method": "off"})
            )
        )
        == 2
    )


def test_strokes_are_saved_and_loaded():
    drawn = [np.array(WAVE), np.array(DOWN)]
    for kind, timed in (("csv", True), ("svg", False)):
        read, _ = load_with_remarks(
            strokes_as_text(drawn, kind), f"Word.{kind.upper()}"
        )
        for stroke, again in zip(drawn, read, strict=True):
            columns = slice(0 if timed else 1, 3)
            assert np.array(again)[:, columns] == pytest.approx(
                stroke[:, columns], abs=2e-4
            )
            assert (np.diff(np.array(again)[:, 0]) > 0.0).all()


def circles(n, metres, count):
    """n places, t s, x, y m, on circles of so many metres each, `count` times."""
    turn = np.linspace(0.0, 2.0 * np.pi * count, n)
    return np.column_stack(
        [
            0.01 * np.arange(n),
            np.cos(turn) * metres / 6.28,
            np.sin(turn) * metres / 6.28,
        ]
    )


@pytest.mark.parametrize("kind", ["csv", "svg"])
def test_what_is_loaded_is_thinned_to_what_a_page_may_have_planned(kind):
    (stroke,), _ = load_with_remarks(
        strokes_as_text([circles(6000, 3.0, 1)], kind), f"a.{kind}"
    )
    places = np.array(stroke)[:, 1:]
    assert 1000 < len(places) <= 1501, "2 mm apart"
    assert places[[0, -1]] == pytest.approx(np.array([[3.0 / 6.28, 0.0]] * 2), abs=1e-4)
    far = [
        circles(7000, 500.0, 20) + np.array([0.0, 0.0, 1e-3 * k])
        for k in range(2 if kind == "csv" else 1)
    ]
    strokes, _ = load_with_remarks(strokes_as_text(far, kind), f"a.{kind}")
    assert 2500 < sum(map(len, strokes)) <= SKETCH_LIMITS.loaded_rows
    asked = json.dumps({"ask": "draw", "strokes": strokes})
    assert len(asked) < PAGE_REQUEST_RULES.largest_body
    assert isinstance(decode_page_message(asked), Draw)


def test_a_file_of_very_many_strokes_keeps_both_ends_of_each():
    drawn = [
        np.array([[0.0, 0.01 * k, 0.0], [0.1, 0.01 * k, 0.1], [0.2, 0.01 * k, 0.2]])
        for k in range(3000)
    ]
    strokes, _ = load_with_remarks(strokes_as_text(drawn, "csv"), "a.csv")
    assert [len(stroke) for stroke in strokes] == [2] * 3000


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.txt", "", "ends in .csv or .svg"),
        ("a.csv", "stroke,t,x\n", "no column y"),
        ("a.csv", "", "empty"),
        ("a.csv", "stroke,t,x,y\n1,0,nan,2\n", "finite"),
        ("a.svg", "<svg>", "no line"),
    ],
)
def test_files_that_are_none_are_refused_by_name(name, text, words):
    with pytest.raises(ConfigError, match=words) as raised:
        load_with_remarks(text, name)
    assert name in str(raised.value)


def test_a_path_is_moved_as_a_whole():
    path = plan_sketch((WAVE, DOWN), Pen(), config_of()).path
    away = path.shifted((1.0, -2.0, 0.5)).samples(
        np.linspace(0, path.duration, 50)
    ) - path.samples(np.linspace(0, path.duration, 50))
    assert np.allclose(away[:, 0:3], [1.0, -2.0, 0.5])
    assert np.allclose(away[:, 3:], 0.0)


def write_eight(file):
    eight = minimum_snap(
        [[0, 0, 0], [0.8, 0.4, 0], [0, 0, 0], [-0.8, -0.4, 0], [0, 0, 0]],
        [0.0, 2.0, 4.0, 6.0, 8.0],
    )
    write_pieces(file, eight)
    return eight


def test_a_file_of_pieces_is_flown_as_a_trajectory_raised_and_slowed(tmp_path):
    file = tmp_path / "eight.csv"
    eight = write_eight(file)
    plan = plan_file(file, config_of(), height=1.1, v_max=0.5, slower=2.0)
    assert plan.path.duration == pytest.approx(2.0 * eight.duration)
    assert plan.path.sample(0.0).p == pytest.approx([0.0, 0.0, 1.1])
    told = flight_messages(plan.path, (2, 3), (0.0, 0.5, 0.0), config_of())
    assert len(told[2]["durations"]) == 4
    low = plan_file(file, config_of(), height=None, v_max=0.5, slower=2.0)
    with pytest.raises(ConfigError, match="fence"):
        flight_messages(low.path, (2, 3), (0.0, 0.5, 0.0), config_of())
    relative = flight_messages(
        low.path, (2, 3), (0.0, 0.0, 0.0), config_of(), is_relative=True
    )
    assert relative[3]["relative"] is True


@pytest.mark.parametrize("slower", [0.0, 0.04, 20.1, float("nan")])
def test_a_trajectory_has_a_factor_of_at_most_twenty(tmp_path, slower):
    file = tmp_path / "eight.csv"
    write_eight(file)
    with pytest.raises(ConfigError, match=r"eight.csv: slower: .*0.05 to 20 times"):
        plan_file(file, config_of(), height=1.0, v_max=0.5, slower=slower)


def test_a_wrong_number_in_a_file_of_pieces_is_named_with_its_line(tmp_path):
    file = tmp_path / "eight.csv"
    write_eight(file)
    rows = file.read_text().splitlines()
    rows[2] = rows[2].replace(",", ",x", 1)
    file.write_text("\n".join(rows))
    with pytest.raises(ConfigError, match=r"eight.csv, line 3, column 2 \(x\^0\)"):
        plan_file(file, config_of(), height=1.0, v_max=0.5, slower=1.0)


def test_the_memory_of_a_drone_gets_a_trajectory_at_its_own_pace_from_its_start(
    tmp_path,
):
    file = tmp_path / "eight.csv"
    eight = write_eight(file)
    plan = plan_file(file, config_of(), 1.0, 0.5, slower=2.0, is_reversed=True)
    flown = flight_messages(plan.path, (2,), (0.0, 0.0, 0.0), config_of())
    told = on_board_messages(flown, 2.0, is_reversed=True)[2]
    assert told["on_board"] == {"timescale": 2.0, "reversed": True}
    stored = Piecewise(told["coefficients"], told["durations"])
    assert stored.duration == pytest.approx(eight.duration)
    away = stored.sample(1.0).p - eight.sample(1.0).p
    assert away == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)


def test_more_pieces_than_the_memory_has_room_for_are_refused_with_its_size():
    hop = np.zeros((32, 4, 8))
    long = {2: {"coefficients": hop, "durations": np.full(32, 0.5)}}
    words = (
        r"trajectory on board: found 32 pieces, 4224 bytes; allowed: at most 31 pieces"
    )
    with pytest.raises(ConfigError, match=words):
        on_board_messages(long, 1.0, is_reversed=False)
