import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.drawing import (
    DRAWING_LIMITS,
    Pen,
    plan_drawing,
    smooth_line,
)
from crazychoir.planning.drawing.stroke import (
    format_strokes,
    parse_strokes,
    read_strokes,
)
from crazychoir.planning.drawing.svg import parse_svg
from crazychoir.planning.feasibility import Limits, check_limits, compute_peaks

ARC = np.array(
    [(0.5 * math.cos(a), 0.5 * math.sin(a)) for a in np.linspace(0.0, 4.0, 120)]
)
TOO_FINE = np.array(
    [(x, 0.1 * math.sin(2.0 * math.pi * x / 0.03)) for x in np.linspace(0, 1, 1500)]
)
"""Waves as high as 0.2 m every 30 mm: between two knots they go up and down."""
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
    drawn = plan_drawing(word, pen)
    path = drawn.path
    check_limits(path, DRAWING_LIMITS)
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
    try:
        path = plan_drawing(strokes).path
    except ConfigError:
        with pytest.raises(ConfigError, match="mm beside it"):
            plan_drawing(strokes)
        return
    check_limits(path, DRAWING_LIMITS)
    np.testing.assert_allclose(path.sample(0.0).p[0:2], strokes[0][0], atol=1e-9)
    np.testing.assert_allclose(
        path.sample(path.duration).p[0:2], strokes[-1][-1], atol=1e-6
    )


def test_a_lifted_pen_flies_above_the_drawing_and_a_plain_one_does_not():
    lifted, plain = (
        plan_drawing([ARC, LINE], Pen(lift=0.4)).path,
        plan_drawing([ARC, LINE]).path,
    )
    heights = [lifted.sample(t).p[2] for t in np.linspace(0.0, lifted.duration, 500)]
    assert max(heights) == pytest.approx(1.4, abs=1e-3)
    assert max(
        plain.sample(t).p[2] for t in np.linspace(0.0, plain.duration, 500)
    ) == pytest.approx(1.0)


def test_height_and_yaw_are_the_pens():
    path = plan_drawing([ARC], Pen(height=0.7, yaw=0.3)).path
    for t in np.linspace(0.0, path.duration, 20):
        assert path.sample(t).p[2] == pytest.approx(0.7)
        assert path.sample(t).yaw == pytest.approx(0.3)


def test_yaw_along_the_path_looks_ahead():
    path = plan_drawing([ARC], Pen(yaw="along")).path
    for t in np.linspace(0.1 * path.duration, 0.9 * path.duration, 20):
        state = path.sample(t)
        assert math.cos(state.yaw - math.atan2(state.v[1], state.v[0])) > 0.99


def test_a_slow_hand_is_followed_slowly():
    even = np.linspace(0.0, 2.0, len(ARC))
    slow_at_first = np.where(even < 1.0, 5.0 * even, 4.0 + even)
    path = plan_drawing(
        [np.column_stack([slow_at_first, ARC])], Pen(timing="drawn")
    ).path
    middle = path.sample(0.5 * path.duration).p[0:2]
    assert np.linalg.norm(ARC - middle, axis=1).argmin() < 0.45 * len(ARC)


def test_tremor_is_smoothed_within_the_deviation_that_is_reported():
    rng = np.random.default_rng(2)
    shaken = ARC + rng.normal(scale=0.004, size=ARC.shape)
    drawn = plan_drawing([shaken], Pen(smoothing=0.006))
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
    places = smooth_line(shaken, u, 0.012, u)
    np.testing.assert_allclose(places[[0, -1]], shaken[[0, -1]], atol=1e-4)
    assert (
        np.linalg.norm(places - ARC, axis=1)[5:-5].mean()
        < 0.6 * np.linalg.norm(shaken - ARC, axis=1).mean()
    )


def test_the_deviation_looks_from_the_drawn_line_and_from_the_flown_one(word):
    drawn = plan_drawing(word[1:2], Pen(timing="drawn"))
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
    drawn = plan_drawing(
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
    drawn = plan_drawing([[(0.1, 0.1)], ARC, [(0.0, 0.0), (0.0, 0.0)]])
    path = drawn.path
    assert drawn.deviation < 0.01
    np.testing.assert_allclose(path.sample(0.0).p, (0.1, 0.1, 1), atol=1e-9)
    np.testing.assert_allclose(path.sample(path.duration).p, (0, 0, 1), atol=1e-9)


def test_other_limits_hold_too():
    limits = Limits(v_max=1.0, a_max=3.0, j_max=2.0, tilt_max=0.25)
    most = compute_peaks(plan_drawing([ARC, LINE], limits=limits).path)
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
        plan_drawing(
            strokes, Pen(**pen), Limits(**({"v_max": 0.5, "a_max": 1.0} | limits))
        )


straight = st.tuples(
    st.floats(0.02, 2.0), st.lists(st.floats(0.01, 0.99), max_size=2, unique=True)
)
"""Its length in m, and where on it there are more places, as shares."""
bend = st.tuples(
    st.floats(0.05, 0.8), st.floats(0.3, 3.0), st.sampled_from([-1, 1]), st.integers(0)
)
"""Its radius in m, by how much and to which side it turns in rad, and the seed of uneven places on it."""


def stroke_of(sections):
    """Return straights and bends one after the other: rows x, y m, the same with places 1 mm apart, and as SVG."""
    p = 0.0j
    direction = 1.0 + 0.0j
    places = [p]
    dense = [p]
    svg = "M0 0"
    for section in sections:
        if len(section) == 2:
            length, more = section
            places += [p + share * length * direction for share in sorted(more)]
            steps = np.linspace(0.0, length, math.ceil(length / 0.001))
            dense += (p + steps * direction).tolist()
            p += length * direction
            svg += f"L{1e3 * p.real} {-1e3 * p.imag}"
        else:
            radius, turn, side, seed = section
            centre = p + side * 1j * radius * direction
            sparsest = 2.0 * math.acos(1.0 - 0.002 / radius)
            even = np.linspace(0.0, turn, math.ceil(turn / sparsest) + 1)[1:]
            uneven = np.random.default_rng(seed).uniform(0.0, turn, seed % 20)
            angles = np.sort(np.concatenate([even, uneven]))
            steps = np.linspace(0.0, turn, math.ceil(turn * radius / 0.001) + 1)
            arm = p - centre
            dense += (centre + arm * np.exp(1j * side * steps)).tolist()
            places += (centre + arm * np.exp(1j * side * angles[:-1])).tolist()
            p = centre + arm * np.exp(1j * side * turn)
            direction *= np.exp(1j * side * turn)
            svg += f"A{1e3 * radius} {1e3 * radius} 0 0 {int(side < 0)} {1e3 * p.real} {-1e3 * p.imag}"
        places.append(p)
    return (
        np.column_stack([np.real(places), np.imag(places)]),
        np.column_stack([np.real(dense), np.imag(dense)]),
        f'<svg xmlns="http://www.w3.org/2000/svg"><path d="{svg}"/></svg>',
    )


def distance_between(path, lines):
    """Return the largest distance between a flight and lines, m, from each to the other."""
    flown = path.samples(np.arange(0.0, path.duration, 0.002))[:, 0:2]
    there = cKDTree(flown).query(lines)[0]
    back = cKDTree(lines).query(flown)[0]
    return max(there.max(), back.max())


@settings(max_examples=60)
@given(
    st.lists(st.one_of(straight, bend), min_size=1, max_size=7),
    st.sampled_from([Pen(), Pen(smoothing=0.0), Pen(spacing=0.03)]),
)
def test_straights_and_bends_with_uneven_places_are_flown_as_they_are(sections, pen):
    places, dense, svg = stroke_of(sections)
    timed = np.column_stack([0.1 * np.arange(len(places)), places])
    for strokes in (
        parse_strokes(format_strokes([timed]), "a.csv"),
        parse_svg(svg, "a.svg"),
    ):
        drawn = plan_drawing(strokes, pen)
        check_limits(drawn.path, DRAWING_LIMITS)
        assert drawn.deviation <= pen.allowed_deviation
        assert distance_between(drawn.path, dense) < 0.03


def stadium():
    """Return two half circles of 13 places each, and nothing on the straights between them."""
    angles = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 13)
    right = 0.1 * np.column_stack([np.cos(angles), np.sin(angles)]) + (0.4, 0.0)
    return np.concatenate([right, -right, right[:1]])


def rounded(width, height, radius):
    """Return what is read of a rectangle with rounded corners; m."""
    size = f'width="{1e3 * width}" height="{1e3 * height}" rx="{1e3 * radius}"'
    text = f'<svg xmlns="http://www.w3.org/2000/svg"><rect {size}/></svg>'
    return parse_svg(text, "a.svg")[0]


@pytest.mark.parametrize(
    "stroke",
    [
        rounded(1.0, 0.8, 0.03),
        rounded(0.4, 0.2, 0.03),
        rounded(20.0, 0.8, 0.03),
        stadium(),
    ],
    ids=["large", "small", "long", "stadium"],
)
def test_long_sides_between_bends_stay_straight(stroke):
    assert plan_drawing([stroke]).deviation < 0.015


@pytest.mark.parametrize("corners", [5, 6, 8, 12])
def test_a_polygon_keeps_its_sides(corners):
    angles = np.linspace(0.0, 2.0 * math.pi, corners + 1)
    polygon = 0.5 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert plan_drawing([polygon]).deviation < 0.015


def test_a_long_line_does_not_pay_for_its_bends():
    def deviation(length):
        bent = [(0.0, 0.0), (length, 0.0), (length + 0.3, 0.3), (2.0 * length, 0.3)]
        return plan_drawing([bent]).deviation

    assert deviation(40.0) < deviation(1.0) + 0.005


def test_a_scrawl_of_short_lines_does_not_swing_out():
    square_waves = [(0.015 * (k // 2), 0.05 * ((k + 1) // 2 % 2)) for k in range(133)]
    assert plan_drawing([square_waves]).deviation < Pen().allowed_deviation


@pytest.mark.parametrize(("smoothing", "allowed"), [(0.0, 25), (0.004, 39)])
def test_a_drawing_that_is_too_fine_to_be_followed_is_refused(smoothing, allowed):
    words = (
        rf"drawing: strokes\[1\]: found a flight \d+ mm beside it, at x = .* m, y = .* m; "
        rf"allowed: at most {allowed} mm with knots every 50 mm and a smoothing of {1e3 * smoothing:.0f} mm. "
        "Draw it larger, or with its bends farther from each other."
    )
    with pytest.raises(ConfigError, match=words):
        plan_drawing([ARC, TOO_FINE], Pen(smoothing=smoothing))


def test_a_drawing_that_is_too_fine_is_flown_when_it_is_larger():
    assert plan_drawing([10.0 * TOO_FINE]).deviation < Pen().allowed_deviation


def test_a_circle_of_the_size_of_a_dot_is_a_dot():
    angles = np.linspace(0.0, 2.0 * math.pi, 20)
    dot = 0.005 * np.column_stack([np.cos(angles), np.sin(angles)])
    dot[-1] = dot[0]
    assert plan_drawing([LINE, dot]).deviation == pytest.approx(0.01, abs=0.001)


def test_a_straight_line_is_flown_at_any_speed():
    """The samples of a fast flight are far apart, and lie on the line all the same."""
    line = np.array([[0.0, 0.0], [60.0, 0.0]])
    made = plan_drawing([line], Pen(), Limits(v_max=20.0, a_max=20.0, yaw_rate_max=2.0))
    assert made.deviation < 0.005
