import math

import numpy as np
import pytest

from crazychoir.launch.flight_tracks import TRACK_LIMITS, FlightTracks

PERIOD = 0.05  # s


def move(tracks, places, first=0):
    """Add the places of each time to the tracks, in steps of PERIOD."""
    for k, p in enumerate(places):
        states = np.zeros((len(p), 13))
        states[:, 0:3] = p
        tracks.add(first, states, k * PERIOD)


def test_a_length_is_that_of_the_path_through_all_places():
    tracks = FlightTracks((4, 5))
    move(
        tracks, [[(0, 0, 0), (1, 0, 0)], [(3, 4, 0), (1, 0, 2)], [(0, 0, 0), (1, 0, 1)]]
    )
    assert tracks.rows["length"].tolist() == [10.0, 3.0]


def test_only_some_places_are_kept():
    tracks = FlightTracks((0,))
    move(tracks, [[(k, 0, 0)] for k in range(7)])
    assert tracks.kept[0] == [
        pytest.approx((k * PERIOD, k, 0.0, 0.0)) for k in (0, 2, 4, 6)
    ]


def test_a_long_track_keeps_every_second_place():
    tracks = FlightTracks((0,))
    most = TRACK_LIMITS.most_places
    move(tracks, [[(k, 0, 0)] for k in range(2 * most + 10)])
    kept = tracks.kept[0]
    assert len(kept) <= most
    assert tracks.rows["interval"][0] == 2.0 * TRACK_LIMITS.interval
    assert np.diff([t for t, *_ in kept]) == pytest.approx(4 * PERIOD)
    assert tracks.rows["length"][0] == 2.0 * most + 9.0


def test_a_drone_alone_has_the_same_track_as_among_others():
    rng = np.random.default_rng(3)
    places = rng.normal(size=(50, 4, 3))
    together = FlightTracks(range(4))
    move(together, places)
    for row in range(4):
        alone = FlightTracks((row,))
        move(alone, places[:, row : row + 1])
        assert alone.rows[0] == together.rows[row]
        assert alone.kept[0] == together.kept[row]


def test_a_drone_that_was_never_seen_has_no_time():
    tracks = FlightTracks((0, 1))
    move(tracks, [[(0, 0, 0)]], first=1)
    assert tracks.rows["time"].tolist() == [-math.inf, 0.0]
