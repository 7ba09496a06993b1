"""Recorded flights are read as they were flown, and other files are refused with a reason."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.simulation.identification.flights import FLIGHT_COLUMNS, read_flight

FOLDER = Path(__file__).resolve().parents[3] / "data" / "realflight"
INDEX = json.loads((FOLDER / "index.json").read_text())
CIRCLE = FOLDER / "B2_circle_fast_rep3.npz"


@pytest.fixture(scope="module")
def columns():
    with np.load(CIRCLE) as file:
        return dict(file)


@pytest.mark.parametrize("name", ["B2_circle_fast_rep3", "B5_helix_slow_rep1"])
def test_the_time_in_the_air_and_the_tilt_of_the_markers_are_those_of_the_index(name):
    flight = read_flight(FOLDER / f"{name}.npz")
    a, b = INDEX[name]["airborne"]
    assert a <= flight.airborne[0] <= a + 20
    assert b - 20 <= flight.airborne[1] <= b
    np.testing.assert_allclose(
        np.degrees(flight.marker_tilt), INDEX[name]["marker_tilt_deg"], atol=0.06
    )


def test_the_corrected_attitude_points_along_the_specific_force_of_hover():
    flight = read_flight(CIRCLE)
    a, b = flight.airborne
    rows = slice(a + 100, b - 100)
    force = np.gradient(flight.v, 0.01, axis=0)[rows] + [0, 0, STANDARD_GRAVITY]
    body = Rotation.from_quat(flight.q[rows]).inv()
    s = body.apply(force)
    v = body.apply(flight.v[rows])
    for c in range(2):
        terms = np.column_stack([s[:, 2], v[:, c]])
        tilt = np.linalg.lstsq(terms, s[:, c], rcond=None)[0][0]
        assert abs(np.degrees(tilt)) < 0.1


def test_the_floor_is_zero_and_the_clock_of_the_drone_is_that_of_the_cameras(columns):
    flight = read_flight(CIRCLE)
    assert np.abs(flight.p[:100, 2]).max() < 0.005
    row = 2000
    late = np.interp(
        columns["t"][row], columns["t"] - columns["delay"], columns["gyro"][:, 0]
    )
    assert flight.w[row, 0] == pytest.approx(late, abs=1e-6)
    assert np.abs(columns["delay"]).max() > 0.0


def test_rows_in_gaps_of_the_telemetry_are_left_out_and_counted(columns, tmp_path):
    columns = {**columns, "gap": columns["gap"].copy()}
    columns["gap"][1000:1345] = 0.05
    np.savez(tmp_path / "a.npz", **columns)
    flight = read_flight(tmp_path / "a.npz")
    assert not flight.is_known[1010:1335].any()
    assert flight.left_out == pytest.approx(345 / 3458, abs=0.01)


def spoil(columns, name):
    """Return the columns of a flight with one fault, and a part of the error."""
    if name == "missing":
        return {k: v for k, v in columns.items() if k != "duty"}, "no duty"
    if name == "shape":
        return {**columns, "duty": columns["duty"][:, :3]}, "duty: found shape"
    if name == "infinite":
        return {**columns, "vbat": columns["vbat"] * np.inf}, "not finite"
    if name == "steps":
        return {**columns, "t": 2 * columns["t"]}, "exactly 0.01 s"
    if name == "short":
        return {k: v[:600] for k, v in columns.items()}, "or more in the air"
    return {**columns, "p": 0.0 * columns["p"]}, "0.00 s above"


@pytest.mark.parametrize(
    "name", ["missing", "shape", "infinite", "steps", "short", "floor"]
)
def test_a_file_that_is_no_flight_is_refused_with_the_reason(columns, tmp_path, name):
    faulty, reason = spoil(columns, name)
    np.savez(tmp_path / "a.npz", **faulty)
    with pytest.raises(ConfigError, match=reason) as error:
        read_flight(tmp_path / "a.npz")
    assert "a.npz" in str(error.value)


def test_a_missing_file_and_one_of_another_kind_are_refused(tmp_path):
    (tmp_path / "text.npz").write_text("t,p,q\n")
    np.save(tmp_path / "one.npy", np.zeros(3))
    for name in ("none.npz", "text.npz", "one.npy"):
        with pytest.raises(ConfigError, match=", ".join(FLIGHT_COLUMNS)):
            read_flight(tmp_path / name)
