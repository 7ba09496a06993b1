import numpy as np
import pytest

from crazychoir.control.choice import make_controls
from crazychoir.filters.kalman import KalmanFilter
from crazychoir.filters.rows import FilterKind, FilterTable
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.flight.estimate import (
    BLIND_HORIZON,
    choose_filter,
    compute_believed_state,
    compute_rate_loops,
)
from crazychoir.numerics.math3d import quaternion_of_yaw
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import FullState, Pose, State

GROUND = 0.2
RATE = 100.0
POSE = Pose(np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]))


@pytest.mark.parametrize(
    ("name", "made", "kind"),
    [
        ("kalman", KalmanFilter, FilterKind.KALMAN),
        ("derivative", VelocityFilter, FilterKind.DERIVATIVE),
    ],
)
def test_a_filter_is_made_on_the_record_that_is_handed_over(name, made, kind):
    table = FilterTable.allocate(3, history_size=256)
    chosen = make_controls(plant="motors")
    f = choose_filter(name, chosen, GROUND, RATE, table.share_row(1))
    assert isinstance(f, made)
    assert table.rows["kind"].tolist() == [FilterKind.BY_HAND, kind, FilterKind.BY_HAND]
    row = table.rows[1]
    assert (row["horizon"], row["period"]) == (BLIND_HORIZON, 1.0 / RATE)
    assert (row["knows_commands"], row["floor_height"]) == (1, GROUND)
    np.testing.assert_array_equal(row["platform"], PAPER_PLATFORM.flat)
    f.update(POSE, 1.0)
    np.testing.assert_array_equal(row["state"][:3], POSE.p)


@pytest.mark.parametrize(("plant", "is_known"), [("motors", 1), ("lightweight", 0)])
def test_the_filter_knows_the_rate_loop_of_the_firmware_alone(plant, is_known):
    table = FilterTable.allocate(1, history_size=256)
    choose_filter("kalman", make_controls(plant=plant), GROUND, RATE, table)
    assert table.rows[0]["knows_loop"] == is_known
    loop = is_known * compute_rate_loops(PAPER_PLATFORM)
    np.testing.assert_array_equal(table.rows[0]["loop"], loop)


def test_an_unseen_drone_counts_as_being_where_its_reference_is():
    seen = State.at((9.0, 9.0, 9.0), (9.0, 9.0, 9.0))
    flown = FullState.at((1, 2, 3), (4, 5, 6), (7, 8, 9), (1, 1, 1), 2.5, 0.3)
    believed = compute_believed_state(seen, flown)
    expected = [1, 2, 3, 4, 5, 6, *quaternion_of_yaw(2.5), 0, 0, 0]
    np.testing.assert_array_equal(believed, expected)
    assert compute_believed_state(seen, None) is seen.flat
