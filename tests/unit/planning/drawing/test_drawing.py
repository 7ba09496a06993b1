import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.drawing import STANDARD, Pen, drawing, smoothed
from crazychoir.planning.drawing.stroke import read_strokes
from crazychoir.planning.feasibility import Limits, check, peaks

ARC = np.array(
    [(0.5 * math.cos(a), 0.5 * math.sin(a)) for a in np.linspace(0.0, 4.0, 120)]
)
coordinate = st.floats(-1.0, 1.0)
LINE = np.array([(0.9, 0.0), (0.9, 0.6)])


@pytest.fixture(scope="module")
def word(repository):
    return read_strokes(repository / "agents" / "data" / "casy.csv")


@pytest.mark.parametrize(
    "pen",
    [Pen(), Pen(timing="drawn"), Pen(yaw="along"), Pen(lift=0.3), Pen(spacing=0.03)],
)
def test_the_drawn_word_can_be_flown(word, pen):
    drawn = drawing(word, pen)
    path = drawn.path
    check(path, STANDARD)
    assert drawn.deviation < 0.025
    assert 0.4 < drawn.speed <= 0.5005
    assert drawn.acceleration <= 1.001
    assert path.jumps[0:3, 0:4].max() < 1e-8
    assert path.jumps[3, 0:2].max() < 1e-8
    np.testing.assert_allclose(path.sample(0.0).p, (*word[0][0, 1:], 1.0), atol=1e-9)
    np.testing.assert_allclose(
        path.sample(path.duration).p, (*word[-1][-1, 1:], 1.0), atol=1e-9
    )
    np.testing.assert_allclose(path.sample(path.duration).flat[3:12], 0.0, atol=1e-6)


def test_the_word_is_two_metres_wide_and_drawn_by_hand(word):
    places = np.concatenate(word)[:, 1:]
    assert np.ptp(places[:, 0]) == pytest.approx(2.0, abs=0.05)
    times = np.concatenate(word)[:, 0]
    assert (np.diff(times) >= 0.0).all()
    assert len(set(np.diff(times).round(3))) > 3


@settings(max_examples=25)
@given(
    st.lists(
        st.lists(st.tuples(coordinate, coordinate), min_size=2, max_size=12),
        min_size=1,
        max_size=3,
    )
)
def test_whatever_is_scribbled_keeps_its_ends_and_the_limits(strokes):
    if all(np.ptp(np.array(stroke), axis=0).max() < 0.01 for stroke in strokes):
        return
    path = drawing(strokes).path
    check(path, STANDARD)
    np.testing.assert_allclose(path.sample(0.0).p[0:2], strokes[0][0], atol=1e-9)
    np.testing.assert_allclose(
        path.sample(path.duration).p[0:2], strokes[-1][-1], atol=1e-6
    )


def test_a_lifted_pen_flies_above_the_drawing_and_a_plain_one_does_not():
    lifted, plain = drawing([ARC, LINE], Pen(lift=0.4)).path, drawing([ARC, LINE]).path
    heights = [lifted.sample(t).p[2] for t in np.linspace(0.0, lifted.duration, 500)]
    assert max(heights) == pytest.approx(1.4, abs=1e-3)
    assert max(
        plain.sample(t).p[2] for t in np.linspace(0.0, plain.duration, 500)
    ) == pytest.approx(1.0)


def test_height_and_yaw_are_the_pens():
    path = drawing([ARC], Pen(height=0.7, yaw=0.3)).path
    for t in np.linspace(0.0, path.duration, 20):
        assert path.sample(t).p[2] == pytest.approx(0.7)
        assert path.sample(t).yaw == pytest.approx(0.3)


def test_yaw_along_the_path_looks_ahead():
    path = drawing([ARC], Pen(yaw="along")).path
    for t in np.linspace(0.1 * path.duration, 0.9 * path.duration, 20):
        state = path.sample(t)
        assert math.cos(state.yaw - math.atan2(state.v[1], state.v[0])) > 0.99


def test_a_slow_hand_is_followed_slowly():
    even = np.linspace(0.0, 2.0, len(ARC))
    slow_at_first = np.where(even < 1.0, 5.0 * even, 4.0 + even)
    path = drawing([np.column_stack([slow_at_first, ARC])], Pen(timing="drawn")).path
    middle = path.sample(0.5 * path.duration).p[0:2]
    assert np.linalg.norm(ARC - middle, axis=1).argmin() < 0.45 * len(ARC)


def test_tremor_is_smoothed_within_the_deviation_that_is_reported():
    rng = np.random.default_rng(2)
    shaken = ARC + rng.normal(scale=0.004, size=ARC.shape)
    drawn = drawing([shaken], Pen(smoothing=0.006))
    x = np.array(
        [
            drawn.path.sample(t).p[0:2]
            for t in np.linspace(0.0, drawn.path.duration, 400)
        ]
    )
    assert np.abs(np.linalg.norm(x, axis=1) - 0.5).max() < 0.012
    assert 0.0 < drawn.deviation < 0.03


def test_smoothing_leaves_the_ends_where_they_are():
    shaken = ARC + np.random.default_rng(2).normal(scale=0.01, size=ARC.shape)
    u = np.cumsum([0.0, *np.linalg.norm(np.diff(shaken, axis=0), axis=1)])
    places = smoothed(shaken, u, 0.012, u)
    np.testing.assert_allclose(places[[0, -1]], shaken[[0, -1]], atol=1e-4)
    assert (
        np.linalg.norm(places - ARC, axis=1)[5:-5].mean()
        < 0.6 * np.linalg.norm(shaken - ARC, axis=1).mean()
    )


def test_the_deviation_looks_from_the_drawn_line_and_from_the_flown_one(word):
    drawn = drawing(word[1:2], Pen(timing="drawn"))
    flown = np.array(
        [
            drawn.path.sample(t).p[0:2]
            for t in np.linspace(0.0, drawn.path.duration, 2000)
        ]
    )
    apart = np.linalg.norm(flown[:, None] - word[1][None, :, 1:], axis=2)
    assert drawn.deviation == pytest.approx(
        max(apart.min(axis=0).max(), apart.min(axis=1).max()), abs=0.003
    )
    assert apart.min(axis=1).max() > apart.min(axis=0).max() + 0.004  # it overshoots


def test_a_bend_that_is_cut_counts_too():
    tip = np.array(
        [(0.0, 0.0), (0.5, 0.0), (0.5 + 0.5 * math.cos(1.3), 0.5 * math.sin(1.3))]
    )
    drawn = drawing(
        [np.concatenate([np.linspace(a, b, 60) for a, b in pairwise(tip)])],
        Pen(smoothing=0.02),
    )
    flown = np.array(
        [
            drawn.path.sample(t).p[0:2]
            for t in np.linspace(0.0, drawn.path.duration, 4000)
        ]
    )
    cut = float(np.linalg.norm(flown - tip[1], axis=1).min())
    assert cut > 0.01
    assert drawn.deviation >= cut - 0.001


def test_a_dot_is_flown_to():
    drawn = drawing([[(0.1, 0.1)], ARC, [(0.0, 0.0), (0.0, 0.0)]])
    path = drawn.path
    assert drawn.deviation < 0.01
    np.testing.assert_allclose(path.sample(0.0).p, (0.1, 0.1, 1), atol=1e-9)
    np.testing.assert_allclose(path.sample(path.duration).p, (0, 0, 1), atol=1e-9)


def test_other_limits_hold_too():
    limits = Limits(v_max=1.0, a_max=3.0, j_max=2.0, tilt_max=0.25)
    most = peaks(drawing([ARC, LINE], limits=limits).path)
    assert most["jerk"] <= 2.0 * 1.001
    assert most["tilt"] <= 0.25 * 1.001


@pytest.mark.parametrize(
    ("strokes", "pen", "limits", "complaint"),
    [
        ([], {}, {}, "at least one line"),
        ([[(1, 1)]], {}, {}, "at least one line"),
        ([[(1, 1)], [(0, 1)]], {}, {}, "at least one line"),
        ([ARC, [(0, 0), (math.nan, 0)]], {}, {}, r"strokes\[1\]\[1\]"),
        ([ARC], {"timing": "drawn"}, {}, "rows of t, x, y"),
        ([ARC], {"timing": "slow"}, {}, "Pen: timing"),
        ([ARC], {"yaw": math.nan}, {}, "Pen: yaw"),
        ([ARC], {"height": math.inf}, {}, "Pen: height"),
        ([ARC], {"lift": -0.1}, {}, "Pen: lift"),
        ([ARC], {"spacing": 0.0}, {}, "Pen: spacing"),
        ([ARC], {"smoothing": -1.0}, {}, "Pen: smoothing"),
        ([ARC], {}, {"v_max": math.inf}, "limits: v_max"),
        ([ARC], {}, {"high": (0.4, 9, 9)}, "fence"),
        ([ARC, LINE], {"lift": 2.0}, {"high": (9, 9, 2)}, "fence"),
    ],
)
def test_bad_drawings_are_refused(strokes, pen, limits, complaint):
    with pytest.raises(ConfigError, match=complaint):
        drawing(strokes, Pen(**pen), Limits(**({"v_max": 0.5, "a_max": 1.0} | limits)))
