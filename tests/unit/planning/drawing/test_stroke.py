import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.stroke import (
    check_stroke,
    fill_line,
    read_strokes,
    split_stroke,
    thin_line,
)
from crazychoir.planning.number_table import TableError

place = st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))


@given(st.lists(place, min_size=2, max_size=60), st.floats(0.01, 1.0))
def test_thinning_keeps_both_ends_and_distances(places, distance):
    xy = np.array(places)
    kept = thin_line(xy, distance)
    assert kept[0] == 0
    assert np.linalg.norm(xy[kept[-1]] - xy[-1]) < 1e-9
    assert kept == sorted(set(kept))
    steps = np.linalg.norm(np.diff(xy[kept], axis=0), axis=1)
    assert (steps[:-1] >= distance).all()
    assert len(steps) < 2 or steps[-1] >= 0.5 * distance


def test_the_last_point_replaces_a_point_that_is_too_near():
    xy = np.array([(0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.23, 0.0)])
    assert thin_line(xy, 0.1) == [0, 1, 3]
    assert thin_line(xy, 0.05) == [0, 1, 2, 3]
    assert thin_line(xy, 1.0) == [0, 3]


@given(st.lists(place, min_size=2, max_size=30, unique=True), st.floats(0.01, 1.0))
def test_filling_keeps_all_places_and_adds_some_on_the_lines_between(places, distance):
    xy = np.array(places)
    t, more = fill_line(np.arange(len(xy)), xy, distance)
    steps = np.linalg.norm(np.diff(more, axis=0), axis=1)
    assert steps.max() <= distance * (1.0 + 1e-6)
    kept = np.flatnonzero(np.isin(np.round(t, 9), np.arange(len(xy))))
    np.testing.assert_allclose(more[kept], xy, atol=1e-9)
    for axis in range(2):
        np.testing.assert_allclose(
            more[:, axis], np.interp(t, np.arange(len(xy)), xy[:, axis]), atol=1e-9
        )


def test_filling_changes_nothing_where_places_are_near_to_each_other():
    t = np.array([0.0, 1.0, 5.0])
    xy = np.array([(0.0, 0.0), (0.1, 0.0), (0.1, 0.05)])
    same_t, same_xy = fill_line(t, xy, 0.1)
    np.testing.assert_array_equal(same_t, t)
    np.testing.assert_array_equal(same_xy, xy)


def test_repeated_places_and_times_are_no_trouble():
    t, xy = check_stroke(
        [(0, 0, 0), (0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 1, 1)], "stroke"
    )
    np.testing.assert_array_equal(t, [0, 0, 1])
    np.testing.assert_array_equal(xy, [(0, 0), (1, 0), (1, 1)])


@pytest.mark.parametrize(
    ("rows", "complaint"),
    [
        ([], "shape"),
        ([1, 2, 3], "shape"),
        ([(1, 2, 3, 4)], "shape"),
        ([(0, 0), (np.nan, 0)], r"stroke\[1\]"),
        ([(0, 0, 0), (1, 1, 0), (0.5, 2, 0)], r"stroke\[2\]: t: found 0.5"),
    ],
)
def test_bad_strokes_are_refused(rows, complaint):
    with pytest.raises(ConfigError, match=complaint):
        check_stroke(rows, "stroke")


def test_a_stroke_is_split_where_it_turns_back_and_not_in_a_bend():
    s = np.linspace(0.0, 1.0, 200)
    there_and_back = np.concatenate(
        [np.column_stack([s, 0 * s]), np.column_stack([1 - s, 0.1 * s])]
    )
    parts = split_stroke(np.arange(400.0), there_and_back, 0.05)
    assert len(parts) == 2
    np.testing.assert_allclose(parts[0][1][-1], (1, 0), atol=0.01)
    np.testing.assert_array_equal(parts[0][1][-1], parts[1][1][0])
    np.testing.assert_array_equal(parts[1][1][-1], there_and_back[-1])
    round_trip = 0.2 * np.column_stack([np.cos(6 * s), np.sin(6 * s)])
    assert len(split_stroke(s, round_trip, 0.05)) == 1


def test_strokes_are_read_by_their_number(tmp_path):
    file = tmp_path / "strokes.csv"
    file.write_text("stroke,t,x,y\n0,0,1,2\n0,0.1,1.5,2\n4,0.05,3,3\n")
    first, second = read_strokes(file)
    np.testing.assert_array_equal(first, [(0, 1, 2), (0.1, 1.5, 2)])
    np.testing.assert_array_equal(second, [(0.05, 3, 3)])


@pytest.mark.parametrize(
    ("rows", "complaint"),
    [
        ("0,0,0,0\n1,0,0,0\n0,1,0,0\n", r"line 4, column 1 \(stroke\): found 0 again"),
        ("0,1,0,0\n0,0.5,0,0\n", r"line 3, column 2 \(t\): found 0.5"),
        ("0,1,0,zero\n", r"line 2, column 4 \(y\): found 'zero'"),
    ],
)
def test_bad_files_of_strokes_are_refused(tmp_path, rows, complaint):
    file = tmp_path / "strokes.csv"
    file.write_text("stroke,t,x,y\n" + rows)
    with pytest.raises(TableError, match=complaint):
        read_strokes(file)
