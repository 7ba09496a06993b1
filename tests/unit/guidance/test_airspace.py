"""Levels for drones."""

import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.airspace import levels


def test_each_drone_has_a_level_of_its_own_by_its_id():
    assert levels([7, 3, 5], 0.4, 0.25, 2.0) == pytest.approx({3: 0.4, 5: 0.65, 7: 0.9})


def test_levels_that_do_not_fit_are_refused():
    with pytest.raises(ConfigError, match=r"1\.90 m.*at most 1\.80 m"):
        levels(range(4), 0.4, 0.5, 1.8)
