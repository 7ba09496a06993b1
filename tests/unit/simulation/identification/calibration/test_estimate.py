"""A calibration finds the random parameters of simulated drones, and says what a flight does not show."""

import math
from pathlib import Path

import numpy as np
import pytest
from flown_drones import draw_drone, fly

from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.identification.calibration.columns import (
    read_columns,
    regularise,
)
from crazychoir.simulation.identification.calibration.estimate import calibrate
from crazychoir.simulation.identification.calibration.flight import make_flight

FOLDER = Path(__file__).resolve().parents[4] / "data" / "realflight"
INERTIA = CRAZYFLIE_21.inertia[0]


def tolerance(name, true):
    """Return the error that a calibration may have."""
    stem = name.split("_")[0]
    absolute = {
        "thrust": 0.01,
        "trim": math.radians(0.1),
        "rotor": 0.005,
        "imbalance": 3.0 * INERTIA,
    }
    relative = {"drag": 0.05, "moment": 0.10, "battery": 0.2}
    return absolute[stem] if stem in absolute else relative[stem] * abs(true)


def find(columns, name="flight"):
    return calibrate([make_flight(name, regularise(columns, name))], CRAZYFLIE_21)


@pytest.fixture(scope="module")
def one():
    """One drone, its recording, and its calibration."""
    drone = draw_drone(np.random.default_rng(11))
    (columns,) = fly([drone])
    return drone, columns, find(columns)


def test_a_lively_flight_tells_all_parameters_of_its_drone(one):
    drone, _, found = one
    for name, true in drone.truth.items():
        estimate = found.estimates[name]
        assert estimate.is_identified, name
        assert estimate.value == pytest.approx(true, abs=tolerance(name, true)), name


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_nine_of_ten_random_drones_are_found_within_the_tolerances():
    draw = np.random.default_rng(5)
    drones = [draw_drone(draw) for _ in range(10)]
    right = dict.fromkeys(drones[0].truth, 0)
    for drone, columns in zip(drones, fly(drones), strict=True):
        found = find(columns)
        for name, true in drone.truth.items():
            estimate = found.estimates[name]
            near = abs(estimate.value - true) <= tolerance(name, true)
            right[name] += near and estimate.is_identified
    assert {name: count for name, count in right.items() if count < 9} == {}


def hover(t):
    return np.array([0.0, 0.0, 1.0]), None, None


def test_a_calm_flight_leaves_what_it_does_not_show_at_the_default():
    drone = draw_drone(np.random.default_rng(12))
    (columns,) = fly([drone], seconds=15.0, plan=hover)
    found = find(columns)
    for name in ("drag_x", "drag_y", "moment_roll", "moment_pitch", "rotor_lag"):
        estimate = found.estimates[name]
        assert not estimate.is_identified
        assert estimate.value == estimate.default
    for key in ("drag", "speed_moment", "rotor_lag", "rotor_delay"):
        assert key not in found.table
    assert found.estimates["thrust_factor"].is_identified
    assert found.value("thrust_factor") == pytest.approx(
        drone.truth["thrust_factor"], abs=0.01
    )


def test_plain_least_squares_would_find_too_weak_torques(one):
    """The gain of the motors without the set-point is far below that with it: a closed loop shrinks it."""
    _, columns, found = one
    blind = {name: column for name, column in columns.items() if name != "sp"}
    flight = make_flight("blind", regularise(blind, "blind"))
    assert any("no set-point" in note for note in flight.notes)
    plain = calibrate([flight], CRAZYFLIE_21)
    assert plain.estimates["thrust_factor"].is_identified
    assert found.gain == pytest.approx(1.1, abs=0.2)
    assert plain.gain < 0.85 * found.gain


def test_lost_packets_are_found_and_left_out(one):
    drone, columns, _ = one
    faulty = {name: column.copy() for name, column in columns.items()}
    lost = range(2000, 8000, 200)
    for begin in lost:
        part = slice(begin, begin + 13)
        for name in ("gyro", "acc", "duty"):
            ends = faulty[name][[begin - 1, begin + 13]]
            share = np.linspace(0.0, 1.0, 15)[1:-1, None]
            faulty[name][part] = (1.0 - share) * ends[0] + share * ends[1]
    flight = make_flight("lost", regularise(faulty, "lost"))
    for begin in lost:
        assert not flight.is_usable[begin : begin + 13].any()
    assert any("packets were lost" in note for note in flight.notes)
    found = calibrate([flight], CRAZYFLIE_21)
    for name in ("thrust_factor", "moment_roll", "imbalance_pitch"):
        true = drone.truth[name]
        assert found.value(name) == pytest.approx(true, abs=tolerance(name, true))


def test_a_clock_that_drifts_is_aligned(one):
    drone, columns, _ = one
    t = columns["t"]
    late = 0.03 + 1e-3 * t  # 30 ms, and 60 ms a minute
    drifting = dict(columns)
    for name in ("gyro", "acc", "duty"):
        drifting[name] = np.column_stack(
            [np.interp(t - late, t, part) for part in columns[name].T]
        )
    flight = make_flight("drift", regularise(drifting, "drift"))
    assert any("60 ms a minute" in note for note in flight.notes)
    rest = slice(1000, 8000)
    assert np.abs(flight.gyro - columns["gyro"])[rest].mean() < 0.02
    found = calibrate([flight], CRAZYFLIE_21)
    for name in ("moment_roll", "moment_pitch", "thrust_factor"):
        true = drone.truth[name]
        assert found.value(name) == pytest.approx(true, abs=tolerance(name, true))


def test_real_flights_have_the_moment_the_drag_and_the_thrust_of_an_analysis_of_all_of_them():
    names = ("B2_circle_fast_rep3", "B3_figure8_fast_rep2", "B7_oval_fast_rep2")
    flights = [make_flight(n, read_columns(FOLDER / f"{n}.npz")) for n in names]
    found = calibrate(flights, CRAZYFLIE_21)
    assert found.value("thrust_factor") == pytest.approx(0.68, abs=0.02)
    assert found.value("moment_roll") / INERTIA == pytest.approx(31.0, abs=4.0)
    assert found.value("moment_pitch") / INERTIA == pytest.approx(35.0, abs=4.0)
    drag = found.value("drag_x") / CRAZYFLIE_21.mass
    assert drag == pytest.approx(0.38, abs=0.06)
    assert not found.estimates["rotor_lag"].is_identified
