import struct

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.figure import circle, eight
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.upload import compute_difference, fit_upload

WAYPOINTS = np.random.default_rng(0).uniform(-1, 1, (40, 3))


def test_pieces_are_uploaded_as_they_are():
    flight = minimum_snap(WAYPOINTS[:10], np.arange(10.0), yaws=np.arange(10.0))
    upload = fit_upload(flight)
    np.testing.assert_array_equal(
        upload.pieces.coefficients, np.float32(flight.coefficients)
    )
    assert upload.error < 1e-5
    assert upload.yaw_error < 1e-5


def test_the_memory_holds_132_bytes_a_piece():
    flight = minimum_snap(WAYPOINTS[:3], [0, 1, 2.5], yaws=[0, 1, 2])
    memory = fit_upload(flight).memory
    assert len(memory) == 2 * 132
    second = struct.unpack("<33f", memory[132:])
    np.testing.assert_allclose(second[0:8], flight.coefficients[1, 0], rtol=1e-6)
    np.testing.assert_allclose(second[24:32], flight.coefficients[1, 3], rtol=1e-6)
    assert second[32] == pytest.approx(1.5)


@pytest.mark.parametrize(
    "trajectory",
    [
        circle((0, 0, 1), 0.5, 4.0, laps=5, yaw="along"),
        eight((0, 0, 1), (1.0, 0.5), 8.0, laps=2, yaw="along"),
        eight((0, 0, 1), (1.0, 0.5), 8.0, laps=1, yaw=0.7),
        minimum_snap(WAYPOINTS, np.arange(40.0)),
    ],
)
def test_anything_else_is_fitted_and_joins_smoothly(trajectory):
    upload = fit_upload(trajectory, tolerance=0.01, yaw_tolerance=0.02)
    assert len(upload.pieces.durations) <= 31
    assert upload.pieces.duration == pytest.approx(trajectory.duration, rel=1e-6)
    assert 0.0 < upload.error <= 0.01
    assert upload.yaw_error <= 0.02
    assert (upload.error, upload.yaw_error) == compute_difference(
        trajectory, upload.pieces
    )
    assert upload.pieces.jumps[0:3, 0:4].max() < 1e-4
    assert upload.pieces.jumps[3, 0:2].max() < 1e-4


def test_a_smaller_tolerance_takes_more_pieces():
    figure = circle((0, 0, 1), 0.5, 4.0, laps=3)
    coarse, fine = (
        fit_upload(figure, tolerance=0.01),
        fit_upload(figure, tolerance=0.0001),
    )
    assert len(coarse.pieces.durations) < len(fine.pieces.durations)
    assert fine.error <= 0.0001


def test_what_does_not_fit_is_refused_with_its_error():
    figure = circle((0, 0, 1), 0.5, 4.0, laps=20)
    with pytest.raises(
        ConfigError, match=r"pieces that are \S+ m and \S+ rad off.*0.001 m.*31 pieces"
    ):
        fit_upload(figure)


@pytest.mark.parametrize("name", ["tolerance", "yaw_tolerance"])
def test_a_tolerance_is_positive(name):
    with pytest.raises(ConfigError, match=name):
        fit_upload(circle((0, 0, 1), 0.5, 4.0), **{name: 0.0})
