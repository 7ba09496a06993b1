"""Trajectories of files, slowed and raised before they are flown."""

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.feasibility import Limits, compute_peaks
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.placed_trajectory import place_trajectory

LIMITS = Limits(v_max=1.0, a_max=2.0)
EIGHT = minimum_snap(
    [[0, 0, 0], [0.8, 0.4, 0], [0, 0, 0], [-0.8, -0.4, 0], [0, 0, 0]],
    [0.0, 1.2, 2.4, 3.6, 4.8],
)


def test_a_trajectory_is_slowed_and_starts_at_the_height_that_was_asked_for():
    flown = place_trajectory(EIGHT, LIMITS, "eight.csv", slower=3.0, height=1.2)
    assert flown.duration == pytest.approx(3.0 * EIGHT.duration)
    np.testing.assert_allclose(flown.sample(0.0).p, (0.0, 0.0, 1.2), atol=1e-9)
    np.testing.assert_allclose(
        flown.sample(3.0).p - EIGHT.sample(1.0).p, (0.0, 0.0, 1.2), atol=1e-9
    )


def test_without_a_height_a_trajectory_is_flown_where_its_file_has_it():
    flown = place_trajectory(EIGHT.shifted((0, 0, 0.7)), LIMITS, "eight.csv", 3.0)
    assert flown.sample(0.0).p[2] == pytest.approx(0.7)


def test_a_trajectory_that_is_too_fast_is_refused_with_the_factor_that_helps():
    words = (
        r"eight.csv: found up to .* m/s and .* m/s2; allowed: at most 1 m/s and 2 m/s2"
    )
    with pytest.raises(ConfigError, match=words) as raised:
        place_trajectory(EIGHT, LIMITS, "eight.csv")
    factor = float(str(raised.value).split("slower = ")[1].split(",")[0])
    peaks = compute_peaks(place_trajectory(EIGHT, LIMITS, "eight.csv", factor))
    assert peaks["speed"] <= 1.001
    assert peaks["acceleration"] <= 2.002


def test_a_trajectory_that_does_not_end_at_rest_is_refused():
    c = np.zeros((1, 4, 8))
    c[0, 0, 3] = 0.5
    with pytest.raises(ConfigError, match=r"ramp.csv: end: found 1.50 m/s; allowed"):
        place_trajectory(Piecewise(c, [1.0]), LIMITS, "ramp.csv", 1.0)
