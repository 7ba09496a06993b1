"""Velocities between world and body, and what lies between two times."""

import numpy as np
import pytest

from crazychoir.numerics.math3d import rotation
from crazychoir.recording.analysis.figures import (
    LARGEST_JOINED_GAP,
    interpolate_track,
    rms,
)
from crazychoir.recording.mcap.odometry import odometry_numbers, rotate_to_world
from crazychoir.types import State

DRAW = np.random.default_rng(1)


@pytest.fixture
def states():
    x = DRAW.normal(size=(50, 13))
    x[:, 6:10] /= np.linalg.norm(x[:, 6:10], axis=1)[:, None]
    return x


def test_odometry_has_velocities_of_the_body(states):
    for x in states:
        found, r = np.array(odometry_numbers(State(x))), rotation(x[6:10])
        assert np.array_equal(
            found[[0, 1, 2, 3, 4, 5, 6, 10, 11, 12]],
            x[[0, 1, 2, 6, 7, 8, 9, 10, 11, 12]],
        )
        assert found[7:10] == pytest.approx(r.T @ x[3:6], abs=1e-14)


def test_into_the_world_and_back(states):
    for x in states:
        assert rotate_to_world(x[None, 6:10], x[None, 3:6])[0] == pytest.approx(
            rotation(x[6:10]) @ x[3:6], abs=1e-14
        )
    out = np.array([odometry_numbers(State(x)) for x in states])
    assert rotate_to_world(out[:, 3:7], out[:, 7:10]) == pytest.approx(
        states[:, 3:6], abs=1e-13
    )


def test_joined_is_exact_for_lines_and_second_order_between():
    t = np.arange(0.0, 1.001, 0.1)
    at = np.array([-0.01, 0.0, 0.05, 0.123, 1.0, 1.01])
    found = interpolate_track(t, np.column_stack([2.0 * t - 1.0, t * t]), at)
    assert found[1:5, 0] == pytest.approx(2.0 * at[1:5] - 1.0)
    assert np.abs(found[1:5, 1] - at[1:5] ** 2).max() <= 0.1**2 / 4.0 + 1e-12
    assert np.isnan(found[[0, 5]]).all()


def test_nothing_is_joined_across_a_gap():
    t = np.array([0.0, 0.1, 0.1 + 1.01 * LARGEST_JOINED_GAP, 0.4])
    found = interpolate_track(t, t[:, None], np.array([0.05, 0.2, 0.3]))[:, 0]
    assert np.isfinite(found).tolist() == [True, False, True]
    assert np.isnan(interpolate_track(t[:1], t[:1, None], t)).all()


def test_rms():
    assert rms(np.array([3.0, np.nan, 4.0])) == pytest.approx(np.sqrt(12.5))
    assert rms(np.array([np.nan])) is None
