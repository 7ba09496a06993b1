"""Flights that wait, and go on."""

import numpy as np
import pytest

from crazychoir.config.tables import FlightTable
from crazychoir.errors import Refused
from crazychoir.flight.point_flights import FLIGHT_PATIENCE, PointFlights
from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.planning.trajectory import Trajectory
from crazychoir.safety.rules.guard import DEFAULT_FENCE
from crazychoir.types import FullState

START, GOAL = FullState.at((0.0, 0.0, 1.0)), np.array([2.0, 0.0, 1.0])
ASIDE = FullState.at((0.5, 1.0, 1.0))


def flying(seconds=8.0):
    flights = PointFlights(FlightTable(), DEFAULT_FENCE, 2.0)
    flights.go_to(START, GOAL, 0.0, seconds, 10.0)
    return flights


def test_a_plan_that_has_waited_in_vain_goes_on_to_its_place_from_another_start():
    flights = flying()
    assert not flights.resume(ASIDE, 11.0), "it has not waited"
    assert flights.wait(FLIGHT_PATIENCE.restart_wait)
    assert flights.remaining(11.0) == pytest.approx(7.0 + FLIGHT_PATIENCE.restart_wait)
    assert flights.resume(ASIDE, 11.0)
    assert isinstance(flights.plan, PointToPoint)
    assert flights.sample(11.0).p == pytest.approx(ASIDE.p)
    assert flights.sample(99.0).p == pytest.approx(GOAL)
    assert (flights.remaining(11.0), flights.waited) == pytest.approx(
        (7.0 + FLIGHT_PATIENCE.restart_wait, FLIGHT_PATIENCE.restart_wait)
    ), "in its time"
    assert not flights.resume(ASIDE, 11.0), "it has not waited since then"


def test_what_a_new_start_costs_counts_as_waiting():
    flights = flying(0.0)
    whole = flights.remaining(10.0)
    assert flights.wait(FLIGHT_PATIENCE.restart_wait)
    late = 10.0 + whole
    assert flights.resume(ASIDE, late)
    assert flights.remaining(late) == pytest.approx(flights.waited)
    assert flights.waited > FLIGHT_PATIENCE.restart_wait


def test_only_flights_to_a_place_begin_anew_and_not_for_ever():
    flights = flying()
    flights.wait(FLIGHT_PATIENCE.longest_wait)
    assert not flights.resume(ASIDE, 11.0)
    flights.brake(FullState.at((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)), 11.0)
    flights.wait(FLIGHT_PATIENCE.restart_wait)
    assert not flights.resume(ASIDE, 12.0)


class Ending(Trajectory):
    """It moves along x at 1 m/s, and has no numbers from `until` s on."""

    duration = 9.0

    def __init__(self, until, broken):
        self.until, self.broken = until, broken

    def done(self, t):
        return t >= self.duration

    def sample(self, t):
        if t >= self.until:
            return FullState(self.broken)
        return FullState.at((t, 0.0, 1.0), (1.0, 0.0, 0.0))


@pytest.mark.parametrize("broken", [np.full(14, np.nan), np.zeros(3), "text"])
def test_a_trajectory_without_numbers_stays_where_it_was_last(broken):
    flights = PointFlights(FlightTable(), DEFAULT_FENCE, 2.0)
    flights.fly(Ending(0.5, broken), 10.0)
    flights.load(10.4)
    assert not flights.lacks_set_point
    for now in (10.5, 10.6):
        flights.load(now)
        assert flights.lacks_set_point
        assert flights.sample(now).p == pytest.approx([0.4, 0.0, 1.0])
        assert flights.sample(now).v.tolist() == [0.0, 0.0, 0.0]
    flights.go_to(START, GOAL, 0.0, 8.0, 11.0)
    flights.load(11.0)
    assert not flights.lacks_set_point


def test_a_trajectory_must_begin_with_numbers():
    flights = PointFlights(FlightTable(), DEFAULT_FENCE, 2.0)
    with pytest.raises(Refused, match="must begin with finite numbers"):
        flights.fly(Ending(0.0, np.full(14, np.nan)), 10.0)
    assert flights.plan is None
