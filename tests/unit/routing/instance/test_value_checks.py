"""Checks of single values of an instance file."""

import math

import numpy as np
import pytest

from crazychoir.errors import InstanceError
from crazychoir.routing.instance.value_checks import ValueChecks, describe_size

CHECKS = ValueChecks("lab.json")


@pytest.mark.parametrize(
    ("value", "found"),
    [
        ("3", '"3"; allowed: a number'),
        (True, "true; allowed: a number"),
        (math.nan, "nan; allowed: a number from 0 to 9"),
        (10, "10; allowed: a number from 0 to 9"),
        (-1, "-1; allowed: a number from 0 to 9"),
    ],
)
def test_a_number_outside_its_range_is_refused_with_its_place(value, found):
    with pytest.raises(InstanceError) as error:
        CHECKS.number("load[2]", value, most=9)
    assert str(error.value).startswith(f"lab.json: load[2]: found {found}")


@pytest.mark.parametrize("value", [True, 1.0, "1", -1, 4, None])
def test_what_is_no_whole_number_of_the_range_is_refused(value):
    with pytest.raises(InstanceError, match=r"lab\.json: trips"):
        CHECKS.whole_number("trips", value, range(4), "0 to 3", "Write one.")


def test_a_whole_number_of_the_range_is_returned():
    assert CHECKS.whole_number("trips", 3, range(4), "0 to 3", "Write one.") == 3


def test_one_number_counts_for_all():
    assert CHECKS.numbers("speed", 2, 3, 1.0, most=5).tolist() == [2.0, 2.0, 2.0]
    assert CHECKS.numbers("speed", None, 2, 1.0).tolist() == [1.0, 1.0]
    assert CHECKS.numbers("speed", [1, 2], 2, 1.0, most=5).tolist() == [1.0, 2.0]
    with pytest.raises(InstanceError, match="one number, or 3 of them"):
        CHECKS.numbers("speed", [1, 2], 3, 1.0, most=5)


def test_a_window_may_be_open():
    assert CHECKS.window("w", None) == (0.0, math.inf)
    assert CHECKS.window("w", [3, None]) == (3.0, math.inf)
    with pytest.raises(InstanceError, match="to not before from"):
        CHECKS.window("w", [3, 2])


def test_one_matrix_counts_for_all_robots_or_each_has_its_own():
    matrix = [[0.0, 1.0], [1.0, 0.0]]
    assert np.array_equal(CHECKS.matrices("d", matrix, 2, 2), matrix)
    assert np.array_equal(CHECKS.matrices("d", [matrix] * 2, 2, 2), [matrix] * 2)
    with pytest.raises(InstanceError, match="3 matrices, one a robot, or one"):
        CHECKS.matrices("d", [matrix] * 2, 3, 2)


@pytest.mark.parametrize(
    ("rows", "place"),
    [
        ([[True]], "capability:"),
        ([[True], [True, False]], r"capability\[0\]:"),
        ([[True, False], [True, 1]], r"capability\[1\]\[1\]:"),
    ],
)
def test_a_mask_of_another_shape_or_kind_is_refused(rows, place):
    with pytest.raises(InstanceError, match=rf"lab\.json: {place}"):
        CHECKS.booleans("capability", rows, 2, 2)


def test_a_list_is_described_by_its_length():
    assert describe_size([1, 2]) == "2 entries"
    assert describe_size("ab") == "'ab'"
