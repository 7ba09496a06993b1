import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.stroke import csv_of, parse_strokes
from crazychoir.planning.svg import MOST_POINTS, parse_svg, read_svg, svg_of


def strokes(d, scale=1.0):
    return parse_svg(f'<svg><path d="{d}"/></svg>', "a.svg", scale)


def flat(d):
    """Its strokes as nested lists, with y as in the picture."""
    return [(stroke * (1.0, -1.0)).round(6).tolist() for stroke in strokes(d)]


@pytest.mark.parametrize(
    ("d", "places"),
    [
        ("M1 2L3 4", [[[1, 2], [3, 4]]]),
        ("M1,2 3,4 5,6", [[[1, 2], [3, 4], [5, 6]]]),
        ("m1 2 1 1 1-1", [[[1, 2], [2, 3], [3, 2]]]),
        ("M1 1h2v-3H0V0", [[[1, 1], [3, 1], [3, -2], [0, -2], [0, 0]]]),
        ("M0 0L1 0 1 1Z", [[[0, 0], [1, 0], [1, 1], [0, 0]]]),
        ("M0 0L1 0zl0 1", [[[0, 0], [1, 0], [0, 0]], [[0, 0], [0, 1]]]),
        ("M0 0L1 0M5 5l1 0", [[[0, 0], [1, 0]], [[5, 5], [6, 5]]]),
        ("M.5.5L1e1-2.5E-1", [[[0.5, 0.5], [10, -0.25]]]),
        ("M0 0A0 3 0 0 1 4 4", [[[0, 0], [4, 4]]]),
    ],
)
def test_straight_lines_are_read_as_they_are(d, places):
    assert flat(d) == places


def test_curves_go_where_they_should():
    (cubic,) = strokes("M0 0C0 1 1 1 1 0S2 -1 2 0")
    assert cubic[12] * (1, -1) == pytest.approx([0.5, 0.75])
    assert cubic[36] * (1, -1) == pytest.approx([1.5, -0.75]), "its first handle is the last one, mirrored"
    (quadratic,) = strokes("M0 0q1 2 2 0t2 0")
    assert quadratic[12] * (1, -1) == pytest.approx([1.0, 1.0])
    assert quadratic[36] * (1, -1) == pytest.approx([3.0, -1.0])
    assert quadratic[-1] * (1, -1) == pytest.approx([4.0, 0.0])


@pytest.mark.parametrize(("large", "sweep", "middle"), [(0, 1, (1, 0)), (0, 0, (0, 1)), (1, 1, (1.707, -0.707)), ])
def test_an_arc_is_one_of_its_circle(large, sweep, middle):
    (arc,) = strokes(f"M0 0A1 1 0 {large} {sweep} 1 1")
    picture = arc * (1, -1)
    centre = {(0, 1): (0, 1), (0, 0): (1, 0), (1, 1): (1, 0)}[large, sweep]
    assert np.linalg.norm(picture - centre, axis=1) == pytest.approx(np.ones(len(arc)))
    assert picture[-1].tolist() == [1.0, 1.0]
    length = np.linalg.norm(np.diff(arc, axis=0), axis=1).sum()
    assert length == pytest.approx((1.5 if large else 0.5) * np.pi, rel=1e-2)


def test_an_ellipse_that_is_too_small_grows():
    (arc,) = strokes("M0 0A1 2 30 0 1 10 0")
    assert np.isfinite(arc).all()
    assert (arc * (1, -1))[-1].tolist() == [10.0, 0.0]


def test_other_shapes_are_read_and_y_points_up_and_units_are_millimetres():
    text = """<?xml version="1.0"?><!DOCTYPE svg [<!ENTITY a "aaaa">]>
    <svg><g><polyline points="0,0 1000,0 1000,500"/></g><line x1="1" y1="2" x2="3"/><polygon points="0 0 1 0 1 1"/>
    <circle r="3"/></svg>"""
    first, second, third = parse_svg(text, "a.svg")
    assert first.tolist() == [[0, 0], [1.0, 0], [1.0, -0.5]]
    assert second.tolist() == [[0.001, -0.002], [0.003, 0.0]]
    assert len(third) == 4


@pytest.mark.parametrize(
    ("d", "words"),
    [("L1 1", "M first"), ("M1", "breaks off"), ("M1 1L", "breaks off"), ("M1 1X2", "'X'"), ("1 1", "after 'nothing'"),
     ("M0 0L1 1Z3", "3 after 'Z'"), ("", "no line"), ("M1 1", "no line"), ("M0 0 nan 1", "'n'")],
)  # fmt: skip
def test_what_is_no_path_is_refused_with_the_place_and_what_is_allowed(d, words):
    with pytest.raises(ConfigError, match=words) as raised:
        strokes(d)
    assert str(raised.value).startswith("a.svg: found")


def test_a_picture_of_too_many_places_is_refused():
    with pytest.raises(ConfigError, match="at most 100000"):
        strokes("M0 0" + "h1" * MOST_POINTS)


def test_strokes_are_read_as_they_were_written(tmp_path):
    drawn = [np.array([[0.0, 0.1, 0.2], [0.5, -1.3, 0.7]]), np.array([[1.0, 2.0, -0.25], [2.0, 2.0, 0.25]])]
    path = tmp_path / "a.svg"
    path.write_text(svg_of(drawn))
    for stroke, read in zip(drawn, read_svg(path), strict=True):
        assert read == pytest.approx(stroke[:, 1:], abs=1e-5)
    for stroke, read in zip(drawn, parse_strokes(csv_of(drawn), "a.csv"), strict=True):
        assert read == pytest.approx(stroke, abs=1e-4)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.svg"):
        read_svg(tmp_path / "none.svg")


@pytest.mark.parametrize(
    ("text", "words"),
    [("<![a[", "found"), (f'<path d="&#{"9" * 5000};"/>', "no SVG"), ('<path d="M0 0L1e999 0"/>', "1e999"),
     ('<path d="M0 0L1.7e308 0l1.7e308 0"/>', "not finite"), ('<path d="M0 0A1e200 1e200 0 0 1 5 5"/>', "too far off"),
     ('<path d="M0 0A1e100 1e100 0 0 1 5 5"/>', "too far off"),
     ('<path d="M0 0A1e-200 1e-200 0 0 1 1e-200 0"/>', "too far off")],
)  # fmt: skip
def test_what_cannot_be_reckoned_with_is_refused_by_name(text, words):
    with pytest.raises(ConfigError, match=words) as raised:
        parse_svg(text, "a.svg")
    assert "a.svg" in str(raised.value)
