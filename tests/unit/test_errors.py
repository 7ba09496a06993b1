"""The place where an error was raised, as reports name it."""

import json

import numpy as np
import pytest

from crazychoir.errors import raised_at
from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import LAW_ROW
from crazychoir.guidance.decision.team import Team


@pytest.mark.parametrize(
    "law",
    [lambda: np.linalg.inv(np.zeros((2, 2))), lambda: json.loads("{"), lambda: 1 / 0],
)
def test_libraries_are_not_to_blame(law):
    with pytest.raises(Exception, match=r".") as caught:
        law()
    at = raised_at(caught.value)
    assert (at.filename, at.name) == (__file__, "<lambda>")


def test_where_only_libraries_are_it_is_the_last_line():
    with pytest.raises(ValueError, match="Expecting") as caught:
        json.loads("{")
    caught.value.__traceback__ = caught.value.__traceback__.tb_next
    assert raised_at(caught.value).filename.endswith("decoder.py")


def test_the_line_of_a_user_comes_before_a_deeper_one_of_the_package():
    with pytest.raises(ValueError, match="broadcast") as caught:
        Team(np.zeros(2, LAW_ROW), np.zeros(0, HEARING_ROW)).accelerate(np.zeros(2))
    at = raised_at(caught.value)
    assert at.filename == __file__
    caught.value.__traceback__ = caught.value.__traceback__.tb_next
    assert raised_at(caught.value).filename.endswith("team.py"), "the package alone"
