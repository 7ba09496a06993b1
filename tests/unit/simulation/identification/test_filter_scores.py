"""The filters on the poses of ten real flights: which default is good, at which rates and with which gaps."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crazychoir.filters.kalman import KalmanNoise
from crazychoir.filters.rows import FilterKind
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import find_platform
from crazychoir.simulation.identification.filter_scores import (
    FILTER_CASES,
    GAP_LENGTHS,
    FilterCase,
    draw_lost_poses,
    score_filters,
)
from crazychoir.simulation.identification.flights import read_flight
from crazychoir.simulation.identification.pose_streams import (
    estimate_noise,
    make_stream,
    smooth,
)

FOLDER = Path(__file__).resolve().parents[3] / "data" / "realflight"
PLATFORM = find_platform("cf21")
FIXED = "kalman, no commands, 0.5 mm"
FAST = "kalman, no commands, 0.5 mm, jerk 3"
FIXED_COMMANDED = "kalman, 0.5 mm"


@pytest.fixture(scope="module")
def flights():
    return [read_flight(path) for path in sorted(FOLDER.glob("*.npz"))]


@pytest.fixture(scope="module")
def scored(flights):
    half = KalmanNoise(place=5e-4)
    cases = {
        **FILTER_CASES,
        FIXED: FilterCase(FilterKind.KALMAN, False, half),
        FAST: FilterCase(FilterKind.KALMAN, False, KalmanNoise(place=5e-4, jerk=3.0)),
        FIXED_COMMANDED: FilterCase(FilterKind.KALMAN, True, half),
    }
    errors = score_filters(flights, PLATFORM, cases=cases)
    return {(e.filter, e.rate, e.gaps): e for e in errors}


def velocity(scored, *case):
    return scored[case].figures()["velocity_mm_s"]


@pytest.mark.parametrize("rate", [50, 100, 240])
@pytest.mark.parametrize(
    ("gaps", "mm_s"), [("no gaps", 10.0), ("50 ms", 11.0), ("200 ms", 21.0)]
)
def test_the_kalman_filter_without_commands_is_as_exact_on_real_poses_as_wanted(
    scored, rate, gaps, mm_s
):
    assert velocity(scored, "kalman, no commands", rate, gaps) <= mm_s
    assert scored["kalman, no commands", rate, gaps].refused == 0


@pytest.mark.parametrize("rate", [50, 100, 240])
@pytest.mark.parametrize("gaps", GAP_LENGTHS)
def test_each_filter_is_better_than_the_one_before(scored, rate, gaps):
    errors = [
        velocity(scored, name, rate, gaps)
        for name in ("kalman", "kalman, no commands", "derivative, no commands")
    ]
    assert errors == sorted(errors)


@pytest.mark.parametrize("rate", [50, 100, 240])
@pytest.mark.parametrize("gaps", GAP_LENGTHS)
def test_the_measured_noise_of_the_cameras_is_better_than_a_given_one(
    scored, rate, gaps
):
    measured = velocity(scored, "kalman, no commands", rate, gaps)
    assert measured < 0.65 * velocity(scored, FIXED, rate, gaps)
    assert measured < 0.97 * velocity(scored, FAST, rate, gaps)
    commanded = velocity(scored, "kalman", rate, gaps)
    assert commanded < 0.88 * velocity(scored, FIXED_COMMANDED, rate, gaps)


def test_it_is_better_in_each_fast_flight(scored, flights):
    measured = scored["kalman, no commands", 100, "no gaps"].velocity
    given = scored[FIXED, 100, "no gaps"].velocity
    fast = np.array(["fast" in flight.name for flight in flights])
    assert (measured[fast] < 0.6 * given[fast]).all()
    assert (measured < given).all()


@pytest.mark.parametrize(("rate", "step"), [(100, 1), (50, 2)])
def test_poses_at_the_recorded_rate_and_its_parts_are_the_recorded_ones(
    flights, rate, step
):
    flight = flights[0]
    a, b = flight.airborne
    stream = make_stream(flight, PLATFORM, rate, 0)
    np.testing.assert_array_equal(stream.poses[:, :3], flight.p[a:b:step])
    np.testing.assert_array_equal(stream.v, flight.v[a:b:step])


def test_poses_at_another_rate_are_as_noisy_as_the_recorded_ones(flights):
    def noise(stream):
        fourth = np.diff(stream.poses[:, :3], 4, axis=0)
        return np.sqrt(np.mean(fourth**2) / 70.0)

    flight = flights[1]
    recorded = noise(make_stream(flight, PLATFORM, 100, 0))
    stream = make_stream(flight, PLATFORM, 240, 0)
    assert recorded < noise(stream) < 2.0 * recorded
    assert np.median(np.diff(stream.t)) == pytest.approx(1 / 240)
    flown = np.diff(stream.poses[:, :3], axis=0).sum(axis=0)
    assert stream.v.sum(axis=0) / 240 == pytest.approx(flown, abs=0.02)
    turn = Rotation.from_quat(stream.poses[:-1, 3:]).inv() * Rotation.from_quat(
        stream.poses[1:, 3:]
    )
    assert np.degrees(turn.magnitude()).max() < 5.0


def test_the_noise_is_found_from_what_smoothing_has_taken_away():
    noise = np.random.default_rng(1).standard_normal((20000, 3)) * [1.0, 2.0, 3.0]
    found = estimate_noise(noise - smooth(noise, 0))
    np.testing.assert_allclose(found, [1.0, 2.0, 3.0], rtol=0.02)


def test_the_commands_carry_the_drone_and_lead_its_rates(flights):
    stream = make_stream(flights[1], PLATFORM, 100, 0)
    mean = stream.commands[stream.is_known, 0].mean()
    assert mean == pytest.approx(PLATFORM.mass * STANDARD_GRAVITY, rel=0.1)
    w = stream.w[:, 0]
    u = stream.commands[:, 1]
    match = [np.corrcoef(u[: -10 - 1], w[k : len(w) - 11 + k])[0, 1] for k in range(8)]
    assert int(np.argmax(match)) >= 2


def test_poses_are_lost_singly_and_in_one_gap_in_three_seconds():
    t = np.arange(3000) / 100
    none, short, long = (
        draw_lost_poses(t, 100, length, np.random.default_rng(1))
        for length in (0.0, 0.05, 0.2)
    )
    assert not none.any()
    assert 0.02 < short.mean() < 0.06
    assert 0.06 < long.mean() < 0.11
    assert not short[0]
    assert not long[0]
