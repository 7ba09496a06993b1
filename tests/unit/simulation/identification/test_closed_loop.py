"""The simulated firmware flies recorded set-points as the real drones did."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.identification.closed_loop import (
    FlownAgain,
    find_body,
    fly_again,
)
from crazychoir.simulation.identification.closed_loop_scores import (
    find_medians,
    score_closed_loop,
)
from crazychoir.simulation.identification.flights import read_flight

FOLDER = Path(__file__).resolve().parents[3] / "data" / "realflight"


@pytest.fixture(scope="module")
def flights():
    return [read_flight(path) for path in sorted(FOLDER.glob("*.npz"))]


@pytest.fixture(scope="module")
def flown(flights):
    return fly_again(flights, CRAZYFLIE_21)


@pytest.fixture(scope="module")
def scores(flown):
    return {one.flight.name: score_closed_loop(one) for one in flown}


def test_simulated_and_real_drones_fly_as_near_to_each_other_as_published(scores):
    medians = find_medians(list(scores.values()))
    assert {speed: row["flights"] for speed, row in medians.items()} == {
        "slow": 4,
        "medium": 1,
        "fast": 5,
    }
    assert medians["slow"]["difference_mm"] < 55
    assert medians["medium"]["difference_mm"] < 65
    assert medians["fast"]["difference_mm"] < 110
    for row in medians.values():
        assert 0.93 < row["ratio"] < 1.05


def test_mellingers_controller_flies_too_low_as_it_did(scores):
    """It has no integral that lifts a drone with weak motors; the PID controller flies too high."""
    for name in ("B3_figure8_medium_rep3", "B5_helix_fast_mell_rep1"):
        assert scores[name].simulated.height_mm == pytest.approx(
            scores[name].real.height_mm, abs=15
        )
        assert scores[name].real.height_mm < -90
    for name, score in scores.items():
        if score.real.height_mm > 0:
            assert 0 < score.simulated.height_mm < 60, name


def test_laps_scatter_as_those_of_real_drones(scores):
    """Eight recorded circles scatter by 12.7 mm, the one of them that is here by 7 mm."""
    score = scores["B2_circle_fast_rep3"]
    assert 5 < score.real.scatter_mm < 9
    assert 9 < score.simulated.scatter_mm < 17
    assert scores["B7_oval_fast_rep2"].real.scatter_mm is None


def test_a_flight_that_follows_its_record_has_no_difference(flown):
    one = flown[1]
    same = score_closed_loop(FlownAgain(one.flight, one.setpoints, one.flight.states))
    assert same.difference_mm == 0.0
    assert same.ratio == 1.0
    assert same.real == same.simulated


def test_a_lag_is_found(flights):
    flight = flights[1]
    late = np.roll(flight.setpoints, 37, axis=0)
    states = flight.states.copy()
    states[:, :3] = late[:, :3]
    found = score_closed_loop(FlownAgain(flight, flight.setpoints, states)).simulated
    assert found.lag_s == pytest.approx(0.37)
    assert found.rest_mm == pytest.approx(0.0, abs=1e-9)


def test_the_body_of_a_flight_has_its_thrust_and_its_imbalance(flights):
    body = find_body(flights[1], CRAZYFLIE_21)
    assert body.max_thrust / CRAZYFLIE_21.max_thrust == pytest.approx(0.735, abs=0.01)
    factors = np.array(body.effects.motor_factors)
    assert factors.mean() == pytest.approx(1.0)
    assert 0.02 < np.ptp(factors) < 0.2
    assert body.firmware.thrust_max == pytest.approx(0.735 * 0.12, rel=0.01)


def test_a_flight_without_set_points_is_refused_by_its_name(flights):
    with pytest.raises(ConfigError, match=r"B2_circle_fast_rep3.*no set-points"):
        fly_again([replace(flights[1], setpoints=None)], CRAZYFLIE_21)
