import numpy as np
import pytest

from crazychoir.guidance.law_tally import LawTally, explain_wrong_return
from crazychoir.types import Acceleration


def test_a_law_without_refusals_has_no_faults():
    tally = LawTally(3, steps=5, hovered=2)
    assert tally.usable == 3
    assert tally.list_faults() == {}


def test_few_refusals_are_only_counted():
    tally = LawTally(3, steps=5, hovered=1)
    tally.refuse("too fast")
    assert tally.usable == 3
    assert tally.list_faults() == {"refused_references": 1}


def test_a_law_with_mostly_refused_references_says_why_the_last_was_refused():
    tally = LawTally(3, steps=3)
    tally.refuse("too fast")
    tally.refuse("too far")
    why = "drone 3: the law gave no usable reference in 2 of 3 steps: too far"
    assert tally.list_faults() == {"refused_references": 2, "refused": why}


def test_a_law_with_none_but_refused_references_fails():
    tally = LawTally(3, steps=2, hovered=1)
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
