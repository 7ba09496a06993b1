import numpy as np
import pytest

from crazychoir.guidance.law_tally import LawTally, explain_wrong_return
from crazychoir.types import Acceleration


def counted(steps, hovered):
    """Return the tally of drone 3 after so many steps, and so many None among them."""
    tally = LawTally(3)
    for k in range(steps):
        tally.count(None if k < hovered else Acceleration(np.zeros(3)))
    return tally


def test_a_law_without_refusals_has_no_faults():
    tally = counted(5, 2)
    assert tally.usable == 3
    assert tally.list_faults() == {}


def test_few_refusals_are_only_counted():
    tally = counted(5, 1)
    tally.refuse("too fast")
    assert tally.usable == 3
    assert tally.list_faults() == {"refused_references": 1}


def test_a_law_with_mostly_refused_references_says_why_the_last_was_refused():
    tally = counted(3, 0)
    tally.refuse("too fast")
    tally.refuse("too far")
    why = "drone 3: the law gave no usable reference in 2 of 3 steps: too far"
    assert tally.list_faults() == {"refused_references": 2, "refused": why}


def test_a_law_with_none_but_refused_references_fails():
    tally = counted(2, 1)
    tally.refuse("too far")
    why = "drone 3: the law gave no usable reference in 1 of 2 steps (None in the others): too far"
    assert tally.list_faults() == {
        "refused_references": 1,
        "refused": why,
        "success": False,
        "reason": why,
    }


@pytest.mark.parametrize(
    ("reference", "found"),
    [
        (np.zeros(2), "found ndarray (2,)"),
        (3.0, "found float"),
        (Acceleration(np.zeros(2)), "Acceleration of (3,); found Acceleration("),
    ],
)
def test_a_wrong_return_value_is_named(reference, found):
    assert found in explain_wrong_return(reference)
