"""Echoes: how long they take, and how many come back."""

import math

import pytest

from crazychoir.radio.link.round_trips import ECHO_STATISTICS, RoundTrips


def sent(trips, now):
    """An echo that has left at this time."""
    echo = trips.echo()
    trips.left(echo, now)
    return echo.data


def test_nothing_is_known_before_the_first() -> None:
    trips = RoundTrips()
    sent(trips, 0.0)
    assert math.isnan(trips.latency)
    assert math.isnan(trips.answered), "it may be on its way"


def test_the_latency_is_that_of_95_of_100() -> None:
    trips = RoundTrips()
    for k in range(ECHO_STATISTICS.latency_window):
        trips.came(sent(trips, float(k)), k + 1e-3 * (k + 1))
    assert trips.latency == pytest.approx(0.095)
    for k in range(ECHO_STATISTICS.latency_window):
        trips.came(sent(trips, float(k)), k + 0.002)
    assert trips.latency == pytest.approx(0.002), "old ones are forgotten"


def test_what_does_not_come_back_is_missing_in_the_share() -> None:
    trips = RoundTrips()
    for k in range(ECHO_STATISTICS.share_window + 1):
        data = sent(trips, float(k))
        if k % 4:
            trips.came(data, k + 0.01)
    assert trips.answered == pytest.approx(0.75)


def test_an_echo_counts_once_and_only_if_it_was_sent() -> None:
    trips = RoundTrips()
    data = sent(trips, 0.0)
    trips.came(data, 0.01)
    trips.came(data, 5.0)
    trips.came(b"another program's", 6.0)
    waiting = trips.echo().data
    trips.came(waiting, 7.0)
    assert trips.latency == pytest.approx(0.01)
